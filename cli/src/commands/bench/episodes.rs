//! What the benchmarks of whole episodes have in common.

use crate::failure::{OrBadInput, Outcome};
use crate::sumo::SumoOption;
use clap::Args;
use cross_sim::scenario::Scenario;

/// Which episodes, and how often.
#[derive(Debug, Args)]
pub(crate) struct Episodes {
    /// Network to simulate; repeatable
    #[arg(long, value_name = "NAME", default_values = ["grid4x4", "grid5x5"])]
    scenario: Vec<String>,
    /// SUMO's seed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=0x7fff_ffff))]
    pub(crate) seed: u32,
    /// Repetitions of each pair
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) repeats: u32,
    #[command(flatten)]
    pub(crate) sumo: SumoOption,
}

impl Episodes {
    pub(crate) fn scenarios(&self) -> Outcome<Vec<Scenario>> {
        self.scenario.iter().map(|name| Scenario::load(name).or_bad_input()).collect()
    }
}
