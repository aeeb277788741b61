//! `cross baselines`: the table of rules, on a small grid that takes a moment.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::assert_none_left;
use cross_tests::runs::{Finished, Run};
use cross_tests::wait;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A small grid with this much traffic, and a folder for results.
struct Small {
    run: Run,
    folder: tempfile::TempDir,
}

impl Small {
    fn new(vehicles_per_hour: u32) -> Self {
        let small = Self { run: Run::new(), folder: tempfile::tempdir().unwrap() };
        let rate = vehicles_per_hour.to_string();
        let arguments =
            ["scenario", "generate", "grid", "--columns", "2", "--rows", "1", "--vehicles-per-hour", &rate];
        let town = small.town();
        let _ =
            small.run.call(&[&arguments[..], &["--name", "town", "--json", "--out", &town]].concat()).json();
        small
    }

    fn town(&self) -> String {
        self.folder.path().join("town").display().to_string()
    }

    fn results(&self) -> PathBuf {
        self.folder.path().join("results")
    }

    fn command(&self, more: &[&str]) -> std::process::Command {
        let mut command = self.run.cross(&["baselines", "--scenario", &self.town(), "--out"]);
        command.arg(self.results()).args(more);
        command
    }

    fn call(&self, more: &[&str]) -> Finished {
        self.run.spawn(self.command(more)).wait()
    }
}

/// Episodes in a folder of results.
fn stored(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(stored(&path));
        } else if path.extension().is_some_and(|extension| extension == "json") {
            found.push(path);
        }
    }
    found
}

#[test]
fn finished_episodes_are_kept_and_not_simulated_again() {
    let small = Small::new(300);
    let rules = ["--policy", "fixed-time", "--policy", "max-pressure", "--seeds", "2", "--json"];
    let first = small.call(&rules).json();
    let town = &first["scenarios"][0];
    assert_eq!((&town["scenario"], &town["vehicles"]), (&json!("town"), &json!(300)));
    let names: Vec<_> = town["policies"].as_array().unwrap().iter().map(|policy| &policy["policy"]).collect();
    assert_eq!(names, ["fixed-time", "max-pressure-stopped"], "the variant, not its alias");
    for policy in town["policies"].as_array().unwrap() {
        assert_eq!(policy["seeds"], json!([1, 2]));
        for metric in ["queue_length", "trip_delay", "co2"] {
            assert!(policy["metrics"][metric]["mean"].as_f64().unwrap() > 0.0, "{metric} of {policy}");
        }
    }
    assert_eq!(stored(&small.results()).len(), 4);

    // A lost and a damaged result are made again, the same as before.
    let all = stored(&small.results());
    std::fs::remove_file(&all[0]).unwrap();
    std::fs::write(&all[1], "{").unwrap();
    let again = small.call(&rules);
    assert!(again.stderr.contains("2 of 4 episodes are in"), "{}", again.stderr);
    assert_eq!(again.json(), first);

    // The others are read and not simulated: a figure that was altered is believed.
    let altered = small.results().join("town/fixed-time/seed-2.json");
    let mut document: Value = serde_json::from_slice(&std::fs::read(&altered).unwrap()).unwrap();
    document["evaluation"][0]["per_seed"][0]["metrics"]["trip_delay"]["mean"] = json!(4321.0);
    std::fs::write(&altered, document.to_string()).unwrap();
    let believed = small.call(&rules).json();
    assert_eq!(believed["scenarios"][0]["policies"][0]["metrics"]["trip_delay"]["high"], 4321.0);
    // Unless it was made by another generation of this program.
    document["made"]["generation"] = json!(0);
    std::fs::write(&altered, document.to_string()).unwrap();
    assert_eq!(small.call(&rules).json(), first);

    // The page says the same, to standard output or to a file.
    let page = small.folder.path().join("page.md");
    let told = small.call(&[&rules[..6], &["--markdown", &page.display().to_string()]].concat());
    assert!(told.stdout.contains("1 scenario, page: "), "{}", told.stdout);
    let page = std::fs::read_to_string(page).unwrap();
    assert_eq!(page.trim_end(), small.call(&rules[..6]).stdout.trim_end());
    for part in
        ["# Baselines", "## town", "`max-pressure-stopped` (as published)", "--policy max-pressure --seeds 2"]
    {
        assert!(page.contains(part), "{part} is not in {page}");
    }
    assert_none_left(&small.run.marker());
}

#[test]
fn an_interrupt_loses_the_running_episode_alone() {
    // So much traffic that an episode takes a while, and so many of them that some are left.
    let small = Small::new(4000);
    let rules = ["--policy", "fixed-time", "--policy", "greedy", "--seeds", "6", "--workers", "1"];
    let background = small.run.spawn(small.command(&rules));
    wait::until("the first result", || (!stored(&small.results()).is_empty()).then_some(()));
    background.send(Signal::INT);
    let finished = background.wait();
    assert_eq!(finished.code, Some(1), "{}", finished.stderr);
    finished.assert_sentence(&["stopped", "left, and the same command goes on"]);
    assert_none_left(&small.run.marker());
    let there = stored(&small.results()).len();
    assert!(there < 12, "all were done before the signal came");

    let few = small.call(&["--policy", "fixed-time", "--seeds", "1", "--json"]);
    assert_eq!(few.json()["scenarios"][0]["policies"][0]["seeds"], json!([1]));
    assert!(few.stderr.contains("1 of 1 episodes are in"), "what was done counts: {}", few.stderr);
}

#[test]
fn what_cannot_work_is_refused() {
    let run = Run::new();
    run.call(&["baselines", "--scenario", "grid4x5"]).assert_refused(&["grid4x5", "grid4x4"]);
    let nowhere = ["--markdown", "/no/such/folder/page.md", "--out", "/dev/null/results"];
    run.call(&[&["baselines"], &nowhere[..2]].concat()).assert_refused(&["/no/such/folder"]);
    run.call(&["baselines", "--scenario", "grid4x4", "--out", nowhere[3]])
        .assert_refused(&["/dev/null/results", "--out"]);
    run.call(&["baselines", "--scenario", "grid4x4", "--scenario", "grid4x4"])
        .assert_refused(&["grid4x4", "once"]);
    for arguments in [&["--policy", "max-presure"][..], &["--seeds", "0"], &["--workers", "0"]] {
        let finished = run.call(&[&["baselines"], arguments].concat());
        assert_eq!((finished.code, finished.stdout.as_str()), (Some(2), ""), "{}", finished.stderr);
    }
}
