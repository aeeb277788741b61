//! Checkpoints: files that a run wrote, or that somebody calls one.

use crate::{Outcome, mutate, parts};
use cross_config::Config;
use cross_learner::checkpoint::{
    self, CheckpointError, FOLDER, FileInfo, LATEST_FILE, METADATA_FILE, MODEL_FILE, Metadata,
    OPTIMIZER_FILE, reader,
};
use cross_learner::metrics_log::Line;
use cross_model::Trainer;
use cross_model::snapshot::{self, File, OPTIMIZER_FORMAT, POLICY_FORMAT};
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::TempDir;

/// How errors call the input.
const NAME: &str = "fuzzed.input";

/// A policy or optimiser file, as far as it is read before libtorch has to do with it.
pub(super) fn safetensors(input: &[u8]) -> Outcome {
    let tensors = reader::tensors_of(input, Path::new(NAME));
    match &tensors {
        Ok(tensors) => assert!(tensors.windows(2).all(|pair| pair[0].name <= pair[1].name)),
        Err(error) => assert!(error.to_string().contains(NAME), "{error}"),
    }
    let mut accepted = tensors.is_ok();
    match snapshot::read_metadata(input) {
        Ok(metadata) => {
            // Networks are built by these, so they have to be possible.
            let config = Config { env: metadata.env, model: metadata.model, ..Config::default() };
            assert!(config.env.validate().is_ok() && config.model.validate().is_ok());
        }
        Err(error) => {
            accepted = false;
            assert!(!error.to_string().is_empty());
        }
    }
    for format in [POLICY_FORMAT, OPTIMIZER_FORMAT] {
        if let Ok(file) = File::read(input, format, "file") {
            let _ = black_box((file.value::<u64>("updates").is_ok(), file.json::<[u64; 2]>("rng").is_ok()));
        }
    }
    if accepted { Outcome::Accepted } else { Outcome::Refused }
}

/// A `metadata.json`; every line of it also as one of `metrics.jsonl`.
pub(super) fn metadata(input: &[u8]) -> Outcome {
    let Ok(text) = std::str::from_utf8(input) else { return Outcome::Refused };
    for line in text.lines() {
        let _ = black_box(serde_json::from_str::<Line>(line).is_ok());
    }
    match Metadata::parse(text, Path::new(NAME)) {
        Ok(metadata) => {
            let _ = black_box(checkpoint::rfc3339(metadata.created_at()));
            let _ = black_box(Config::from_json(&metadata.config.to_string(), NAME).is_ok());
            let json = serde_json::to_string(&metadata).unwrap_or_default();
            assert!(Metadata::parse(&json, Path::new(NAME)).is_ok_and(|again| again == metadata));
            Outcome::Accepted
        }
        Err(error) => {
            assert!(error.to_string().contains(NAME), "{error}");
            Outcome::Refused
        }
    }
}

/// Words in a fuzzed `metadata.json` that stand for what is right for the files beside it: a hash cannot be guessed.
const RIGHT: [&str; 4] = ["MODEL_BYTES", "MODEL_HASH", "OPTIMIZER_BYTES", "OPTIMIZER_HASH"];

thread_local! {
    /// Written anew for each input, in memory where the system has such a place.
    static RUN: Option<(TempDir, PathBuf)> = run().ok();
}

fn run() -> std::io::Result<(TempDir, PathBuf)> {
    let memory = Path::new("/dev/shm");
    let run = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }?;
    let checkpoint = run.path().join(FOLDER).join(ID);
    std::fs::create_dir_all(&checkpoint)?;
    Ok((run, checkpoint))
}

const ID: &str = "000001";

/// A run directory with one checkpoint: `latest`, `metadata.json`, model, optimiser.
pub(super) fn directory(input: &[u8]) -> Outcome {
    let [latest, metadata, model, optimizer] = parts::split(input);
    let mut text = String::from_utf8_lossy(metadata).into_owned();
    if text.contains('_') {
        let (model, optimizer) = (FileInfo::of(model), FileInfo::of(optimizer));
        let right = [model.bytes.to_string(), model.sha256, optimizer.bytes.to_string(), optimizer.sha256];
        for (word, right) in RIGHT.iter().zip(&right) {
            text = text.replacen(word, right, 1);
        }
    }
    RUN.with(|run| {
        // Without a place to write to nothing is fuzzed, and the corpus would show it by refusing all.
        let Some((run, checkpoint)) = run else { return Outcome::Refused };
        let folder = run.path().join(FOLDER);
        let files: [(PathBuf, &[u8]); 4] = [
            (folder.join(LATEST_FILE), latest),
            (checkpoint.join(METADATA_FILE), text.as_bytes()),
            (checkpoint.join(MODEL_FILE), model),
            (checkpoint.join(OPTIMIZER_FILE), optimizer),
        ];
        if files.iter().any(|(path, bytes)| std::fs::write(path, bytes).is_err()) {
            return Outcome::Refused;
        }
        read(run.path(), checkpoint)
    })
}

fn read(run: &Path, checkpoint: &Path) -> Outcome {
    let named = |error: &CheckpointError| {
        let text = error.to_string();
        assert!(text.contains(&*run.to_string_lossy()), "{text}");
    };
    match reader::find(run, LATEST_FILE) {
        // No content of `latest` leads out of the folder.
        Ok(found) => assert_eq!(found, checkpoint),
        Err(error) => named(&error),
    }
    match reader::list(run) {
        Ok(entries) => assert_eq!(entries.len(), 1),
        Err(error) => named(&error),
    }
    let _ = black_box(reader::tensors(checkpoint).is_ok());
    let _ = black_box(reader::load_policy(run).is_ok());
    let verified = reader::verify(checkpoint);
    match reader::resume(run, &Config::default().compatibility_hash()) {
        Ok(Some(resumed)) => {
            assert!(resumed.skipped.is_empty());
            assert_eq!(
                FileInfo::of(&resumed.checkpoint.files.model),
                resumed.checkpoint.metadata.files[MODEL_FILE]
            );
        }
        Ok(None) => assert!(verified.is_err(), "a checkpoint that is whole is found"),
        Err(error) => named(&error),
    }
    Outcome::of(&verified)
}

pub(super) fn mutate(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    let text = mutate::text::json as mutate::Mutator;
    let tensors = mutate::wire::safetensors as mutate::Mutator;
    mutate::parts(input, most, rng, [mutate::text::lines, text, tensors, tensors]);
}

/// What a trainer of very small networks writes.
static FILES: LazyLock<Option<cross_model::TrainerFiles>> = LazyLock::new(|| {
    let mut config = Config::default();
    (config.model.hidden, config.model.latent, config.model.heads) = (8, 2, 1);
    (config.model.experts, config.model.clusters, config.model.top_k) = (1, 2, 1);
    (config.model.pcc, config.model.moe) = (false, false);
    Trainer::new(&config, Vec::new()).ok()?.save().ok()
});

/// A policy file and an optimiser file, cut down to the header and a few tensors.
pub(super) fn files() -> Vec<Vec<u8>> {
    let files = FILES.as_ref();
    files.map(|files| vec![small(&files.model), small(&files.optimizer)]).unwrap_or_default()
}

/// The first tensors of a file, with its metadata.
fn small(bytes: &[u8]) -> Vec<u8> {
    let shortened = || {
        let length = usize::try_from(u64::from_le_bytes(*bytes.first_chunk::<8>()?)).ok()?;
        let (header, data) = bytes.get(8..)?.split_at_checked(length)?;
        let mut header: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(header).ok()?;
        // Those whose data stands first and is small.
        header.retain(|name, tensor| {
            name == "__metadata__" || tensor["data_offsets"][1].as_u64().is_some_and(|end| end <= 400)
        });
        let ends = header.values().filter_map(|tensor| tensor["data_offsets"][1].as_u64());
        let end = usize::try_from(ends.max().unwrap_or(0)).ok()?;
        let header = serde_json::to_vec(&header).ok()?;
        Some([&(header.len() as u64).to_le_bytes()[..], &header, data.get(..end)?].concat())
    };
    shortened().unwrap_or_else(|| bytes.to_vec())
}

fn description() -> serde_json::Value {
    let file = |which: &str| serde_json::json!({"bytes": format!("{which}_BYTES"), "sha256": format!("{which}_HASH")});
    serde_json::json!({
        "format": checkpoint::FORMAT, "format_version": checkpoint::FORMAT_VERSION, "id": ID, "run_id": "r",
        "created": "2026-01-01T00:00:00Z", "created_unix_ms": 1_767_225_600_000_u64, "updates": 1, "policy_version": 2,
        "decisions": 5760, "episodes": 1, "seed": 1, "episode_return": {"grid4x4": -12.5}, "config_hash": "0123456789abcdef",
        "compatibility_hash": Config::default().compatibility_hash(), "layouts": {"grid4x4": "0123456789abcdef"},
        "versions": {"cross": "0.1.0", "sumo": "1.28.0", "libtorch": "2.11.0"}, "device": "cpu",
        "files": {MODEL_FILE: file("MODEL"), OPTIMIZER_FILE: file("OPTIMIZER")},
        "progress": {"updates": 1, "next_episode": 2, "episodes": 1, "decisions": 5760, "scenarios":
            {"grid4x4": {"episodes": 1, "decisions": 5760, "episode_return": -12.5, "queue_length": null}}},
        "config": serde_json::to_value(Config::default()).unwrap_or_default(),
    })
}

/// A description, and a line of `metrics.jsonl`.
pub(super) fn descriptions() -> Vec<Vec<u8>> {
    let text = description().to_string();
    let text = RIGHT.iter().fold(text, |text, word| {
        let right = if word.ends_with("BYTES") { "12" } else { "\"00\"" };
        text.replace(&format!("\"{word}\""), right)
    });
    let line = serde_json::json!({
        "update": 1, "policy_version": 2, "decisions": 5760, "episodes": 1, "losses": {"actor": 0.5}, "diagnostics": {},
        "scenarios": {"grid4x4": {"episodes": 1, "decisions": 5760, "episode_return": null, "queue_length": 0.5}},
        "expert_usage": [1.0], "cluster_usage": [0.5, 0.5], "lag": {"min": 0, "mean": 0.0, "max": 0}, "time": 1.5,
        "timing": {"collect_seconds": 1.0, "update_seconds": 2.0, "uptime_seconds": 3.0},
    });
    vec![text.into_bytes(), line.to_string().into_bytes()]
}

/// Run directories: whole ones, and one whose `latest` is wrong.
pub(super) fn directories() -> Vec<Vec<u8>> {
    let text = description().to_string();
    // The sizes are numbers.
    let text =
        text.replace("\"MODEL_BYTES\"", "MODEL_BYTES").replace("\"OPTIMIZER_BYTES\"", "OPTIMIZER_BYTES");
    let files = files();
    let [model, optimizer] = files.as_slice() else { return Vec::new() };
    [ID, "../000001"]
        .map(|latest| parts::join([latest.as_bytes(), text.as_bytes(), model, optimizer]))
        .to_vec()
}
