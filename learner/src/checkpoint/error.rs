//! What can be wrong with a checkpoint, in one sentence that names the file. Where a checkpoint is in an object store, the
//! paths are URLs.

use super::remote::StoreTrouble;
use std::path::{Path, PathBuf};

/// A checkpoint that cannot be read, written or used.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was being done.
        action: &'static str,
        /// To which file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// There is no such checkpoint.
    #[error("there is no checkpoint {id} in {}; `cross checkpoint list` shows which there are", folder.display())]
    NotFound {
        /// What was asked for.
        id: String,
        /// Where it was looked for.
        folder: PathBuf,
    },
    /// A file of it is missing.
    #[error("the checkpoint {} has no {file}; take another checkpoint", path.display())]
    Missing {
        /// The checkpoint.
        path: PathBuf,
        /// The file.
        file: String,
    },
    /// A file is shorter or longer than when it was written.
    #[error("{} has {got} bytes instead of {expected}, it was cut off or overwritten; take another checkpoint", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Its size.
        got: u64,
        /// Its size when it was written.
        expected: u64,
    },
    /// A file has other bytes than when it was written.
    #[error("{} does not match its SHA-256, it was damaged after it was written; take another checkpoint", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
    },
    /// No checkpoint of ours, or a description that makes no sense.
    #[error("{} does not describe a CROSS checkpoint: {reason}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Written by a release with another format.
    #[error("{} has checkpoint format {got}, and this release reads format {expected}; use the release that wrote it", path.display())]
    FormatVersion {
        /// The file.
        path: PathBuf,
        /// Its format.
        got: u64,
        /// Ours.
        expected: u32,
    },
    /// Of another environment or model.
    #[error(
        "the checkpoint {} was trained with another [env] or [model] section (hash {got}, this run has {expected}); \
         resume with the configuration it was made with, or start a new run",
        path.display()
    )]
    Incompatible {
        /// The checkpoint.
        path: PathBuf,
        /// Its compatibility hash.
        got: String,
        /// The run's.
        expected: String,
    },
    /// The object store did not do what was asked of it.
    #[error("cannot {action} {url}: {trouble}")]
    Store {
        /// What was being done.
        action: &'static str,
        /// To which object, or to which place.
        url: String,
        /// Why not, and what to do.
        trouble: StoreTrouble,
    },
    /// The store holds the checkpoints of another run.
    #[error(
        "{url} holds the checkpoints of run {got}, and this is run {expected}; \
         name another URL, or resume in the run directory of that run or in an empty one"
    )]
    OtherRun {
        /// The place.
        url: String,
        /// Whose checkpoints are there.
        got: String,
        /// Who asked.
        expected: String,
    },
    /// A new run was to begin where there are checkpoints already.
    #[error(
        "{url} already holds the checkpoints of run {run}; name another URL, or pass --resume to go on with that run"
    )]
    Occupied {
        /// The place.
        url: String,
        /// Whose checkpoints are there.
        run: String,
    },
    /// Every checkpoint of a run is unusable.
    #[error(
        "none of the {count} checkpoints in {} can be used; the newest: {newest}; \
         restore one from a backup, or start again in another run directory",
        folder.display()
    )]
    NoneUsable {
        /// How many there are.
        count: usize,
        /// Where.
        folder: PathBuf,
        /// What is wrong with the newest.
        newest: Box<CheckpointError>,
    },
}

impl CheckpointError {
    /// For `map_err`.
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source }
    }

    /// Whether the place cannot be reached just now, so that nothing is wrong with what was asked.
    #[must_use]
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Store { trouble: StoreTrouble::Unreachable(_), .. })
    }

    /// Whether the files of this one checkpoint are at fault, so that another may do. Nothing says so of a file that the
    /// operating system does not let us read now, nor of one that a newer release wrote: both may be sound.
    #[must_use]
    pub fn is_corrupt(&self) -> bool {
        match self {
            Self::Missing { .. } | Self::Truncated { .. } | Self::Damaged { .. } | Self::Foreign { .. } => {
                true
            }
            Self::Io { .. }
            | Self::NotFound { .. }
            | Self::FormatVersion { .. }
            | Self::Incompatible { .. }
            | Self::Store { .. }
            | Self::OtherRun { .. }
            | Self::Occupied { .. }
            | Self::NoneUsable { .. } => false,
        }
    }
}
