//! `cross bench`: speed, beside a baseline on the same machine.

mod env;
mod episodes;
mod traci;
mod update;

use crate::failure::Outcome;
use crate::output;
use crate::train::progress::say;
use clap::{Args, Subcommand};
use std::process::ExitCode;

/// Measures how fast parts of CROSS are, each beside a baseline in the same run
///
/// A ratio of two figures from one run says more than either: it hardly depends on the machine. Close other programs first;
/// where repetitions are made they take turns, and the median of each side counts.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross bench update            a PPO update: packed as it runs, and padded as the paper writes it
  cross bench env               episodes and decisions: the actor's whole path, and SUMO alone
  cross bench traci             episodes: our TraCI client, the crate traci-rs, Python's traci
  cross bench update --json     the same as one JSON document

The column `times better` is above 1 where ours is better, whichever direction of the figure is good.
JSON: {\"bench\", \"rows\": [{\"case\", \"unit\", \"ours\", \"baseline\", \"baseline_name\", \"speedup\"}]}
Progress goes to standard error.")]
pub(crate) struct Bench {
    #[command(subcommand)]
    command: Command,
    /// Print one JSON document
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Update(update::Update),
    Env(env::Env),
    Traci(traci::Traci),
}

impl Bench {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let progress = |line: &str| say(line);
        let report = match &self.command {
            Command::Update(command) => command.run(&progress)?,
            Command::Env(command) => Some(command.run(&progress)?),
            Command::Traci(command) => Some(command.run(&progress)?),
        };
        match report {
            Some(report) if self.json => output::json(&report)?,
            Some(report) => output::text(&report.table())?,
            None => {}
        }
        Ok(ExitCode::SUCCESS)
    }
}
