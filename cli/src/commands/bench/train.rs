//! `cross bench train`.

use crate::failure::Outcome;
use crate::sumo::SumoOption;
use clap::Args;
use cross_bench::{Progress, Report, minute};
use std::path::PathBuf;
use std::time::Duration;

/// A minute of a real training, and whose CPU time it was
///
/// Starts `cross train` with its learner, actors and SUMOs, waits for its first updates, and reads from the kernel what every
/// thread has used before and after. SUMO and the updates are the work; the actors' decisions, the wire and the rest are what
/// it costs to have it done. The run itself is thrown away.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross bench train                                       grid4x4, as many actors as cross train starts
  cross bench train --scenario grid4x4 --scenario grid5x5 --actors 4 --seconds 300
  cross bench train --config configs/paper.toml --json

A training goes in rounds: look for several of them, or the shares depend on where the look began.")]
pub(crate) struct Train {
    /// Network to train on; repeat it to train on several together
    #[arg(long, value_name = "NAME", default_values = ["grid4x4"])]
    scenario: Vec<String>,
    /// Configuration in TOML [default: the built-in one]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Actor processes [default: as cross train]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    actors: Option<u16>,
    /// Length of the look
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: u64,
    #[command(flatten)]
    sumo: SumoOption,
}

impl Train {
    pub(super) fn run(&self, progress: Progress<'_>) -> Outcome<Report> {
        let options = minute::Options {
            sumo_home: self.sumo.locate()?.path().to_owned(),
            scenarios: self.scenario.clone(),
            config: self.config.clone(),
            actors: self.actors,
            time: Duration::from_secs(self.seconds),
        };
        Ok(minute::run(&options, progress)?)
    }
}
