//! `cross bench bare`: the baseline's server, which `ingest` and `weights` start as a process of its own.

use crate::failure::Outcome;
use clap::Args;
use cross_bench::cluster::bare;
use std::path::PathBuf;

/// Serves the baseline of `ingest` and `weights`, which start it; ends with them
#[derive(Debug, Args)]
pub(crate) struct Bare {
    /// Folder with the snapshot; the address is written there
    folder: PathBuf,
}

impl Bare {
    pub(super) fn run(&self) -> Outcome<()> {
        Ok(bare::serve(&self.folder)?)
    }
}
