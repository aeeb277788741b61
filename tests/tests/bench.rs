//! The benchmarks of the wire, in small: they measure, what they hold to is held, and nothing of them stays.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::assert_none_left;
use cross_tests::runs::{Finished, Run};
use rustix::process::Signal;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A folder for temporary files of a run alone.
fn own_folder(run: &Run) -> PathBuf {
    let folder = Path::new(&run.marker()).join("tmp");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn bench(run: &Run, arguments: &[&str]) -> Command {
    let mut command = run.cross(&["bench"]);
    command.args(arguments).arg("--json").env("TMPDIR", own_folder(run));
    command
}

fn assert_nothing_left(run: &Run) {
    assert_none_left(&run.marker());
    let left: Vec<_> =
        std::fs::read_dir(own_folder(run)).unwrap().flatten().map(|entry| entry.path()).collect();
    assert!(left.is_empty(), "{left:?}");
}

/// Our figure and the baseline's.
fn row(report: &Value, case: &str) -> (f64, f64) {
    let rows = report["rows"].as_array().unwrap();
    let row =
        rows.iter().find(|row| row["case"] == case).unwrap_or_else(|| panic!("no {case} in {report:#}"));
    (row["ours"].as_f64().unwrap(), row["baseline"].as_f64().unwrap())
}

fn report(finished: &Finished, name: &str) -> Value {
    let report = finished.json();
    assert_eq!(report["bench"], name);
    report
}

#[test]
fn every_fragment_of_every_actor_is_accepted_and_acknowledged_once() {
    let run = Run::new();
    let arguments = ["ingest", "--actors", "1,6", "--seconds", "0.5", "--fragments", "600"];
    // That they are acknowledged once, by both sides' count, the command itself demands.
    let report = report(&run.spawn(bench(&run, &arguments)).wait(), "ingest");
    let (bytes, aim) = row(&report, "bytes of a decision on the wire, grid4x4");
    assert!((10.0..=aim).contains(&bytes), "{bytes} of {aim}");
    for actors in ["1 actor", "6 actors"] {
        let (ours, bare) = row(&report, &format!("accepted decisions, {actors}"));
        assert!(ours > 0.0 && bare > 0.0, "{ours} {bare}");
        // That it keeps all of them, the command itself demands.
        let (_, keeping) = row(&report, &format!("accepted decisions beside one that keeps, {actors}"));
        assert!(keeping > 0.0, "{keeping}");
        let (ours, _) = row(&report, &format!("slowest actor over the median one, {actors}"));
        assert!(ours > 0.0, "an actor of {actors} got nothing");
    }
    let (held, wire) = row(&report, "learner, memory that holds back 6 actors");
    assert!(held >= 0.0 && wire > 0.0, "{held} {wire}");
    assert_nothing_left(&run);
}

#[test]
fn a_version_is_encoded_once_for_all_who_watch() {
    let run = Run::new();
    let arguments = ["weights", "--watchers", "1,6", "--versions", "2"];
    let report = report(&run.spawn(bench(&run, &arguments)).wait(), "weights");
    let (one, of_one) = row(&report, "encodings of a version, 1 watcher");
    let (ours, of_six) = row(&report, "encodings of a version, 6 watchers");
    assert_eq!((one, ours), (1.0, 1.0));
    assert_eq!(of_six, 6.0 * of_one, "tonic's own stream encodes for each");
    let (time, _) = row(&report, "a version at the last, 6 watchers");
    assert!(time > 0.0, "{time}");
    assert_nothing_left(&run);
}

#[test]
fn after_ctrl_c_nothing_is_left() {
    let run = Run::new();
    let mut measuring = run.spawn(bench(&run, &["ingest", "--actors", "2", "--seconds", "600"]));
    let _ = measuring.wait_for("cross-learner");
    measuring.send(Signal::INT);
    let finished = measuring.wait();
    assert_eq!(finished.code, Some(1), "{finished:?}");
    finished.assert_sentence(&["stopped by a signal"]);
    assert_nothing_left(&run);
}
