//! `cross bench bare`: the baseline's server, which `ingest` and `weights` start as a process of its own.

use crate::failure::Outcome;
use anyhow::Context;
use clap::Args;
use cross_bench::cluster::{Programs, bare};
use cross_support::child::sibling;
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

/// What `ingest` and `weights` start.
pub(super) fn programs() -> Outcome<Programs> {
    let own = std::env::current_exe().context("cannot find the path of this program")?;
    Ok(Programs { learner: sibling("cross-learner")?, bare: (own, vec!["bench".into(), "bare".into()]) })
}
