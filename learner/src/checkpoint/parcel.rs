//! A whole checkpoint in memory, byte for byte: what goes from one place to another.

use super::error::CheckpointError;
use super::metadata::Metadata;
use super::{METADATA_FILE, MODEL_FILE, OPTIMIZER_FILE};
use std::path::Path;

/// A checkpoint's files, all compared with the description.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Parcel {
    /// The description.
    pub(crate) metadata: Metadata,
    /// Its bytes, because a later release may know fields that this one does not.
    pub(crate) description: Vec<u8>,
    /// Every other file, by name.
    pub(crate) files: Vec<(String, Vec<u8>)>,
}

impl Parcel {
    /// The files that a description names. It may come from anywhere, so a name that leads out of the checkpoint is refused.
    pub(super) fn names(metadata: &Metadata, checkpoint: &Path) -> Result<Vec<String>, CheckpointError> {
        let foreign = |reason| CheckpointError::Foreign { path: checkpoint.join(METADATA_FILE), reason };
        for needed in [MODEL_FILE, OPTIMIZER_FILE] {
            if !metadata.files.contains_key(needed) {
                return Err(foreign(format!("it has no hash of {needed}")));
            }
        }
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        for name in metadata.files.keys() {
            if name.is_empty() || name.starts_with('.') || name == METADATA_FILE || !name.chars().all(plain) {
                return Err(foreign(format!("it names a file {name:?}")));
            }
        }
        Ok(metadata.files.keys().cloned().collect())
    }
}
