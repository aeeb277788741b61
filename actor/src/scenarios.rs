//! Finding the learner's scenarios on this machine.

use crate::error::ActorError;
use cross_sim::SimError;
use cross_sim::scenario::{Scenario, ScenarioPath};
use std::path::Path;

/// Loads the scenario that the learner calls `name`.
///
/// It is looked for by name, in `dir` first if given; then as the configuration names it, which may be a path and good
/// where learner and actor share a file system.
pub(crate) fn load(name: &str, configured: &[String], dir: Option<&Path>) -> Result<Scenario, ActorError> {
    let path = ScenarioPath::locate(dir);
    let by_configuration = || {
        configured
            .iter()
            .filter(|entry| entry.as_str() != name)
            .filter_map(|entry| path.load(entry).ok())
            .find(|scenario| scenario.name == name)
    };
    match path.load(name) {
        Ok(scenario) => Ok(scenario),
        Err(error) => by_configuration().ok_or_else(|| unusable(name, error.into())),
    }
}

/// A scenario that cannot be used here.
pub(crate) fn unusable(name: &str, source: SimError) -> ActorError {
    ActorError::Scenario { scenario: name.to_owned(), source: Box::new(source) }
}
