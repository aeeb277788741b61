//! `cross bench traci`.

use super::episodes::Episodes;
use crate::failure::Outcome;
use clap::Args;
use cross_bench::{Progress, Report, traci};
use cross_config::EnvConfig;
use std::path::PathBuf;

/// Episodes through our TraCI client beside the same through the crate traci-rs and Python's traci
///
/// An episode of Max-Pressure gives a signal plan. Then every client follows it, on SUMOs with the same command line and
/// seed, and looks at all vehicles at each decision: lane, position, speed. Ours is the environment as an actor drives it;
/// each other client is used in four ways, and right before each of them ours is measured again.
/// What a client saw is counted per lane and compared with ours: other traffic is an error, not a ratio. Times are wall and
/// CPU time of client and SUMO together, from SUMO's start to its end. Starting Python and importing traci are not counted,
/// and neither is turning into counts what the others saw. Of several repetitions the pair with the median ratio.
#[derive(Debug, Args)]
#[command(after_help = "\
Ways:
  polling                       steps of a second; at a decision three getters for each vehicle
  subscription by the second    steps of a second; a standing subscription to all vehicles
  subscription by the decision  the same subscription; steps to the next change of a signal
  subscription for the moment   those steps; at each decision a subscription for its second alone

Examples:
  cross bench traci                                    grid4x4 and grid5x5
  cross bench traci --scenario grid4x4 --repeats 3
  cross bench traci --python ~/venv/bin/python3 --json

A client that is not here is named on standard error and left out:
  traci-rs        is a program of its own, which is built by
                  cargo build --release -p cross-bench --example traci_rs_episode
  Python's traci  is that of the tools folder of the SUMO in use, else what Python finds")]
pub(crate) struct Traci {
    #[command(flatten)]
    episodes: Episodes,
    /// Python to measure with; python3 without it
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
}

impl Traci {
    pub(super) fn run(&self, progress: Progress<'_>) -> Outcome<Report> {
        let options = traci::Options {
            home: self.episodes.sumo.locate()?,
            scenarios: self.episodes.scenarios()?,
            env: EnvConfig::default(),
            seed: self.episodes.seed,
            repeats: self.episodes.repeats,
            python: self.python.clone(),
        };
        Ok(traci::run(&options, progress)?)
    }
}
