//! However a run ends, nothing of it stays behind.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::{self, assert_none_left};
use cross_tests::runs::{Background, Run};
use cross_tests::wait;
use rustix::process::Signal;

/// A run with all of its processes up, SUMO included.
fn whole_run(run: &Run) -> Background<'_> {
    let mut training = run.start(&["--updates", "1000", "--actors", "2", "--eval-seeds", "0"]);
    training.wait_for_updates(1);
    for program in ["cross-learner", "cross-actor", "sumo"] {
        let _ = training.wait_for(program);
    }
    training
}

#[test]
fn after_sigterm_the_run_is_checkpointed_and_nothing_is_left() {
    let run = Run::new();
    let training = whole_run(&run);
    training.send(Signal::TERM);
    let result = training.wait().json();
    assert_eq!(result["interrupted"], true);
    assert_none_left(&run.marker());
    assert_eq!(result["updates"].as_u64().unwrap(), run.updates());
    assert!(run.newest_checkpoint().join("model.safetensors").is_file());
}

#[test]
fn after_sigkill_of_cross_nothing_is_left() {
    let run = Run::new();
    let training = whole_run(&run);
    training.send(Signal::KILL);
    assert_eq!(training.wait().code, None);
    assert_none_left(&run.marker());
}

#[test]
fn after_a_second_ctrl_c_nothing_is_left() {
    let run = Run::new();
    let training = whole_run(&run);
    // Two signals of one kind that arrive together count as one; two kinds are two.
    training.send(Signal::INT);
    training.send(Signal::TERM);
    let finished = training.wait();
    assert_none_left(&run.marker());
    assert!(finished.code.is_some(), "{finished:?}");
}

#[test]
fn after_sigkill_of_an_evaluation_nothing_is_left() {
    let run = Run::new();
    let mut evaluation =
        run.spawn(run.cross(&["eval", "--scenario", "grid4x4", "--policy", "random", "--seeds", "50"]));
    let _ = evaluation.wait_for("sumo");
    evaluation.send(Signal::KILL);
    assert_eq!(evaluation.wait().code, None);
    assert_none_left(&run.marker());
}

#[test]
fn a_run_directory_serves_one_run_at_a_time() {
    let run = Run::new();
    let training = whole_run(&run);
    let path = run.path().display().to_string();
    let other = Run::new();
    let refused = other.call(&["train", "--resume", "--run", &path]);
    refused.assert_refused(&["another", &path, "--run"]);
    assert_eq!(processes::of_program(&run.marker(), "cross-learner").len(), 1, "the first run goes on");
    training.send(Signal::KILL);
    let _ = training.wait();
    wait::until("the end of all processes", || processes::marked(&run.marker()).is_empty().then_some(()));
}
