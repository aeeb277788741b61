//! What is checked before a process starts: everything that would otherwise fail a minute later, in a log.

use crate::failure::{Failure, OrBadInput, Outcome};
use cross_config::Config;
use cross_model::Placement;
use cross_model::features::NetworkSpec;
use cross_sim::layout::load_layout;
use cross_sim::scenario::Scenario;
use cross_support::child::sibling;
use cross_traci::sumo::SumoHome;

/// A machine and a configuration that fit each other.
#[derive(Debug)]
pub(crate) struct Ready {
    pub(crate) sumo: SumoHome,
    pub(crate) sumo_version: String,
    pub(crate) scenarios: Vec<Scenario>,
    /// Where the learner will compute.
    pub(crate) placement: Placement,
}

/// Checks programs, SUMO, the device and scenarios.
pub(crate) fn check(config: &Config, sumo: SumoHome) -> Outcome<Ready> {
    sibling("cross-learner")?;
    sibling("cross-actor")?;
    let placement = Placement::resolve(&config.learner).or_bad_input()?;
    let sumo_version = sumo.version().or_bad_input()?;
    let mut scenarios = Vec::new();
    for name in &config.scenarios {
        let scenario = Scenario::load(name).or_bad_input()?;
        let layout = load_layout(&scenario, &config.env).or_bad_input()?;
        if layout.agents() == 0 {
            return Err(Failure::input(format!(
                "the net of {name} has no traffic light to control; choose another scenario"
            )));
        }
        NetworkSpec::new(&layout, &config.env, &config.model).or_bad_input()?;
        scenarios.push(scenario);
    }
    Ok(Ready { sumo, sumo_version, scenarios, placement })
}
