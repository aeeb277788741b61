//! Controllers: what chooses the next phase of every intersection, rule-based or learned.
//!
//! ```text
//!   Env ── ControllerView (layout, observation, lane counts, step, time) ──> Controller::act ──> one phase per agent ──> Env
//! ```
//! [`Controller`] is the one interface: the rules below implement it, a learned policy is wrapped into it, and so is
//! whatever a user of the library wants to compare (`examples/my_controller.rs` is a whole one). [`Program`] is the
//! exception: it leaves the lights to SUMO.

mod fixed_time;
mod greedy;
mod max_pressure;
mod names;
mod program;
mod random;

pub use fixed_time::FixedTime;
pub use greedy::Greedy;
pub use max_pressure::{MaxPressure, Outgoing, Range};
pub use names::{RuleBased, UnknownPolicy};
pub use program::Program;
pub use random::Random;

use crate::env::Signals;
use crate::lanes::LaneTable;
use crate::layout::NetworkLayout;
use crate::trajectory::Observation;

/// Why a controller could not decide: any error of its own.
pub type ControllerError = Box<dyn std::error::Error + Send + Sync>;

/// What a controller may look at when it decides.
#[derive(Debug, Clone, Copy)]
pub struct ControllerView<'a> {
    /// Intersections with their lanes, movements and phases; the same all through an episode.
    pub layout: &'a NetworkLayout,
    /// What a learned policy sees: counts by detection band, and the current phase of each agent.
    pub observation: &'a Observation,
    /// Vehicle counts of every lane, whole lane and within 50 m of its end; without what is behind or beyond it, which a learned
    /// policy sees.
    pub lanes: &'a LaneTable,
    /// Decision of the episode, from 0.
    pub step: u32,
    /// Simulated time, seconds.
    pub time: f64,
}

/// Chooses phases for all agents of one network.
pub trait Controller {
    /// Name in tables and reports.
    fn name(&self) -> &str;

    /// Who sets the lights of an episode: this controller, unless it says otherwise.
    fn signals(&self) -> Signals {
        Signals::Driven
    }

    /// Forgets the last episode. `seed` is for whatever the controller draws at random: the same seed, the same episode.
    ///
    /// # Errors
    /// Whatever keeps the controller from serving this network.
    fn reset(&mut self, layout: &NetworkLayout, seed: u64) -> Result<(), ControllerError> {
        let _ = (layout, seed);
        Ok(())
    }

    /// Writes the next phase of each agent; `actions` has one entry per agent and holds the current phases at the call.
    ///
    /// # Errors
    /// Whatever keeps the controller from deciding; it ends the episode.
    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError>;
}

/// Index of the highest score; the lowest index among equals, 0 if there is none.
fn first_highest(scores: impl Iterator<Item = i64>) -> u8 {
    let mut best = (0, i64::MIN);
    // An intersection has at most 64 phases (EnvConfig::max_phases), so that the index fits.
    for (phase, score) in (0_u8..).zip(scores) {
        if score > best.1 {
            best = (phase, score);
        }
    }
    best.0
}

#[cfg(test)]
mod test_network;

#[cfg(test)]
mod tests {
    use super::first_highest;

    #[test]
    fn ties_go_to_the_lowest_phase() {
        assert_eq!(first_highest([1, 3, 3, 2].into_iter()), 1);
        assert_eq!(first_highest([-5, -5].into_iter()), 0);
        assert_eq!(first_highest(std::iter::empty()), 0);
    }
}
