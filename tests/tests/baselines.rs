//! `cross baselines` and `cross results`: tables of policies, on a small grid that takes a moment.
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
use sha2::{Digest, Sha256};
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

/// The policy that the project publishes.
fn published() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../pretrained/default").display().to_string()
}

#[test]
fn the_published_policy_stands_beside_the_rules() {
    let small = Small::new(300);
    let call = |more: &[&str]| {
        let mut command =
            small.run.cross(&["results", "--scenario", &small.town(), "--policy", &published()]);
        command.args(["--seeds", "1", "--out"]).arg(small.results()).args(more);
        small.run.spawn(command).wait()
    };
    let report = call(&["--json"]).json();
    let policies = report["scenarios"][0]["policies"].as_array().unwrap();
    assert_eq!(policies.len(), 5, "Fixed-Time, three variants of Max-Pressure, and it");
    let learned = &policies[4];
    assert_eq!(
        (&learned["policy"], &learned["learned"]["trained_here"]),
        (&json!(published()), &json!(false))
    );
    // A file alone does not tell what it was trained on.
    let mut command = small.run.cross(&["results", "--seeds", "1", "--json", "--scenario", &small.town()]);
    command
        .arg("--policy")
        .arg(format!("{}/model.safetensors", published()))
        .arg("--out")
        .arg(small.results());
    let file = small.run.spawn(command).wait().json();
    assert_eq!(file["scenarios"][0]["policies"][4]["learned"]["trained_here"], Value::Null);
    small
        .run
        .call(&["results", "--policy", "greedy", "--scenario", &small.town()])
        .assert_refused(&["greedy", "baselines"]);
    assert!(learned["metrics"]["trip_delay"]["mean"].as_f64().unwrap() > 0.0, "{learned}");
    // Streets that it has never seen, and yet it is no worse than a clock.
    let delay = |policy: &Value| policy["metrics"]["trip_delay"]["mean"].as_f64().unwrap();
    assert!(delay(learned) < delay(&policies[0]), "{policies:?}");

    // One picture of the scenario, with curves of three policies, and experts and clusters of the learned one.
    let (pictures, file) = (small.folder.path().join("pictures"), small.folder.path().join("page.md"));
    let (folder, markdown) = (pictures.display().to_string(), file.display().to_string());
    let drawn = call(&["--pictures", &folder, "--markdown", &markdown]);
    assert!(drawn.stderr.contains("5 of 5 episodes are in"), "{}", drawn.stderr);
    assert!(std::fs::read_to_string(&file).unwrap().contains("](<pictures/town.svg>)"));
    let svg = std::fs::read_to_string(pictures.join("town.svg")).unwrap();
    assert!(svg.matches("<polyline").count() >= 2 * 3, "{svg}");
    for part in ["fixed-time", "experts over time", "clusters by intersection"] {
        assert!(svg.contains(part), "{part} is not in the picture");
    }
    let stored = small.results().join("town").read_dir().unwrap().map(|entry| entry.unwrap().path());
    let learned = stored.into_iter().find(|path| path.display().to_string().contains("weights-")).unwrap();
    let learned: Value =
        serde_json::from_slice(&std::fs::read(learned.join("seed-1.json")).unwrap()).unwrap();
    let minutes = learned["series"]["queue_length"].as_array().unwrap().len().div_ceil(6);
    for part in ["experts", "clusters"] {
        let shares = learned["routing"][part]["over_time"].as_array().unwrap();
        assert_eq!(shares.len(), minutes, "{part}");
        let sum: f64 = shares[0].as_array().unwrap().iter().map(|share| share.as_f64().unwrap()).sum();
        assert!((sum - 1.0).abs() < 1e-3, "{part}: {sum}");
    }
    let sampled = call(&["--sampled", "--json"]);
    assert!(sampled.stderr.contains("5 of 6 episodes are in"), "{}", sampled.stderr);
    let sampled = sampled.json();
    let drawn = &sampled["scenarios"][0]["policies"][5];
    assert_eq!(drawn["policy"], json!(format!("{}, sampled", published())));
    assert_ne!(drawn["metrics"], sampled["scenarios"][0]["policies"][4]["metrics"], "it acts otherwise");
    call(&["--pictures", "/dev/null/pictures"]).assert_refused(&["/dev/null/pictures", "--pictures"]);

    let page = call(&[]);
    assert!(page.stderr.contains("5 of 5 episodes are in"), "{}", page.stderr);
    for part in ["# Results", "zero-shot", "## town", "## Who is ahead", "--seeds 1`"] {
        assert!(page.stdout.contains(part), "{part} is not in {}", page.stdout);
    }
    assert_none_left(&small.run.marker());
}

#[test]
fn other_weights_are_another_policy() {
    let small = Small::new(300);
    let weights = small.folder.path().join("weights");
    std::fs::create_dir(&weights).unwrap();
    let call = |bytes: &[u8]| {
        std::fs::write(weights.join("policy.safetensors"), bytes).unwrap();
        let path = weights.join("policy.safetensors").display().to_string();
        let mut command = small.run.cross(&["results", "--scenario", &small.town(), "--policy", &path]);
        command.args(["--seeds", "1", "--json", "--out"]).arg(small.results());
        small.run.spawn(command).wait()
    };
    let mut bytes = std::fs::read(Path::new(&published()).join("model.safetensors")).unwrap();
    assert!(!call(&bytes).stderr.contains("episodes are in"));
    // The last bytes are a weight's.
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    assert!(
        call(&bytes).stderr.contains("4 of 5 episodes are in"),
        "the rules' count, the policy's does not"
    );
}

#[test]
fn the_published_policy_is_what_its_configuration_gives() {
    let run = Run::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for entry in std::fs::read_dir(root.join("pretrained")).unwrap() {
        let folder = entry.unwrap().path();
        if !folder.is_dir() {
            continue;
        }
        let name = folder.file_name().unwrap().to_str().unwrap().to_owned();
        let metadata: Value =
            serde_json::from_slice(&std::fs::read(folder.join("metadata.json")).unwrap()).unwrap();
        let own = cross_config::Config::from_json(&metadata["config"].to_string(), &name).unwrap();
        let file = root.join("configs").join(&name).with_extension("toml");
        assert_eq!(own, cross_config::Config::from_file(&file).unwrap(), "{name}");
        assert_eq!(metadata["updates"], own.updates, "{name}: trained to its end");
        // The optimiser's state is of no use here and larger than the weights.
        let files = metadata["files"].as_object().unwrap();
        assert_eq!(files.keys().collect::<Vec<_>>(), ["model.safetensors"], "{name}");
        let bytes = std::fs::read(folder.join("model.safetensors")).unwrap();
        let hash = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        assert_eq!(files["model.safetensors"]["sha256"], hash, "{name}");
        assert!(bytes.len() < 5 << 20, "{name}: a few megabytes at most");
        // What it was trained on is still what these names mean: else pages would call it zero-shot there.
        for (scenario, layout) in metadata["layouts"].as_object().unwrap() {
            let info = run.call(&["scenario", "info", scenario, "--json"]).json();
            assert_eq!(info["hashes"]["layout"], *layout, "{name}: {scenario}");
        }
    }
}
