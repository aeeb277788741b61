//! `cross bench env`.

use super::episodes::Episodes;
use crate::failure::{Failure, OrBadInput, Outcome};
use clap::Args;
use cross_bench::{Progress, Report, env};
use cross_learner::checkpoint::reader;
use std::path::PathBuf;

/// Episodes through the actor's whole path beside SUMO alone, and the policy's decision beside libtorch's
///
/// Three pairs for each scenario: Max-Pressure; the CROSS policy, sampling, its steps recorded and encoded; Max-Pressure with
/// the metrics of every second and vehicle. The other side is `sumo` without a client: the same command line, seed and length,
/// and the very signal plan of our episode, written out as static programs. Both sides record all trips, and a pair whose
/// trips are not the same is an error. Wall time and CPU time, SUMO's start and end included; of several repetitions the
/// pair with the median ratio.
/// Then a decision for the 25 intersections of grid5x5: features, networks, sampling; warm, one thread, 1,000 of them.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross bench env                                   grid4x4 and grid5x5, a fresh policy
  cross bench env --policy runs/NAME --repeats 3    a trained one, which keeps traffic flowing
  cross bench env --scenario grid4x4 --json

SUMO's time grows with the vehicles on the road: a fresh policy makes jams, in which the rest hardly counts.")]
pub(crate) struct Env {
    /// Weights that choose: a run directory, a checkpoint or a policy file; fresh ones without it
    #[arg(long, value_name = "PATH")]
    policy: Option<PathBuf>,
    #[command(flatten)]
    episodes: Episodes,
}

impl Env {
    pub(super) fn run(&self, progress: Progress<'_>) -> Outcome<Report> {
        let weights = match &self.policy {
            Some(path) if !path.exists() => {
                return Err(Failure::input(format!("there is no policy {}", path.display())));
            }
            Some(path) => Some(reader::load_policy(path).or_bad_input()?.1),
            None => None,
        };
        let options = env::Options {
            home: self.episodes.sumo.locate()?,
            scenarios: self.episodes.scenarios()?,
            weights,
            seed: self.episodes.seed,
            repeats: self.episodes.repeats,
        };
        Ok(env::run(&options, progress)?)
    }
}
