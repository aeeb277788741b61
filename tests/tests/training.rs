//! Whole runs of `cross train`: what they leave, and what a kill in the middle costs.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::assert_none_left;
use cross_tests::runs::Run;

/// Updates of a run in which something is killed: enough that it is still going on then.
const UPDATES: u64 = 25;

fn assert_all_updates(run: &Run, wanted: u64) {
    let updates: Vec<u64> = run.metrics().iter().map(|line| line["update"].as_u64().unwrap()).collect();
    let expected: Vec<u64> = (1..=wanted).collect();
    assert_eq!(updates, expected, "every update once and in order");
}

#[test]
fn a_run_ends_with_its_updates_its_results_and_nothing_left() {
    let run = Run::new();
    let result =
        run.finish(&["--scenario", "grid4x4", "--updates", "3", "--actors", "2", "--eval-seeds", "1"]).json();
    assert_eq!(result["interrupted"], false);
    assert_eq!(result["updates"], 3);
    assert_none_left(&run.marker());
    assert_all_updates(&run, 3);

    let written: serde_json::Value =
        serde_json::from_slice(&std::fs::read(run.path().join("result.json")).unwrap()).unwrap();
    assert_eq!(written, result);
    let policies: Vec<_> = result["evaluation"]
        .as_array()
        .unwrap()
        .iter()
        .map(|report| report["policy"].as_str().unwrap())
        .collect();
    assert!(policies.contains(&"fixed-time"), "{policies:?}");
    // Each again in a file of its own, with what pages draw and the result is too short for.
    for (policy, report) in policies.iter().zip(result["evaluation"].as_array().unwrap()) {
        let file = run.path().join(format!("evaluation/grid4x4-{policy}.json"));
        let mut detailed: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
        let details = detailed.as_object_mut().unwrap().remove("details");
        assert!(details.is_some() && detailed == *report, "{policy}");
    }
    assert!(policies.iter().filter(|policy| policy.starts_with("max-pressure")).count() >= 2, "{policies:?}");
    assert!(
        result["strongest_max_pressure"]["grid4x4"].as_str().is_some_and(|name| policies.contains(&name)),
        "{result}"
    );

    let svg = std::fs::read_to_string(run.path().join("curves.svg")).unwrap();
    assert!(svg.contains("grid4x4") && svg.contains("<polyline"), "the curves are not drawn");
    let checkpoint = run.newest_checkpoint();
    assert_eq!(result["checkpoint"]["path"].as_str().unwrap(), checkpoint.display().to_string());
    for file in ["model.safetensors", "optimizer.safetensors", "metadata.json"] {
        assert!(checkpoint.join(file).is_file(), "{file} is missing");
    }
    for file in ["config.toml", "run.json", "logs/learner.log", "logs/actor-0.log", "logs/actor-1.log"] {
        assert!(run.path().join(file).is_file(), "{file} is missing");
    }

    // The policy that was trained is there for others to evaluate.
    let path = run.path().display().to_string();
    let report =
        run.call(&["eval", "--scenario", "grid4x4", "--policy", &path, "--seeds", "1", "--json"]).json();
    assert_eq!(report["seeds"], serde_json::json!([1]));
    assert!(report["metrics"]["trip_delay"]["mean"].is_number(), "{report}");
}

#[test]
fn killing_sumo_does_not_end_the_training() {
    killing_does_not_end_the_training("sumo");
}

#[test]
fn killing_an_actor_does_not_end_the_training() {
    killing_does_not_end_the_training("cross-actor");
}

#[test]
fn killing_the_learner_does_not_end_the_training() {
    killing_does_not_end_the_training("cross-learner");
}

fn killing_does_not_end_the_training(program: &str) {
    let run = Run::new();
    let updates = UPDATES.to_string();
    let mut training = run.start(&["--updates", &updates, "--actors", "2", "--eval-seeds", "0"]);
    training.wait_for_updates(2);
    training.kill_one(program);
    let result = training.wait().json();
    assert_eq!(result["updates"], UPDATES);
    assert_none_left(&run.marker());
    assert_all_updates(&run, UPDATES);
}
