//! What making a scenario has in common, however it is made.

use crate::failure::{Failure, OrBadInput, Outcome};
use clap::Args;
use cross_sim::generate::{GenerateError, NewScenario};
use cross_sim::scenario;
use std::path::PathBuf;

/// Name and place of a new scenario.
#[derive(Debug, Args)]
pub(super) struct Target {
    /// What to call it
    #[arg(long, value_name = "NAME")]
    name: String,
    /// Folder to write it to, which must not exist yet
    ///
    /// Without it the scenario goes to .deps/scenarios/NAME and is found by its name.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the scenario that is there
    #[arg(long)]
    force: bool,
}

impl Target {
    /// The new scenario, simulated until `end` seconds.
    pub(super) fn scenario(
        &self,
        description: String,
        source: String,
        end: u32,
        time_to_teleport: f64,
    ) -> Outcome<NewScenario> {
        let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
        if self.name.is_empty() || self.name.starts_with('.') || !self.name.chars().all(plain) {
            return Err(Failure::input(format!(
                "--name is {:?}; take letters, digits, `-`, `_` and `.`, the first of them no dot",
                self.name
            )));
        }
        let folder = match &self.out {
            Some(folder) => std::path::absolute(folder).or_bad_input()?,
            None => scenario::place_for(&self.name),
        };
        Ok(NewScenario {
            name: self.name.clone(),
            description,
            source,
            folder,
            replace: self.force,
            end,
            time_to_teleport,
        })
    }
}

/// Tells what the person can change from what went wrong.
pub(super) fn failure(error: GenerateError) -> Failure {
    match error {
        GenerateError::Option { .. } | GenerateError::Exists { .. } | GenerateError::Sumo(_) => {
            Failure::bad_input(error)
        }
        other => Failure::from(other),
    }
}
