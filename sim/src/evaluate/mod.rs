//! Evaluation: a controller on a scenario, one episode for each SUMO seed, measured.
//!
//! ```text
//!   Setting + policy + seeds ── evaluate_seeds ──> threads, each: evaluate (Env + Controller + SecondMeter) ──> EpisodeMetrics
//!                                                                                          EvalReport (JSON), table (text)
//! ```
//! [`Details`] come along if a [`Setting`] asks for them: what a report page draws.
//! Every episode has a SUMO of its own, so that a seed gives the same figures alone, among others, and after a crash.

mod details;
mod drawing;
mod episode;
mod error;
mod format;
mod recorder;
mod report;
mod seeds;
mod table;

pub use details::{
    Details, EdgeDrawing, IntersectionDetails, NetworkDrawing, RoadDetails, SERIES_INTERVAL_SECONDS,
    SeedDetails, Series, SignalDrawing, TripTimes, Trips,
};
pub use episode::{Episode, Progress, evaluate};
pub use error::EvaluateError;
pub use report::{EvalReport, MeanVehicles, Protocol, SeedSummary, strongest};
pub use seeds::{MakeController, SeedProgress, evaluate_seeds};
pub use table::table;

use crate::scenario::Scenario;
use cross_config::EnvConfig;
use cross_traci::SumoHome;
use std::time::Duration;

/// What is evaluated on: everything besides the policy and the seeds.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// SUMO to run.
    pub home: &'a SumoHome,
    /// Net and demand.
    pub scenario: &'a Scenario,
    /// Decisions, signals, observation, length of an episode.
    pub env: &'a EnvConfig,
    /// Longest time SUMO may take to answer one command.
    pub timeout: Duration,
    /// Whether reports shall have [`Details`].
    pub details: bool,
}

impl<'a> Setting<'a> {
    /// With the timeout that [`EnvOptions`](crate::env::EnvOptions) has by default, and without details.
    #[must_use]
    pub fn new(home: &'a SumoHome, scenario: &'a Scenario, env: &'a EnvConfig) -> Self {
        Self {
            home,
            scenario,
            env,
            timeout: crate::env::EnvOptions::new(env.clone()).timeout,
            details: false,
        }
    }
}
