//! A step that SUMO is at while its environment's owner does something else.

use super::simulation::Simulation;
use super::{Env, Step};
use crate::error::SimError;
use crate::trajectory::Observation;
use std::time::Instant;

/// A step that was [begun](Env::begin_step). Left without [completing](Self::complete) it, the episode is lost and SUMO
/// ends.
#[derive(Debug)]
#[must_use = "dropping it loses the episode"]
pub struct StepUnderWay<'e> {
    pub(super) env: &'e mut Env,
    pub(super) simulation: Simulation,
}

impl<'e> StepUnderWay<'e> {
    /// What the agents saw before the step.
    #[must_use]
    pub fn before(&self) -> &Observation {
        &self.env.observation
    }

    /// Waits for SUMO, and sees what it led to.
    ///
    /// # Errors
    /// As [`Env::step`].
    pub fn complete(self) -> Result<Step<'e>, SimError> {
        let Self { env, mut simulation } = self;
        let begun = Instant::now();
        let outcome = env
            .follow(&mut simulation)
            .and_then(|()| simulation.count(&mut env.lanes).map(drop).map_err(SimError::from));
        env.conclude(begun, simulation, outcome)
    }
}
