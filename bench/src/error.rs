//! Why a benchmark could not be made.

use cross_config::ConfigError;
use cross_model::ModelError;
use std::path::PathBuf;

/// An error of a benchmark.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The model refused what the benchmark made for it.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The configuration that is measured cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A figure of this process that the kernel should tell.
    #[error("cannot read the peak memory from {}; this benchmark needs Linux with /proc mounted: {source}", path.display())]
    Memory {
        /// File of the kernel.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// A file that could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
}
