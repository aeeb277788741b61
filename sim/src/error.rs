//! Everything that can go wrong between a scenario's name and a finished episode.

use crate::layout::LayoutError;
use crate::net::NetError;
use crate::scenario::ScenarioError;
use crate::signal::ActionError;

/// Failure of the environment.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
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
}
