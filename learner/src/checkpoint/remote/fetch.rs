//! Resuming where checkpoints are on this disk, in a store, or in both: from the newest one that is sound.

use super::Remote;
use crate::checkpoint::reader::{self, Resumed};
use crate::checkpoint::{CheckpointError, Store, blocking, updates_of};
use std::path::{Path, PathBuf};

/// What was found.
#[derive(Debug, Default)]
pub struct Fetched {
    /// The newest checkpoint that can be used, now on this disk; `None` if there is none anywhere.
    pub resumed: Option<Resumed>,
    /// The run that the store's place belongs to, so that one that lost its disk before its first copy is still itself.
    pub owner: Option<String>,
    /// Checkpoints of the store that are damaged, for the learner to set aside there.
    pub damaged: Vec<String>,
    /// Why the store was not looked at; there is a checkpoint on this disk then.
    pub unreachable: Option<CheckpointError>,
}

/// The newest usable checkpoint of a run, from its directory or from the store. One that only the store has is written to the
/// run directory first, so that a run always goes on from its own disk. `run_id` is the run that the directory says it is of,
/// if it says so.
///
/// A store that cannot be reached does not keep a run from going on that has a checkpoint of its own.
///
/// # Errors
/// As `reader::resume`; [`CheckpointError::Store`] if the store cannot be read and nothing else is there to go on from, or if
/// a person has to mend something about it.
pub async fn resume(
    run: &Path,
    run_id: Option<&str>,
    remote: &Remote,
    compatibility_hash: &str,
) -> Result<Fetched, CheckpointError> {
    let (local, none_usable) = match on_disk(run.to_owned(), compatibility_hash.to_owned()).await {
        Ok(local) => (local, None),
        // The store may have what the disk has lost.
        Err(error @ CheckpointError::NoneUsable { .. }) => (None, Some(error)),
        Err(error) => return Err(error),
    };
    let of_local = local.as_ref().map(|local| local.checkpoint.metadata.run_id.clone());
    let run_id = run_id.map(str::to_owned).or(of_local);
    let (owner, ids) = match remote.of_run(run_id.as_deref()).await {
        Ok(found) => found,
        Err(error) if error.is_passing() && local.is_some() => {
            return Ok(Fetched { resumed: local, unreachable: Some(error), ..Fetched::default() });
        }
        Err(error) => return Err(error),
    };
    let run_id = run_id.or_else(|| owner.clone());
    let known = local.as_ref().map(|local| local.checkpoint.metadata.updates);
    let (count, mut damaged, mut problems) = (ids.len(), Vec::new(), Vec::new());
    for id in ids.into_iter().filter(|id| updates_of(id) > known) {
        match remote.parcel(&id).await {
            Ok(parcel) => {
                if let Some(expected) = run_id
                    && parcel.metadata.run_id != expected
                {
                    let (url, got) = (remote.path_of(&id).display().to_string(), parcel.metadata.run_id);
                    return Err(CheckpointError::OtherRun { url, got, expected });
                }
                let got = &parcel.metadata.compatibility_hash;
                if got != compatibility_hash {
                    let (got, expected) = (got.clone(), compatibility_hash.to_owned());
                    return Err(CheckpointError::Incompatible { path: remote.path_of(&id), got, expected });
                }
                for problem in local.iter().flat_map(|local| &local.skipped) {
                    tracing::error!("{problem}; the store has a newer one or a copy");
                }
                if let Some(problem) = none_usable {
                    tracing::error!("{problem}; the store has a copy");
                }
                if let Some(local) = &local {
                    // The usual reason is a copy that was late to the disk's loss; the other one is a restored backup.
                    tracing::warn!(
                        "the store is ahead of the run directory, and the run goes on from there, not from checkpoint {}; \
                         to go on from that one, start with --checkpoints \"\" or another URL",
                        local.checkpoint.metadata.id
                    );
                }
                tracing::info!(checkpoint = %id, url = remote.url(), "fetching from the store");
                let run = run.to_owned();
                let checkpoint = blocking(run.clone(), move || {
                    // Retention is the learner's business; here nothing is removed.
                    reader::read(&Store::open(&run, usize::MAX)?.install(&parcel)?)
                });
                let resumed = Some(Resumed { checkpoint: checkpoint.await?, skipped: problems });
                return Ok(Fetched { resumed, owner, damaged, unreachable: None });
            }
            Err(error) if error.is_corrupt() => {
                damaged.push(id);
                problems.push(error);
            }
            Err(error) if error.is_passing() && local.is_some() => {
                return Ok(Fetched { resumed: local, unreachable: Some(error), ..Fetched::default() });
            }
            Err(error) => return Err(error),
        }
    }
    if let Some(mut resumed) = local {
        problems.append(&mut resumed.skipped);
        resumed.skipped = problems;
        return Ok(Fetched { resumed: Some(resumed), owner, damaged, unreachable: None });
    }
    match (none_usable, problems.into_iter().next()) {
        (Some(error), _) => Err(error),
        (None, Some(newest)) => {
            let folder = PathBuf::from(remote.url());
            Err(CheckpointError::NoneUsable { count, folder, newest: Box::new(newest) })
        }
        (None, None) => Ok(Fetched { owner, ..Fetched::default() }),
    }
}

async fn on_disk(run: PathBuf, compatibility_hash: String) -> Result<Option<Resumed>, CheckpointError> {
    blocking(run.clone(), move || reader::resume(&run, &compatibility_hash)).await
}
