//! Errors of making scenarios.

use cross_traci::sumo::LocateError;
use std::path::PathBuf;

/// A scenario that could not be made.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// An option that makes no grid.
    #[error("cannot generate this grid: {what}")]
    Option {
        /// Which option, its value, and what it may be.
        what: String,
    },
    /// No SUMO, hence no netconvert.
    #[error("netconvert, which builds nets, comes with SUMO: {0}")]
    Sumo(#[from] LocateError),
    /// netconvert cannot be started.
    #[error("cannot run {}: {source}; reinstall SUMO with `make build`", binary.display())]
    Start {
        /// The program.
        binary: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// netconvert refused or hung.
    #[error("{} could not build the net ({outcome}): {said}", binary.display())]
    Netconvert {
        /// The program.
        binary: PathBuf,
        /// Exit status, or that time was up.
        outcome: String,
        /// Its own words.
        said: String,
    },
    /// A file cannot be written or read back.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Something is there already.
    #[error("{} exists already; give --force to replace it, or another --name or --out", path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
    },
}

impl GenerateError {
    pub(crate) fn write(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Write { path, source }
    }
}
