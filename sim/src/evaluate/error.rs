//! Why an evaluation failed.

use crate::controller::ControllerError;
use crate::error::SimError;
use crate::metrics::TripInfoError;

/// An evaluation without a result.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The environment failed.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The controller could not be made, could not serve the network, or could not decide.
    #[error("the policy {name} failed: {source}")]
    Controller {
        /// Policy.
        name: String,
        /// In its own words.
        source: ControllerError,
    },
    /// SUMO's record of the trips cannot be used.
    #[error(transparent)]
    Trips(#[from] TripInfoError),
    /// No folder for SUMO's record of the trips.
    #[error("cannot make a temporary folder for SUMO's trip output: {source}; free some space or set TMPDIR")]
    Folder {
        /// What the operating system said.
        source: std::io::Error,
    },
    /// There is nothing to evaluate.
    #[error("no seeds were given; an evaluation needs at least one")]
    NoSeeds,
    /// A seed was given twice, which would weigh its episode twice.
    #[error("seed {seed} was given twice; give every seed once")]
    RepeatedSeed {
        /// The seed.
        seed: u32,
    },
    /// No thread could be started.
    #[error("cannot start a thread for the evaluation: {source}; use fewer workers")]
    Thread {
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The progress callback asked to stop.
    #[error("the evaluation was stopped before its end")]
    Stopped,
}

impl EvaluateError {
    pub(super) fn controller(name: &str) -> impl FnOnce(ControllerError) -> Self {
        move |source| Self::Controller { name: name.to_owned(), source }
    }
}
