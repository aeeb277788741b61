//! `cross scenario fetch`.

use super::info::Facts;
use crate::failure::Outcome;
use crate::output;
use clap::Args;

/// Makes a scenario ready: builds its files if it describes them, and checks those it names
///
/// Maps come with `make build`, imported data sets from their publishers; where such a file is missing this says how to get it.
#[derive(Debug, Args)]
pub(crate) struct Fetch {
    /// Name, or path of a directory with a scenario.toml
    name: String,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Fetch {
    pub(super) fn run(&self) -> Outcome<()> {
        let facts = Facts::gather(&self.name)?;
        if self.json { output::json(&facts) } else { output::text(&facts.render()) }
    }
}
