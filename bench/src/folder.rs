//! Folders for files that live as long as a measurement.

use crate::error::BenchError;
use tempfile::TempDir;

/// An empty folder, gone when it is dropped.
pub(crate) fn folder() -> Result<TempDir, BenchError> {
    tempfile::Builder::new().prefix("cross-bench-").tempdir().map_err(|source| BenchError::Folder { source })
}
