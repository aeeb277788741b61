//! Everything that can go wrong between a scenario's name and a finished episode.

use crate::layout::LayoutError;
use crate::net::NetError;
use crate::scenario::ScenarioError;
use crate::signal::ActionError;
use cross_traci::{LocateError, TraciError};
use std::path::PathBuf;

/// Failure of the environment.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// No SUMO to run.
    #[error(transparent)]
    Locate(#[from] LocateError),
    /// SUMO did not start, ended, hung, or refused something.
    #[error(transparent)]
    Traci(#[from] TraciError),
    /// The scenario cannot be loaded.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Its net cannot be read.
    #[error(transparent)]
    Net(#[from] NetError),
    /// Its net cannot be controlled.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// Actions that cannot be carried out.
    #[error(transparent)]
    Action(#[from] ActionError),
    /// No file for a signal program of SUMO's.
    #[error("cannot write the signal programs for SUMO: {source}; free some space or set TMPDIR")]
    ProgramFile {
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A phase whose length a signal program of SUMO's would need.
    #[error(
        "traffic light {light:?} of the net {} has no duration in seconds for its phase {state:?}, so that SUMO cannot be \
         given a program for it; add one to the net",
        path.display()
    )]
    ProgramPhase {
        /// The net.
        path: PathBuf,
        /// Traffic light id.
        light: String,
        /// State of the phase.
        state: String,
    },
    /// SUMO does not run the signal program that it was given.
    #[error(
        "traffic light {light:?} runs the program {running:?} and not {wanted:?}; take signal programs and plans (tlLogic, \
         WAUT) out of the scenario's additional files"
    )]
    ProgramNotRunning {
        /// Traffic light id.
        light: String,
        /// Program that it should run.
        wanted: String,
        /// Program that it runs.
        running: String,
    },
    /// A step without a running episode.
    #[error("no episode is running; reset the environment first")]
    NotRunning,
    /// A step after the last one.
    #[error("the episode is over after {steps} steps; reset the environment for another")]
    EpisodeOver {
        /// Steps of an episode.
        steps: u32,
    },
}

impl SimError {
    /// Whether SUMO failed in a way that another SUMO may not repeat: it crashed, hung, lost its connection or could not
    /// be started. False for everything that would only happen again.
    #[must_use]
    pub fn is_simulator_failure(&self) -> bool {
        match self {
            Self::Traci(TraciError::Refused { .. } | TraciError::Version { .. }) => false,
            Self::Traci(_) => true,
            _ => false,
        }
    }

    /// The kind of failure as one of a fixed, small set of words, fit for a metric's label.
    #[must_use]
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Locate(_) => "no_sumo",
            Self::Traci(error) => error.kind().as_str(),
            Self::Scenario(_) => "scenario",
            Self::Net(_) => "net",
            Self::Layout(_) => "layout",
            Self::Action(_) => "action",
            Self::ProgramFile { .. } | Self::ProgramPhase { .. } | Self::ProgramNotRunning { .. } => {
                "program"
            }
            Self::NotRunning | Self::EpisodeOver { .. } => "no_episode",
        }
    }
}
