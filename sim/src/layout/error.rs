//! Nets that cannot be controlled.

use std::path::PathBuf;

/// Why a net has no layout. Every variant names the net.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// The net has no traffic light at all.
    #[error("the net {} has no traffic lights; build it with signalised junctions", path.display())]
    NoSignals {
        /// The net.
        path: PathBuf,
    },
    /// No traffic light leaves a choice.
    #[error(
        "none of the {lights} traffic lights of the net {} has at least two green phases, so there is nothing to decide",
        path.display()
    )]
    NoAgents {
        /// The net.
        path: PathBuf,
        /// Number of traffic lights in it.
        lights: usize,
    },
    /// More movements than the configuration allows.
    #[error(
        "intersection {intersection:?} of the net {} has {movements} movements, more than the {limit} that \
         env.max_movements allows; simplify it or raise the limit",
        path.display()
    )]
    TooManyMovements {
        /// The net.
        path: PathBuf,
        /// Traffic light id.
        intersection: String,
        /// How many it has.
        movements: usize,
        /// How many are allowed.
        limit: usize,
    },
    /// More green phases than the configuration allows.
    #[error(
        "intersection {intersection:?} of the net {} has {phases} green phases, more than the {limit} that \
         env.max_phases allows; simplify its program or raise the limit",
        path.display()
    )]
    TooManyPhases {
        /// The net.
        path: PathBuf,
        /// Traffic light id.
        intersection: String,
        /// How many it has.
        phases: usize,
        /// How many are allowed.
        limit: usize,
    },
    /// A signal state without a letter for one of the links, or states of different lengths.
    #[error(
        "traffic light {light:?} of the net {} controls link {index}, but its state {state:?} has only {} letters",
        path.display(), state.len()
    )]
    ShortState {
        /// The net.
        path: PathBuf,
        /// Traffic light id.
        light: String,
        /// Link index without a letter.
        index: usize,
        /// The state.
        state: String,
    },
    /// States of one program differ in length.
    #[error(
        "the program of traffic light {light:?} of the net {} has states of {} and of {} letters",
        path.display(), lengths.0, lengths.1
    )]
    UnevenStates {
        /// The net.
        path: PathBuf,
        /// Traffic light id.
        light: String,
        /// Two of the lengths.
        lengths: (usize, usize),
    },
}
