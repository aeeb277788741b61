//! How an environment is run.

use super::Signals;
use cross_config::EnvConfig;
use std::path::PathBuf;
use std::time::Duration;

/// Options of an [`Env`](super::Env) that are no part of the task.
#[derive(Debug, Clone)]
pub struct EnvOptions {
    /// Decisions, signals, observation, reward.
    pub config: EnvConfig,
    /// Who sets the traffic lights.
    pub signals: Signals,
    /// Longest time SUMO may take to start, or to answer one command. A step of a congested city map takes seconds on a
    /// busy machine; only a SUMO that hangs should meet this.
    pub timeout: Duration,
    /// File for SUMO's record of every vehicle's trip, unfinished and never departed ones included. Each episode
    /// replaces it; it is complete after [`Env::finish`](super::Env::finish).
    pub tripinfo: Option<PathBuf>,
    /// Further SUMO arguments, after those of the scenario.
    pub extra_args: Vec<String>,
}

impl EnvOptions {
    /// These decisions taken by whoever steps the environment, a timeout of a minute, no files.
    #[must_use]
    pub fn new(config: EnvConfig) -> Self {
        Self {
            config,
            signals: Signals::Driven,
            timeout: Duration::from_secs(60),
            tripinfo: None,
            extra_args: Vec::new(),
        }
    }
}

impl Default for EnvOptions {
    fn default() -> Self {
        Self::new(EnvConfig::default())
    }
}
