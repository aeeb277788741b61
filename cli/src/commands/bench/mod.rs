//! `cross bench`: speed, beside a baseline on the same machine.

mod bare;
mod env;
mod episodes;
mod ingest;
mod live;
mod recorded;
mod traci;
mod train;
mod update;
mod weights;

use crate::failure::Outcome;
use crate::output;
use clap::{Args, Subcommand};
use live::Live;
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
  cross bench ingest            fragments of a thousand actors: one learner, and a bare gRPC stream
  cross bench weights           new weights to a thousand watchers, likewise
  cross bench train             a minute of a real training: whose CPU time it was
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
    Ingest(ingest::Ingest),
    Weights(weights::Weights),
    Train(train::Train),
    #[command(hide = true)]
    Bare(bare::Bare),
}

impl Bench {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let live = Live::start();
        let progress = |line: &str| live.tell(line);
        let report = match &self.command {
            Command::Update(command) => command.run(&progress)?,
            Command::Env(command) => Some(command.run(&progress)?),
            Command::Traci(command) => Some(command.run(&progress)?),
            Command::Ingest(command) => Some(command.run(&progress)?),
            Command::Weights(command) => Some(command.run(&progress)?),
            Command::Train(command) => Some(command.run(&progress)?),
            Command::Bare(command) => {
                command.run()?;
                None
            }
        };
        drop(live);
        match report {
            Some(report) if self.json => output::json(&report)?,
            Some(report) => output::text(&report.table())?,
            None => {}
        }
        Ok(ExitCode::SUCCESS)
    }
}
