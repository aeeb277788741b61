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
use std::path::Path;
use std::time::Duration;

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
    let mut training = whole_run(&run);
    // A learner that stands still cannot end its drain before the second signal.
    let learner = training.wait_for("cross-learner");
    assert!(processes::send(learner.pid, Signal::STOP));
    training.send(Signal::INT);
    let said = Path::new(&run.marker()).join("stderr");
    wait::until("the first Ctrl-C to be taken in", || {
        std::fs::read_to_string(&said).unwrap().contains("stopping").then_some(())
    });
    // A signal within a second of the one before counts as its echo.
    std::thread::sleep(Duration::from_millis(1100));
    training.send(Signal::INT);
    let finished = training.wait();
    assert_none_left(&run.marker());
    assert_eq!(finished.code, Some(1), "{finished:?}");
    finished.assert_sentence(&["killed", "`cross train --resume --run", &run.path().display().to_string()]);
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
