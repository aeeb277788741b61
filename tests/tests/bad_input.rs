//! Whatever cannot work is refused with one sentence and the exit code for bad input; nothing panics or hangs.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::assert_none_left;
use cross_tests::runs::{Finished, Run, SMALL};
use cross_tests::scenarios::{junction, with_net};
use std::path::{Path, PathBuf};

/// A refused training: exit code 2, one sentence, no process, and no run directory that would stand in the way.
fn assert_training_refused(run: &Run, arguments: &[&str], parts: &[&str]) {
    let finished = run.finish(arguments);
    finished.assert_refused(parts);
    assert_none_left(&run.marker());
    assert!(!run.path().exists(), "a refused run leaves no directory behind");
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn an_unknown_configuration_key_is_named() {
    let run = Run::new();
    run.write_config(&format!("{SMALL}\n[learning]\nrate = 1\n"));
    assert_training_refused(&run, &[], &["small.toml", "learning"]);
    run.write_config("[ppo]\nclip_ration = 0.2\n");
    assert_training_refused(&run, &[], &["small.toml", "clip_ration"]);
    run.write_config("[ppo]\nclip_ratio = \"wide\"\n");
    assert_training_refused(&run, &[], &["small.toml", "clip_ratio"]);
    run.write_config("[ppo]\nclip_ratio = -1.0\n");
    assert_training_refused(&run, &[], &["ppo.clip_ratio", "-1"]);
}

#[test]
fn a_missing_sumo_is_named_with_the_remedy() {
    let run = Run::new();
    let empty = tempfile::tempdir().unwrap();
    let home = text(empty.path());
    assert_training_refused(&run, &["--sumo-home", &home], &[&home, "sumo"]);
    let arguments = ["eval", "--scenario", "grid4x4", "--policy", "fixed-time", "--sumo-home", &home];
    run.call(&arguments).assert_refused(&[&home]);
}

#[test]
fn an_unknown_scenario_is_answered_with_the_known_ones() {
    let run = Run::new();
    assert_training_refused(&run, &["--scenario", "grid5x4"], &["grid5x4", "grid4x4", "arterial4x4"]);
}

#[test]
fn an_unreadable_net_is_named() {
    let run = Run::new();
    let folder = tempfile::tempdir().unwrap();
    for (name, net) in [
        ("empty", ""),
        ("not-xml", "movements: 12\n"),
        ("cut-off", &junction(4, 2)[..600]),
        ("other-xml", "<routes><vehicle id=\"a\"/></routes>\n"),
    ] {
        let scenario = text(&with_net(folder.path(), name, net));
        assert_training_refused(&run, &["--scenario", &scenario], &[name, "net.net.xml"]);
        let arguments = ["eval", "--scenario", &scenario, "--policy", "fixed-time", "--seeds", "1"];
        run.call(&arguments).assert_refused(&[name, "net.net.xml"]);
    }
}

#[test]
fn too_many_movements_or_phases_are_refused_with_the_junction_and_both_numbers() {
    let run = Run::new();
    let folder = tempfile::tempdir().unwrap();
    let movements = text(&with_net(folder.path(), "movements", &junction(37, 4)));
    assert_training_refused(&run, &["--scenario", &movements], &["crossing", "37", "36"]);
    let phases = text(&with_net(folder.path(), "phases", &junction(18, 9)));
    assert_training_refused(&run, &["--scenario", &phases], &["crossing", "9", "8"]);
    // At the limit the scenario is fine, so that it is the limit that refused the others.
    let most = text(&with_net(folder.path(), "most", &junction(36, 8)));
    let info = run.call(&["scenario", "info", &most, "--json"]).json();
    assert_eq!(info["movements"]["max"], 36);
    assert_eq!(info["phases"]["max"], 8);
}

#[test]
fn options_that_contradict_each_other_are_refused() {
    let run = Run::new();
    assert_training_refused(&run, &["--serial", "--actors", "2"], &["--actors", "serial"]);
    assert_training_refused(&run, &["--resume"], &["no run to resume"]);
}

/// A run of one update, its checkpoints there to be damaged.
fn trained() -> Run {
    let run = Run::new();
    let _ = run.finish(&["--updates", "1", "--actors", "1", "--eval-seeds", "0"]).json();
    run
}

/// The files of this name in every checkpoint of a run.
fn files(run: &Run, name: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(run.path().join("checkpoints")).unwrap();
    let files: Vec<_> =
        entries.map(|entry| entry.unwrap().path().join(name)).filter(|file| file.is_file()).collect();
    assert!(!files.is_empty());
    files
}

#[test]
fn a_damaged_checkpoint_is_refused_everywhere_with_the_file_at_fault() {
    type Damage = fn(&Path);
    let cases: [(&str, Damage); 3] = [
        ("model.safetensors", |file| {
            let bytes = std::fs::read(file).unwrap();
            std::fs::write(file, &bytes[..bytes.len() / 2]).unwrap();
        }),
        ("model.safetensors", |file| {
            let mut bytes = std::fs::read(file).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 0x40;
            std::fs::write(file, bytes).unwrap();
        }),
        ("metadata.json", |file| std::fs::write(file, "{\"framework\": \"another\"}").unwrap()),
    ];
    let run = trained();
    let path = text(&run.path());
    for (file, damage) in cases {
        let whole: Vec<_> = files(&run, file).into_iter().map(|f| (std::fs::read(&f).unwrap(), f)).collect();
        whole.iter().for_each(|(_, f)| damage(f));
        let refuse = |finished: Finished| finished.assert_refused(&[file]);
        refuse(run.call(&["checkpoint", "verify", "latest", "--run", &path]));
        refuse(run.call(&["checkpoint", "export", "latest", "--run", &path, "--out", "/dev/null/never"]));
        refuse(run.call(&["eval", "--scenario", "grid4x4", "--policy", &path, "--seeds", "1"]));
        refuse(run.finish(&["--resume", "--updates", "2", "--eval-seeds", "0"]));
        assert_none_left(&run.marker());
        for (bytes, f) in whole {
            std::fs::write(f, bytes).unwrap();
        }
    }
    // Whole again, it is accepted again: nothing of the above was refused for another reason.
    let verified = run.call(&["checkpoint", "verify", "latest", "--run", &path, "--json"]).json();
    assert_eq!(verified["ok"], true);
}

#[test]
fn a_foreign_policy_file_is_refused() {
    let run = Run::new();
    let folder = tempfile::tempdir().unwrap();
    // A well-formed safetensors file of somebody else's: one tensor of two numbers.
    let header = r#"{"weight":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#;
    let mut foreign = (header.len() as u64).to_le_bytes().to_vec();
    foreign.extend_from_slice(header.as_bytes());
    foreign.extend_from_slice(&[0; 8]);
    for (name, bytes) in
        [("foreign.safetensors", foreign.as_slice()), ("empty.safetensors", b""), ("text", b"hello")]
    {
        let file = folder.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        let arguments = ["eval", "--scenario", "grid4x4", "--policy", &text(&file), "--seeds", "1"];
        run.call(&arguments).assert_refused(&[name]);
    }
}

#[test]
fn a_checkpoint_of_another_model_is_not_resumed_from() {
    let run = trained();
    run.write_config(&SMALL.replace("hidden = 16", "hidden = 32"));
    let config = text(&run.config());
    let finished = run.finish(&["--resume", "--config", &config, "--updates", "2", "--eval-seeds", "0"]);
    finished.assert_refused(&["model"]);
    assert_none_left(&run.marker());
    // The refusal has not touched the run.
    let resumed = run.finish(&["--resume", "--updates", "2", "--eval-seeds", "0"]).json();
    assert_eq!(resumed["updates"], 2);
}
