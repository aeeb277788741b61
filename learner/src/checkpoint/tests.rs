//! Checkpoints through damage, crashes and full disks.

use super::*;
use crate::admission::Progress;
use cross_model::TrainerFiles;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io;
use std::path::Path;
use std::time::{Duration, UNIX_EPOCH};

pub(super) const COMPATIBLE: &str = "0123456789abcdef";

pub(super) fn metadata(updates: u64) -> Metadata {
    let config = cross_config::Config::default();
    Metadata {
        format: FORMAT.to_owned(),
        format_version: FORMAT_VERSION,
        id: String::new(),
        run_id: "run".to_owned(),
        created: rfc3339(UNIX_EPOCH),
        created_unix_ms: 0,
        updates,
        policy_version: updates + 1,
        decisions: 10,
        episodes: 2,
        seed: 1,
        episode_return: BTreeMap::from([("grid4x4".to_owned(), -12.5)]),
        config_hash: config.hash(),
        compatibility_hash: COMPATIBLE.to_owned(),
        layouts: BTreeMap::new(),
        versions: Versions::default(),
        device: String::new(),
        averaged: Vec::new(),
        files: BTreeMap::new(),
        progress: Progress { updates, next_episode: 3, ..Progress::default() },
        config: serde_json::from_str(&config.to_json()).unwrap(),
    }
}

pub(super) fn files(byte: u8) -> TrainerFiles {
    let tensor = |name: &str| {
        let data = [byte; 8];
        let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, vec![2], &data).unwrap();
        safetensors::serialize([(name, view)], None::<HashMap<String, String>>).unwrap()
    };
    TrainerFiles { model: tensor("w"), optimizer: tensor("w.adam_m") }
}

pub(crate) fn run_with(updates: &[u64]) -> tempfile::TempDir {
    let run = tempfile::tempdir().unwrap();
    let store = Store::open(run.path(), 10).unwrap();
    for &updates in updates {
        store.write(&files(updates as u8), metadata(updates)).unwrap();
    }
    run
}

fn ids(run: &Path) -> Vec<String> {
    reader::list(run).unwrap().into_iter().map(|entry| entry.id).collect()
}

#[test]
fn what_is_written_reads_back_and_latest_names_it() {
    let run = run_with(&[1, 12]);
    assert_eq!(ids(run.path()), ["000012", "000001"]);
    let path = reader::find(run.path(), "latest").unwrap();
    assert!(path.ends_with("000012"));
    let checkpoint = reader::read(&path).unwrap();
    assert_eq!(checkpoint.files, files(12));
    assert_eq!(checkpoint.metadata.id, "000012");
    assert_eq!(checkpoint.metadata.progress.next_episode, 3);
    assert_eq!(reader::verify(&path).unwrap(), checkpoint.metadata);
    let tensors = reader::tensors(&path).unwrap();
    assert_eq!(tensors, [Tensor { name: "w".to_owned(), dtype: "F32".to_owned(), shape: vec![2] }]);
}

#[test]
fn old_ones_are_pruned_but_never_the_latest() {
    let run = tempfile::tempdir().unwrap();
    let store = Store::open(run.path(), 2).unwrap();
    for updates in [1, 2, 3, 4] {
        store.write(&files(1), metadata(updates)).unwrap();
    }
    assert_eq!(ids(run.path()), ["000004", "000003"]);
    // After going back to an earlier update, the latest is not the one of the highest number.
    store.write(&files(1), metadata(2)).unwrap();
    assert!(reader::find(run.path(), "latest").unwrap().ends_with("000002"));
    assert_eq!(ids(run.path()), ["000004", "000002"]);
}

#[test]
fn writing_the_same_update_again_replaces_it() {
    let run = run_with(&[5]);
    let store = Store::open(run.path(), 10).unwrap();
    store.write(&files(99), metadata(5)).unwrap();
    assert_eq!(reader::read(&reader::find(run.path(), "000005").unwrap()).unwrap().files, files(99));
    let left: Vec<_> =
        fs::read_dir(run.path().join(FOLDER)).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
}

#[test]
fn every_damage_gives_one_sentence_that_names_the_file() {
    type Damage = fn(&Path);
    let cases: [(&str, &str, Damage); 7] = [
        ("model.safetensors", "cut off", |p| {
            let bytes = fs::read(p.join(MODEL_FILE)).unwrap();
            fs::write(p.join(MODEL_FILE), &bytes[..bytes.len() / 2]).unwrap();
        }),
        ("optimizer.safetensors", "SHA-256", |p| {
            let mut bytes = fs::read(p.join(OPTIMIZER_FILE)).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            fs::write(p.join(OPTIMIZER_FILE), bytes).unwrap();
        }),
        ("optimizer.safetensors", "has no", |p| fs::remove_file(p.join(OPTIMIZER_FILE)).unwrap()),
        ("metadata.json", "has no", |p| fs::remove_file(p.join(METADATA_FILE)).unwrap()),
        ("metadata.json", "not valid JSON", |p| fs::write(p.join(METADATA_FILE), "{\"format\": ").unwrap()),
        ("metadata.json", "not text", |p| fs::write(p.join(METADATA_FILE), [0xff, 0xfe]).unwrap()),
        ("metadata.json", "format", |p| fs::write(p.join(METADATA_FILE), "{\"step\": 3}").unwrap()),
    ];
    for (file, words, damage) in cases {
        let run = run_with(&[1, 2]);
        let path = reader::find(run.path(), "latest").unwrap();
        damage(&path);
        let error = reader::read(&path).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(file) && text.contains(words) && !text.contains('\n'), "{text}");
        assert!(error.is_corrupt());
        assert!(
            reader::verify(&path).is_err() && reader::load_policy(run.path()).is_err()
                || file.starts_with("opt")
        );
        // A run goes on from the one before, and says what is wrong with the newest.
        let resumed = reader::resume(run.path(), COMPATIBLE).unwrap().unwrap();
        assert_eq!(resumed.checkpoint.metadata.updates, 1);
        assert_eq!(resumed.skipped[0].to_string(), text);
        Store::open(run.path(), 10).unwrap().go_on_from(&resumed.checkpoint.metadata.id).unwrap();
        assert!(reader::find(run.path(), "latest").unwrap().ends_with("000001"));
        assert!(run.path().join(FOLDER).join("damaged-000002").is_dir());
        fs::rename(run.path().join(FOLDER).join("damaged-000002"), &path).unwrap();
        damage(&run.path().join(FOLDER).join("000001"));
        let none = reader::resume(run.path(), COMPATIBLE).unwrap_err().to_string();
        assert!(none.contains("none of the 2") && none.contains(&text), "{none}");
    }
}

#[test]
fn another_configuration_is_refused_by_name_and_not_passed_over() {
    let run = run_with(&[1]);
    let error = reader::resume(run.path(), "feedfeedfeedfeed").unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains(COMPATIBLE) && text.contains("feedfeedfeedfeed") && text.contains("000001"),
        "{text}"
    );
    assert!(!error.is_corrupt());
}

#[test]
fn what_is_not_damaged_is_never_passed_over() {
    type Obstacle = fn(&Path);
    let cases: [(&str, Obstacle); 2] = [
        ("has checkpoint format 9", |p| {
            let text = "{\"format\": \"cross-checkpoint\", \"format_version\": 9}";
            fs::write(p.join(METADATA_FILE), text).unwrap();
        }),
        // The system refuses to read it; taking away permissions would not stop root, under whom tests may run.
        ("cannot read", |p| {
            fs::remove_file(p.join(MODEL_FILE)).unwrap();
            fs::create_dir(p.join(MODEL_FILE)).unwrap();
        }),
    ];
    for (words, obstacle) in cases {
        let run = run_with(&[1, 2]);
        obstacle(&run.path().join(FOLDER).join("000002"));
        let error = reader::resume(run.path(), COMPATIBLE).unwrap_err();
        assert!(!error.is_corrupt());
        let text = error.to_string();
        assert!(text.contains(words) && text.contains("000002"), "{text}");
        assert_eq!(ids(run.path()), ["000002", "000001"]);
    }
}

/// A process was killed after a checkpoint got its name and before `latest` moved.
#[test]
fn latest_follows_the_checkpoint_that_a_run_goes_on_from() {
    let run = run_with(&[1, 2]);
    let latest = run.path().join(FOLDER).join(LATEST_FILE);
    for stale in [Some("000001\n"), None] {
        match stale {
            Some(text) => fs::write(&latest, text).unwrap(),
            None => fs::remove_file(&latest).unwrap(),
        }
        let resumed = reader::resume(run.path(), COMPATIBLE).unwrap().unwrap();
        assert!(resumed.skipped.is_empty());
        Store::open(run.path(), 10).unwrap().go_on_from(&resumed.checkpoint.metadata.id).unwrap();
        assert!(reader::find(run.path(), "latest").unwrap().ends_with("000002"));
        assert_eq!(ids(run.path()), ["000002", "000001"]);
    }
}

/// A process was killed while it replaced `latest`, which goes through a file, not a directory.
#[test]
fn whatever_lies_aside_is_cleared_away() {
    let run = run_with(&[1]);
    let folder = run.path().join(FOLDER);
    fs::write(folder.join(".aside-Xy12ab"), "0000").unwrap();
    fs::create_dir(folder.join(".aside-000002")).unwrap();
    fs::write(folder.join(".aside-000002").join(MODEL_FILE), "half").unwrap();
    Store::open(run.path(), 10).unwrap();
    let mut left: Vec<_> = fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["000001", LATEST_FILE]);
}

#[test]
fn a_run_without_checkpoints_is_no_error_and_an_unknown_id_is_one() {
    let run = tempfile::tempdir().unwrap();
    assert!(reader::resume(run.path(), COMPATIBLE).unwrap().is_none());
    assert!(reader::list(run.path()).unwrap().is_empty());
    for id in ["latest", "000009", "../..", "", "9", "abcdef"] {
        let error = reader::find(run.path(), id).unwrap_err();
        assert!(matches!(error, CheckpointError::NotFound { .. }), "{id}: {error}");
    }
}

#[test]
fn policies_load_from_run_checkpoint_and_exported_file() {
    let run = run_with(&[1, 2]);
    let out = run.path().join("policy.safetensors");
    reader::export(&reader::find(run.path(), "000002").unwrap(), &out).unwrap();
    let folder = run.path().join(FOLDER);
    for path in [run.path().to_owned(), folder.join("000002"), folder.join(LATEST_FILE), out.clone()] {
        assert_eq!(reader::load_policy(&path).unwrap().1, files(2).model);
    }
    fs::write(&out, b"something else").unwrap();
    assert!(reader::load_policy(&out).unwrap_err().to_string().contains("policy.safetensors"));
    assert!(reader::load_policy(&run.path().join("nowhere")).is_err());
}

#[test]
fn a_full_disk_leaves_the_previous_checkpoint_whole() {
    fn full(path: &Path, bytes: &[u8]) -> io::Result<()> {
        fs::write(path, &bytes[..bytes.len() / 2])?;
        if path.ends_with(METADATA_FILE) { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }
    let run = run_with(&[1]);
    let store = Store::open(run.path(), 10).unwrap().writing_with(full);
    let error = store.write(&files(2), metadata(2)).unwrap_err().to_string();
    assert!(error.contains("cannot write") && error.contains(METADATA_FILE), "{error}");
    assert_eq!(ids(run.path()), ["000001"]);
    reader::verify(&reader::find(run.path(), "latest").unwrap()).unwrap();
    // Space again: the next one succeeds.
    Store::open(run.path(), 10).unwrap().write(&files(3), metadata(3)).unwrap();
    assert!(reader::find(run.path(), "latest").unwrap().ends_with("000003"));
}

/// The writing process is killed by the kernel in the middle of a file: it may write 16 KiB and no more.
#[test]
fn a_process_killed_while_writing_leaves_the_previous_checkpoint_whole() {
    const RUN: &str = "CROSS_TEST_TORN_WRITE";
    if let Some(run) = std::env::var_os(RUN) {
        let large = TrainerFiles { model: vec![1; 64 * 1024], ..files(2) };
        let _ = Store::open(Path::new(&run), 10).unwrap().write(&large, metadata(2));
        return;
    }
    let run = run_with(&[1]);
    let name = "checkpoint::tests::a_process_killed_while_writing_leaves_the_previous_checkpoint_whole";
    let status = std::process::Command::new("/bin/sh")
        .args(["-c", "ulimit -c 0; ulimit -f 16; exec \"$0\" --exact \"$1\" --nocapture"])
        .arg(std::env::current_exe().unwrap())
        .arg(name)
        .env(RUN, run.path())
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .status()
        .unwrap();
    assert!(!status.success(), "the write was not interrupted");
    assert_eq!(ids(run.path()), ["000001"]);
    reader::verify(&reader::find(run.path(), "latest").unwrap()).unwrap();
    let names = || fs::read_dir(run.path().join(FOLDER)).unwrap().count();
    assert_eq!(names(), 3, "half a checkpoint lies aside");
    Store::open(run.path(), 10).unwrap();
    assert_eq!(names(), 2, "and is cleared away");
}

#[test]
fn times_are_written_as_rfc_3339() {
    for (seconds, expected) in [
        (0, "1970-01-01T00:00:00Z"),
        (951_782_399, "2000-02-28T23:59:59Z"),
        (951_782_400, "2000-02-29T00:00:00Z"),
        (951_868_800, "2000-03-01T00:00:00Z"),
        (1_763_780_645, "2025-11-22T03:04:05Z"),
        (4_107_542_400, "2100-03-01T00:00:00Z"),
    ] {
        assert_eq!(rfc3339(UNIX_EPOCH + Duration::from_secs(seconds)), expected);
    }
}
