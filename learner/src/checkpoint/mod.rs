//! Checkpoints: everything a run needs to go on, and what evaluation loads.
//!
//! ```text
//!   RUN/checkpoints/000120/model.safetensors      weights of both networks: all that acting needs
//!                          optimizer.safetensors  Adam's moments, random generator, counters
//!                          metadata.json          what it is, for people and programs, with the hashes of both files
//!                   000130/...
//!                   latest                        id of the newest, replaced last
//! ```
//! A checkpoint appears under its name in one step (written aside, synchronised, renamed), so half of one is never seen;
//! `latest` moves only afterwards. [`reader`] never trusts a file before its hash has been compared. [`remote`] keeps copies
//! in an object store, in the same form and by the same rules.

mod error;
mod metadata;
mod parcel;
pub mod reader;
pub mod remote;
mod store;
#[cfg(test)]
pub(crate) mod tests;

pub use error::CheckpointError;
pub use metadata::{FORMAT, FORMAT_VERSION, FileInfo, Metadata, Versions, rfc3339};
pub use reader::{Checkpoint, Entry, Resumed, Tensor};
pub use store::Store;

use std::path::PathBuf;

/// Folder of the checkpoints in a run directory.
pub const FOLDER: &str = "checkpoints";
/// Weights.
pub const MODEL_FILE: &str = "model.safetensors";
/// Optimiser state.
pub const OPTIMIZER_FILE: &str = "optimizer.safetensors";
/// Description.
pub const METADATA_FILE: &str = "metadata.json";
/// File that names the newest checkpoint.
pub const LATEST_FILE: &str = "latest";

/// The id of the checkpoint after so many updates.
#[must_use]
pub fn id(updates: u64) -> String {
    format!("{updates:06}")
}

/// The number of updates that an id stands for; `None` if it is none.
#[must_use]
pub fn updates_of(id: &str) -> Option<u64> {
    let digits = id.len() >= 6 && id.bytes().all(|b| b.is_ascii_digit());
    digits.then(|| id.parse().ok()).flatten()
}

/// Runs disk work where it may block. Work that panics, or is cancelled because the process ends, is an error like any other,
/// so that it is counted and said where the others are; `path` is what the work is about.
pub(crate) async fn blocking<T: Send + 'static>(
    path: PathBuf,
    work: impl FnOnce() -> Result<T, CheckpointError> + Send + 'static,
) -> Result<T, CheckpointError> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| {
        // The panic's own words are in the log already, from where it happened.
        let source = std::io::Error::other("the work on it was broken off; the log says where");
        Err(CheckpointError::Io { action: "use", path, source })
    })
}
