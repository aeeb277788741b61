//! Who sets the traffic lights: whoever steps the environment, or a program inside SUMO.

/// Who sets the traffic lights of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Signals {
    /// Whoever steps the environment: one phase for each agent and decision.
    #[default]
    Driven,
    /// A program inside SUMO, second by second. Actions are not looked at; decisions only divide the episode.
    Program(SumoProgram),
}

/// A program by which SUMO sets traffic lights itself.
///
/// All three have the phases of the net's own programs in their order, yellow and all-red included. A traffic light that
/// is no agent keeps its own program, as it does under a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SumoProgram {
    /// What the net has: SUMO is told nothing.
    Own,
    /// SUMO's `actuated`: a green phase goes on while vehicles follow each other closely.
    Actuated,
    /// SUMO's `delay_based`: a green phase goes on while vehicles that have lost time approach.
    DelayBased,
}
