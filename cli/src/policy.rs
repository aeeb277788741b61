//! What `--policy` may name: a rule, or weights in any of the forms they come in.

use crate::failure::{Failure, OrBadInput, Outcome};
use crate::learned::Learned;
use crate::train::run_dir::latest_checkpoint;
use anyhow::Context;
use cross_config::EnvConfig;
use cross_model::Policy;
use cross_sim::controller::{Controller, RuleBased};
use cross_sim::scenario::Scenario;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A policy file inside a checkpoint.
pub(crate) const MODEL_FILE: &str = "model.safetensors";

/// A policy from which every worker makes a controller of its own.
#[derive(Debug, Clone)]
pub(crate) enum PolicySpec {
    Rule(RuleBased),
    Learned(Weights),
}

/// Weights in memory.
#[derive(Debug, Clone)]
pub(crate) struct Weights {
    /// What tables call it.
    pub(crate) name: String,
    bytes: Arc<[u8]>,
    /// Environment that it was trained for.
    pub(crate) env: EnvConfig,
}

impl Weights {
    /// Reads and checks a policy file.
    pub(crate) fn read(name: &str, file: &Path) -> Outcome<Self> {
        let bytes = std::fs::read(file)
            .with_context(|| format!("cannot read the policy {}", file.display()))
            .or_bad_input()?;
        let policy = Policy::from_snapshot(&bytes)
            .map_err(anyhow::Error::from)
            .with_context(|| format!("cannot use the policy {}", file.display()))
            .or_bad_input()?;
        Ok(Self { name: name.to_owned(), env: policy.env().clone(), bytes: bytes.into() })
    }
}

impl PolicySpec {
    /// A rule by name, or else weights: a checkpoint's directory, a run directory (its newest checkpoint), or a file.
    pub(crate) fn parse(text: &str) -> Outcome<Self> {
        if let Ok(rule) = text.parse::<RuleBased>() {
            return Ok(Self::Rule(rule));
        }
        let path = Path::new(text);
        let Some(file) = policy_file(path) else {
            return Err(Failure::input(match path.is_dir() {
                true => format!("{text} holds neither {MODEL_FILE} nor checkpoints; name a checkpoint or a run directory"),
                false => format!(
                    "there is no policy {text}; choose one of {}, or name a checkpoint, a run directory or a {MODEL_FILE}",
                    RuleBased::names().join(", ")
                ),
            }));
        };
        Weights::read(text.trim_end_matches('/'), &file).map(Self::Learned)
    }

    /// The environment that it must be evaluated in, if it has one of its own.
    pub(crate) fn env(&self) -> Option<&EnvConfig> {
        match self {
            Self::Rule(_) => None,
            Self::Learned(weights) => Some(&weights.env),
        }
    }

    /// A controller for one worker.
    pub(crate) fn controller(&self, scenario: &Scenario) -> Outcome<Box<dyn Controller>> {
        match self {
            Self::Rule(rule) => Ok(rule.controller(scenario.reference.max_pressure)),
            Self::Learned(weights) => {
                Ok(Box::new(Learned::new(weights.name.clone(), &weights.bytes).or_bad_input()?))
            }
        }
    }
}

/// The policy file that a path means.
fn policy_file(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        return Some(path.to_owned());
    }
    let direct = path.join(MODEL_FILE);
    if direct.is_file() {
        return Some(direct);
    }
    // A run directory, or its folder of checkpoints.
    [path.join("checkpoints"), path.to_owned()].into_iter().find_map(|checkpoints| {
        let file = checkpoints.join(latest_checkpoint(&checkpoints)?).join(MODEL_FILE);
        file.is_file().then_some(file)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_go_by_name() {
        assert!(matches!(PolicySpec::parse("fixed-time"), Ok(PolicySpec::Rule(RuleBased::FixedTime))));
    }

    #[test]
    fn a_run_directory_means_its_newest_checkpoint() {
        let directory = tempfile::tempdir().unwrap();
        let checkpoints = directory.path().join("checkpoints");
        std::fs::create_dir_all(checkpoints.join("000002")).unwrap();
        std::fs::write(checkpoints.join("latest"), "000002\n").unwrap();
        let file = checkpoints.join("000002").join(MODEL_FILE);
        std::fs::write(&file, "").unwrap();
        for path in [directory.path(), &checkpoints, &checkpoints.join("000002"), &file] {
            assert_eq!(policy_file(path).as_ref(), Some(&file));
        }
    }

    #[test]
    fn what_is_no_policy_is_bad_input() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("x");
        std::fs::write(&file, "not weights").unwrap();
        for (text, part) in [
            ("max-presure", "max-pressure"),
            (directory.path().to_str().unwrap(), "neither"),
            (file.to_str().unwrap(), "cannot use the policy"),
        ] {
            let failure = PolicySpec::parse(text).unwrap_err();
            assert_eq!(failure.code(), crate::failure::BAD_INPUT);
            assert!(failure.to_string().contains(part), "{failure}");
        }
    }
}
