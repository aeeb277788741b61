//! What `cross bench ingest` and `weights` have in common.

use crate::failure::{OrBadInput, Outcome};
use crate::sumo::SumoOption;
use anyhow::Context;
use clap::Args;
use cross_bench::cluster::{Programs, Setup};
use cross_sim::scenario::Scenario;
use cross_support::child::sibling;

/// Whose data simulated actors send.
#[derive(Debug, Args)]
pub(super) struct Recorded {
    /// Network of the recorded episode
    #[arg(long, value_name = "NAME", default_value = "grid4x4")]
    scenario: String,
    #[command(flatten)]
    sumo: SumoOption,
}

impl Recorded {
    pub(super) fn setup(&self) -> Outcome<Setup> {
        let own = std::env::current_exe().context("cannot find the path of this program")?;
        Ok(Setup {
            programs: Programs {
                learner: sibling("cross-learner")?,
                bare: (own, vec!["bench".into(), "bare".into()]),
            },
            home: self.sumo.locate()?,
            name: self.scenario.clone(),
            scenario: Scenario::load(&self.scenario).or_bad_input()?,
        })
    }
}

/// Clients that one machine can have: ports are 16 bits.
pub(super) fn clients(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(number) if (1..=20_000).contains(&number) => Ok(number),
        _ => Err("it must be a number from 1 to 20000".to_owned()),
    }
}
