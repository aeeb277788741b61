//! SUMO's own signal programs as controllers, to compare with.

use super::{Controller, ControllerError, ControllerView};
use crate::env::{Signals, SumoProgram};

/// Leaves the lights to a program inside SUMO. It decides nothing itself: whoever steps the environment gives it the
/// [`signals`](Controller::signals) of this controller, as the evaluation does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Program(pub SumoProgram);

impl Controller for Program {
    fn name(&self) -> &str {
        match self.0 {
            SumoProgram::Own => "own-program",
            SumoProgram::Actuated => "actuated",
            SumoProgram::DelayBased => "delay-based",
        }
    }

    fn signals(&self) -> Signals {
        Signals::Program(self.0)
    }

    fn act(&mut self, _: &ControllerView<'_>, _: &mut [u8]) -> Result<(), ControllerError> {
        Ok(())
    }
}
