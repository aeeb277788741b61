//! Stopping, resuming, repeating.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::assert_none_left;
use cross_tests::runs::{Run, assert_same_metrics, same_bytes, without_times};
use rustix::process::Signal;

#[test]
fn a_run_stopped_by_ctrl_c_continues_at_the_next_update() {
    let run = Run::new();
    let mut training = run.start(&["--updates", "1000", "--actors", "2"]);
    training.wait_for_updates(2);
    training.send(Signal::INT);
    let stopped = training.wait().json();
    assert_none_left(&run.marker());
    assert_eq!(stopped["interrupted"], true);
    let done = stopped["updates"].as_u64().unwrap();
    assert!(done >= 2, "{stopped}");
    assert_eq!(run.updates(), done, "the last update is in the metrics and in the checkpoint");

    let wanted = (done + 2).to_string();
    let arguments = ["--resume", "--updates", &wanted, "--actors", "2", "--eval-seeds", "0"];
    let resumed = run.finish(&arguments);
    assert!(!resumed.stderr.contains("done already"), "{}", resumed.stderr);
    assert_eq!(resumed.json()["interrupted"], false);
    let updates: Vec<u64> = run.metrics().iter().map(|line| line["update"].as_u64().unwrap()).collect();
    assert_eq!(updates, (1..=done + 2).collect::<Vec<_>>(), "no update is lost or repeated");

    let again = run.finish(&arguments);
    assert!(again.stderr.contains(&format!("all {wanted} updates are done already")), "{}", again.stderr);
    assert_eq!(again.json()["interrupted"], false);
    assert_eq!(run.updates(), done + 2);
    assert_none_left(&run.marker());
}

#[test]
fn a_serial_run_stopped_and_resumed_equals_an_uninterrupted_one_bit_for_bit() {
    let arguments = ["--serial", "--seed", "5", "--updates", "12", "--eval-seeds", "0"];
    let whole = Run::new();
    let _ = whole.finish(&arguments).json();

    let parts = Run::new();
    let mut training = parts.start(&arguments);
    training.wait_for_updates(2);
    training.send(Signal::INT);
    let stopped = training.wait().json();
    let done = stopped["updates"].as_u64().unwrap();
    assert!((2..12).contains(&done), "stopped too late to prove anything: {stopped}");
    let _ = parts.finish(&["--resume", "--eval-seeds", "0"]).json();

    assert_same_metrics(&parts, &whole);
    let model = |run: &Run| run.newest_checkpoint().join("model.safetensors");
    assert!(same_bytes(&model(&parts), &model(&whole)), "the weights differ");
    let optimizer = |run: &Run| run.newest_checkpoint().join("optimizer.safetensors");
    assert!(same_bytes(&optimizer(&parts), &optimizer(&whole)), "the optimiser state differs");
}

#[test]
fn two_serial_runs_with_one_seed_are_the_same_and_another_seed_is_not() {
    let trained = |seed: &str| {
        let run = Run::new();
        let _ = run.finish(&["--serial", "--seed", seed, "--updates", "3", "--eval-seeds", "0"]).json();
        assert_eq!(run.updates(), 3);
        run
    };
    let first = trained("7");
    assert_same_metrics(&first, &trained("7"));
    assert_ne!(without_times(&first.metrics()), without_times(&trained("8").metrics()));
}
