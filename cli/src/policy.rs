//! What `--policy` may name: a rule, or weights in any of the forms they come in.

use crate::failure::{Failure, OrBadInput, Outcome};
use crate::learned::{Acting, Learned};
use crate::routing::RoutingLog;
use crate::saved::policy_by_url;
use anyhow::Context;
use cross_config::EnvConfig;
use cross_learner::checkpoint::{Metadata, reader};
use cross_model::Policy;
use cross_sim::controller::{Controller, RuleBased};
use cross_sim::scenario::Scenario;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Bytes of a hash that tell weights apart.
const HASH_BYTES: usize = 6;

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
    /// First digits of the SHA-256 of the bytes.
    pub(crate) hash: String,
    bytes: Arc<[u8]>,
    /// How its phases are chosen.
    pub(crate) acting: Acting,
    /// Environment that it was trained for.
    pub(crate) env: EnvConfig,
    /// Layout hashes of the scenarios that it was trained on, by name, if a checkpoint tells: a file alone does not.
    pub(crate) trained_on: Option<BTreeMap<String, String>>,
}

impl Weights {
    /// Reads and checks what a path stands for: a run directory (its newest checkpoint), a checkpoint, or a policy file.
    pub(crate) fn read(name: &str, path: &Path) -> Outcome<Self> {
        Self::of(name, reader::load_policy(path).or_bad_input()?)
    }

    fn of(name: &str, (metadata, bytes): (Option<Metadata>, Vec<u8>)) -> Outcome<Self> {
        let policy = Policy::from_snapshot(&bytes)
            .map_err(anyhow::Error::from)
            .with_context(|| format!("cannot use the policy {name}"))
            .or_bad_input()?;
        let hash = hex::encode(&Sha256::digest(&bytes)[..HASH_BYTES]);
        Ok(Self {
            name: name.to_owned(),
            hash,
            env: policy.env().clone(),
            bytes: bytes.into(),
            acting: Acting::Greedy,
            trained_on: metadata.map(|metadata| metadata.layouts),
        })
    }
}

impl PolicySpec {
    /// A rule by name, or else weights: a checkpoint's directory, a run directory (its newest checkpoint), a file, or the URL
    /// of any of them in an object store.
    pub(crate) fn parse(text: &str) -> Outcome<Self> {
        if let Ok(rule) = text.parse::<RuleBased>() {
            return Ok(Self::Rule(rule));
        }
        if let Some(found) = policy_by_url(text)? {
            return Weights::of(text.trim_end_matches('/'), found).map(Self::Learned);
        }
        let path = Path::new(text);
        if !path.exists() {
            return Err(Failure::input(format!(
                "there is no policy {text}; choose one of {}, or name a checkpoint, a run directory or a policy file",
                RuleBased::names().join(", ")
            )));
        }
        Weights::read(text.trim_end_matches('/'), path).map(Self::Learned)
    }

    /// The same learned policy with its phases drawn by their probabilities.
    ///
    /// # Errors
    /// Of a rule, which has none.
    pub(crate) fn sampled(self) -> Outcome<Self> {
        match self {
            Self::Rule(rule) => Err(Failure::input(format!(
                "{rule} is a rule, whose phases have no probabilities; leave --sampled out"
            ))),
            Self::Learned(weights) => Ok(Self::Learned(Weights {
                name: format!("{}, sampled", weights.name),
                acting: Acting::Sampled,
                ..weights
            })),
        }
    }

    /// What reports call it.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Rule(rule) => rule.name(),
            Self::Learned(weights) => &weights.name,
        }
    }

    /// The rule, if it is one.
    pub(crate) fn rule(&self) -> Option<RuleBased> {
        match self {
            Self::Rule(rule) => Some(*rule),
            Self::Learned(_) => None,
        }
    }

    /// What tells it from every other policy: a rule's name, or the hash of the weights, however they are called, and how
    /// their phases are chosen.
    pub(crate) fn key(&self) -> String {
        match self {
            Self::Rule(rule) => rule.name().to_owned(),
            Self::Learned(weights) => match weights.acting {
                Acting::Greedy => format!("weights-{}", weights.hash),
                Acting::Sampled => format!("weights-{}-sampled", weights.hash),
            },
        }
    }

    /// Whether it was trained on a network with this layout hash; `None` for a rule, and for weights that do not tell.
    pub(crate) fn trained_on(&self, layout_hash: &str) -> Option<bool> {
        match self {
            Self::Rule(_) => None,
            Self::Learned(weights) => {
                weights.trained_on.as_ref().map(|layouts| layouts.values().any(|hash| hash == layout_hash))
            }
        }
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
        self.logged(scenario, None)
    }

    /// As [`PolicySpec::controller`]; a learned one writes down which experts and clusters it uses.
    pub(crate) fn logged(
        &self,
        scenario: &Scenario,
        log: Option<RoutingLog>,
    ) -> Outcome<Box<dyn Controller>> {
        match self {
            Self::Rule(rule) => Ok(rule.controller(scenario.reference.max_pressure)),
            Self::Learned(Weights { name, bytes, acting, .. }) => {
                Ok(Box::new(Learned::new(name.clone(), bytes, *acting, log).or_bad_input()?))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_go_by_name() {
        assert!(matches!(PolicySpec::parse("fixed-time"), Ok(PolicySpec::Rule(RuleBased::FixedTime))));
    }

    #[test]
    fn a_rule_has_no_probabilities_to_draw_by() {
        let failure = PolicySpec::Rule(RuleBased::FixedTime).sampled().unwrap_err();
        assert_eq!(failure.code(), crate::failure::BAD_INPUT);
        assert!(failure.to_string().contains("--sampled"), "{failure}");
    }

    #[test]
    fn what_is_no_policy_is_bad_input() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("x");
        std::fs::write(&file, "not weights").unwrap();
        for (text, part) in [
            ("max-presure", "max-pressure"),
            (directory.path().to_str().unwrap(), "metadata.json"),
            (file.to_str().unwrap(), file.to_str().unwrap()),
        ] {
            let failure = PolicySpec::parse(text).unwrap_err();
            assert_eq!(failure.code(), crate::failure::BAD_INPUT);
            assert!(failure.to_string().contains(part), "{failure}");
        }
    }
}
