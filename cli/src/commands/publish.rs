//! `cross checkpoint publish`: a policy to give away.

use crate::failure::{Failure, OrBadInput, Outcome};
use crate::output_file::OutputFile;
use crate::saved::Saved;
use anyhow::Context;
use cross_learner::checkpoint::{FileInfo, METADATA_FILE, MODEL_FILE, Metadata, OPTIMIZER_FILE};
use cross_support::files::replace_file;
use std::path::Path;

/// Writes the mean of a run's newest checkpoints' weights, and the newest one's description, into a folder.
///
/// # Errors
/// If the run has fewer checkpoints, one of them is damaged, or the folder cannot be written.
pub(super) fn publish(saved: &Saved, count: usize, folder: &Path) -> Outcome<Metadata> {
    let (entries, _) = saved.list()?;
    if entries.len() < count {
        return Err(Failure::input(format!(
            "{} has {} checkpoint{}, not {count}; name fewer with --last, or let a run keep more (learner.keep_checkpoints)",
            saved.path().display(),
            entries.len(),
            if entries.len() == 1 { "" } else { "s" },
        )));
    }
    // Newest first in the list, oldest first here: the last one's description is that of the mean.
    let chosen = entries.iter().take(count).rev().map(|entry| saved.find(&entry.id)?.model());
    let chosen: Vec<_> = chosen.collect::<Outcome<_>>()?;
    let (descriptions, policies): (Vec<Metadata>, Vec<Vec<u8>>) = chosen.into_iter().unzip();
    let policy = cross_model::average(&policies).or_bad_input()?;
    // At least one, as clap demands.
    let mut metadata =
        descriptions.last().cloned().ok_or_else(|| Failure::input("no checkpoint to publish"))?;
    metadata.averaged =
        if count > 1 { descriptions.into_iter().map(|one| one.id).collect() } else { Vec::new() };
    metadata.files = [(MODEL_FILE.to_owned(), FileInfo::of(&policy))].into();
    if folder.join(OPTIMIZER_FILE).exists() {
        return Err(Failure::input(format!(
            "{} is a checkpoint, which could not be resumed any more; name another folder with --out",
            folder.display()
        )));
    }
    std::fs::create_dir_all(folder).map_err(|error| {
        Failure::input(format!("cannot create {}: {error}; name another folder with --out", folder.display()))
    })?;
    for name in [MODEL_FILE, METADATA_FILE] {
        OutputFile::prepare(&folder.join(name))?;
    }
    // Plain data serialises.
    let mut description = serde_json::to_vec_pretty(&metadata).expect("metadata serialises");
    description.push(b'\n');
    // Whoever reads in between finds weights whose hash does not match, and says so.
    for (name, bytes) in [(MODEL_FILE, &policy), (METADATA_FILE, &description)] {
        let file = folder.join(name);
        replace_file(&file, bytes).with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(metadata)
}
