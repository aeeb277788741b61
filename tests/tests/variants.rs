//! The model's variants and the learner's devices, through `cross train`.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::assert_none_left;
use cross_tests::runs::{Run, SMALL};

/// [`SMALL`] with other keys in its `[model]`, and more sections at the end.
fn variant(model: &str, more: &str) -> String {
    let own: Vec<&str> = model.lines().filter_map(|line| line.split(" = ").next()).collect();
    let kept = SMALL.lines().filter(|line| !own.iter().any(|key| line.starts_with(&format!("{key} = "))));
    let text = kept.collect::<Vec<_>>().join("\n");
    text.replace("[model]", &format!("[model]\n{model}")) + more
}

#[test]
fn every_ablation_and_variant_trains() {
    let with_paper_detection = |text: String| text.replace("[env]", "[env]\ndetection = \"paper\"");
    for (name, config) in [
        (
            "the paper's form without clustering",
            with_paper_detection(variant("gfe = \"paper\"\npcc = false", "")),
        ),
        (
            "three of four experts, five centres, target detached",
            variant("experts = 4\ntop_k = 3\nclusters = 5\ndetach_contrastive_target = true", ""),
        ),
        ("without the mixture", variant("moe = false", "")),
    ] {
        let run = Run::new();
        run.write_config(&config);
        let result = run.finish(&["--updates", "1", "--actors", "1", "--eval-seeds", "0"]).json();
        assert_eq!(result["updates"], 1, "{name}");
        let line = &run.metrics()[0];
        let usage = |key: &str| line["scenarios"]["grid4x4"][key].as_array().unwrap().len();
        let (clusters, experts) = match name {
            "the paper's form without clustering" => (0, 2),
            "without the mixture" => (2, 0),
            _ => (5, 4),
        };
        assert_eq!((usage("cluster_usage"), usage("expert_usage")), (clusters, experts), "{name}");
        assert_eq!(line["losses"].get("actor_contrastive").is_some(), clusters > 0, "{name}");
        assert_none_left(&run.marker());
    }
}

#[test]
fn a_device_that_is_not_there_is_refused_before_anything_starts() {
    let run = Run::new();
    // So that libtorch finds no device on a machine that has one either.
    let without = |arguments: &[&str]| {
        let mut command = run.train(arguments);
        command.env("CUDA_VISIBLE_DEVICES", "");
        run.spawn(command).wait()
    };
    let finished = without(&["--device", "cuda", "--updates", "1"]);
    finished.assert_refused(&["cuda", "learner.device"]);
    assert_none_left(&run.marker());
    assert!(!run.path().exists(), "a refused run leaves no directory behind");
    // What takes the best there is takes the CPU, and says so.
    let result =
        without(&["--device", "auto", "--updates", "1", "--actors", "1", "--eval-seeds", "0"]).json();
    assert_eq!(result["updates"], 1);
    assert_eq!(run.metrics()[0]["device"], "cpu");
    let metadata = std::fs::read_to_string(run.newest_checkpoint().join("metadata.json")).unwrap();
    let metadata: serde_json::Value = serde_json::from_str(&metadata).unwrap();
    assert_eq!(metadata["device"], "cpu");
}
