//! What the program of another client is told, as JSON.
//!
//! The programs share this file: `bench/examples/traci_rs_episode.rs` compiles it, `episode.py` reads the same names.

use serde::{Deserialize, Serialize};

/// How a client steps SUMO and looks at the vehicles. All of them look at each decision, at the same moments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Way {
    /// Steps of a second; at a decision the list of vehicles and three getters for each.
    Polling,
    /// Steps of a second, each of which brings a standing subscription.
    EverySecond,
    /// Steps to the next change of a signal, each of which brings a standing subscription.
    EveryDecision,
    /// Steps to the next change of a signal; a subscription that begins and ends with the moment of the decision.
    Momentary,
}

/// An episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// How to step and to look.
    pub way: Way,
    /// A junction, around which subscriptions see every vehicle.
    pub anchor: String,
    /// How far they see, metres.
    pub range: f64,
    /// Simulated time at the beginning, seconds.
    pub begin: f64,
    /// What lights show at the beginning: light, state.
    pub first: Vec<(String, String)>,
    /// From the beginning or a decision to the next decision, at which the vehicles are looked at.
    pub decisions: Vec<Vec<Leg>>,
}

/// Seconds between two changes of signals.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leg {
    /// What lights begin to show: light, state.
    pub show: Vec<(String, String)>,
    /// Seconds that pass then.
    pub seconds: u32,
}
