//! The commands that look and tell.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::runs::Run;

#[test]
fn doctor_finds_this_machine_ready_and_a_missing_sumo_with_its_remedy() {
    let run = Run::new();
    let report = run.call(&["doctor", "--json"]).json();
    assert_eq!(report["ok"], true, "{report}");

    let nowhere = run.marker();
    let finished = run.call(&["doctor", "--json", "--sumo-home", &nowhere]);
    assert_eq!(finished.code, Some(1), "{}", finished.stderr);
    let report: serde_json::Value = serde_json::from_str(&finished.stdout).unwrap();
    let failed: Vec<_> =
        report["checks"].as_array().unwrap().iter().filter(|check| check["status"] == "failed").collect();
    assert_eq!(failed.len(), 1, "{failed:?}");
    assert_eq!(failed[0]["name"], "sumo");
    assert!(failed[0]["remedy"].as_str().unwrap().contains("make build"), "{failed:?}");
}

#[test]
fn scenarios_are_listed_and_described() {
    let run = Run::new();
    let list = run.call(&["scenario", "list", "--json"]).json();
    let names: Vec<_> = list["scenarios"]
        .as_array()
        .unwrap()
        .iter()
        .map(|scenario| scenario["name"].as_str().unwrap())
        .collect();
    assert!(names.contains(&"grid4x4") && names.contains(&"arterial4x4"), "{names:?}");

    let info = run.call(&["scenario", "info", "grid4x4", "--json"]).json();
    assert_eq!(info["intersections"], 16);
    assert_eq!(info["movements"], serde_json::json!({ "min": 36, "max": 36 }));
    assert_eq!(info["phases"], serde_json::json!({ "min": 8, "max": 8 }));
    assert_eq!((&info["lanes"], &info["signalised_lanes"]), (&240.into(), &192.into()));
    assert_eq!((&info["vehicles"], &info["duration_seconds"]), (&1473.into(), &3600.into()));
}

#[test]
fn checkpoints_are_listed_shown_exported_published_and_evaluated() {
    let run = Run::new();
    let _ = run.finish(&["--updates", "2", "--actors", "1", "--eval-seeds", "0"]).json();
    let path = run.path().display().to_string();

    let list = run.call(&["checkpoint", "list", "--run", &path, "--json"]).json();
    let checkpoints = list["checkpoints"].as_array().unwrap();
    assert_eq!(checkpoints[0]["updates"], 2, "newest first");
    assert_eq!(checkpoints[0]["latest"], true);
    let id = checkpoints[0]["id"].as_str().unwrap();

    let shown = run.call(&["checkpoint", "show", id, "--run", &path, "--json"]).json();
    assert_eq!(shown["metadata"]["updates"], 2);
    assert_eq!(shown["metadata"]["versions"]["libtorch"], "2.11.0");
    assert!(!shown["tensors"].as_array().unwrap().is_empty());

    let file = run.path().join("policy.safetensors").display().to_string();
    let _ = run.call(&["checkpoint", "export", "latest", "--out", &file, "--run", &path, "--json"]).json();
    let metrics = |policy: &str| {
        let arguments = ["eval", "--scenario", "grid4x4", "--policy", policy, "--seeds", "1", "--json"];
        run.call(&arguments).json()["metrics"].clone()
    };
    assert_eq!(metrics(&file), metrics(&path), "the exported policy is the checkpoint's");

    run.call(&["checkpoint", "show", "000999", "--run", &path]).assert_refused(&["000999"]);

    // What is published has a description, and is a policy.
    let folder = run.path().join("published").display().to_string();
    let publish = |last: &str| {
        run.call(&["checkpoint", "publish", "--last", last, "--out", &folder, "--run", &path, "--json"])
    };
    assert_eq!(publish("1").json()["averaged"], serde_json::json!([]));
    assert_eq!(metrics(&folder), metrics(&path), "the newest alone is as it was");
    let both = publish("2").json();
    assert_eq!(both["averaged"], serde_json::json!([checkpoints[1]["id"], checkpoints[0]["id"]]));
    assert_eq!(both["id"], checkpoints[0]["id"]);
    let metadata = std::fs::read(std::path::Path::new(&folder).join("metadata.json")).unwrap();
    let metadata: serde_json::Value = serde_json::from_slice(&metadata).unwrap();
    assert_eq!(metadata["files"].as_object().unwrap().keys().collect::<Vec<_>>(), ["model.safetensors"]);
    assert!(metrics(&folder).is_object(), "the mean is a policy");
    let checkpoint = checkpoints[0]["path"].as_str().unwrap();
    let over = ["checkpoint", "publish", "--out", checkpoint, "--run", &path];
    run.call(&over).assert_refused(&[checkpoint, "--out"]);
    publish("99").assert_refused(&["99", "--last", "keep_checkpoints"]);
}

#[test]
fn an_evaluation_depends_on_its_seeds_alone() {
    let run = Run::new();
    let report = |seeds: &str, workers: &str| {
        let arguments = ["eval", "--scenario", "grid4x4", "--policy", "random", "--workers", workers];
        let mut command = run.cross(&arguments);
        command.args(["--seeds", seeds, "--json", "--config"]).arg(run.config());
        run.spawn(command).wait().json()
    };
    let two = report("2", "2");
    assert_eq!(two, report("2", "1"));
    assert_eq!(two["seeds"], serde_json::json!([1, 2]));
    assert_eq!(two["protocol"]["episode_seconds"], 200);
    assert_eq!(two["per_seed"][0], report("1", "1")["per_seed"][0]);
    assert_ne!(two["per_seed"][0]["metrics"], two["per_seed"][1]["metrics"]);
}

#[test]
fn wrong_usage_is_exit_code_2_and_help_is_exit_code_0() {
    let run = Run::new();
    for arguments in [&["--bogus"][..], &["train", "--updates", "none"], &["eval"], &["checkpoint", "steal"]]
    {
        let finished = run.call(arguments);
        assert_eq!((finished.code, finished.stdout.as_str()), (Some(2), ""), "{arguments:?}");
    }
    for arguments in
        [&["--help"][..], &["train", "--help"], &["eval", "--help"], &["checkpoint", "list", "--help"]]
    {
        let finished = run.call(arguments);
        assert_eq!(finished.code, Some(0), "{arguments:?}");
        assert!(finished.stdout.contains("Usage: cross"), "{}", finished.stdout);
    }
    let version = run.call(&["--version"]).stdout;
    assert!(version.contains("protocol 1") && version.contains("libtorch 2.11.0"), "{version}");
}
