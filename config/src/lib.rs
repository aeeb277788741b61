//! Every knob of CROSS in one place, with its unit, its default and the reason for it.
//!
//! One TOML file configures a run; unknown keys are refused by name. [`Config::default`] is what `make train` uses;
//! `configs/paper.toml` keeps the paper's form to the letter. The same structure travels to the actors as JSON, so a
//! cluster has one source of truth: the learner's file.

mod env;
mod error;
mod learner;
mod model;
mod ppo;

pub use env::{Detection, EnvConfig};
pub use error::ConfigError;
pub use learner::{ActorConfig, ComputeDevice, LearnerConfig, Precision, checkpoint_url};
pub use model::{Gfe, LaneGreen, ModelConfig};
pub use ppo::{EntropySchedule, PpoConfig, RewardScale, ValueScale};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::Path;

/// The whole configuration of a training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Seed of everything random: initial weights, minibatch order, action sampling, SUMO seeds of training episodes.
    pub seed: u64,
    /// Scenarios trained on together, by name or by path to a directory with a `scenario.toml`.
    pub scenarios: Vec<String>,
    /// Number of PPO updates after which training is complete.
    pub updates: u64,
    /// Decisions, signals, observation, reward.
    pub env: EnvConfig,
    /// Networks.
    pub model: ModelConfig,
    /// Algorithm.
    pub ppo: PpoConfig,
    /// Learner process: admission, checkpoints, limits.
    pub learner: LearnerConfig,
    /// Actor processes: fragments, reconnection, SUMO.
    pub actor: ActorConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            scenarios: vec!["grid4x4".to_owned()],
            updates: 60,
            env: EnvConfig::default(),
            model: ModelConfig::default(),
            ppo: PpoConfig::default(),
            learner: LearnerConfig::default(),
            actor: ActorConfig::default(),
        }
    }
}

impl Config {
    /// Reads and validates a TOML file.
    ///
    /// # Errors
    /// [`ConfigError`] names the file, and the key and line where the text is at fault.
    pub fn from_file(path: &Path) -> Result<Self, ConfigError> {
        Self::from_toml(&read(path)?, &path.display().to_string())
    }

    /// Parses and validates TOML text; `origin` is how errors call it.
    ///
    /// # Errors
    /// [`ConfigError::Parse`] for syntax, unknown keys and wrong types, [`ConfigError::Invalid`] for values that cannot work.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let config = Self::parse_toml(text, origin)?;
        config.validate().map_err(|error| error.of(origin))?;
        Ok(config)
    }

    /// The environment alone of a TOML file: what an evaluation needs. Unknown keys are refused in all of the file, values
    /// that cannot work only in `[env]`, because an episode that is too short to train on can still be evaluated.
    ///
    /// # Errors
    /// As [`Config::from_file`].
    pub fn env_from_file(path: &Path) -> Result<EnvConfig, ConfigError> {
        let origin = path.display().to_string();
        let config = Self::parse_toml(&read(path)?, &origin)?;
        config.env.validate().map_err(|error| error.of(&origin))?;
        Ok(config.env)
    }

    fn parse_toml(text: &str, origin: &str) -> Result<Self, ConfigError> {
        toml::from_str(text).map_err(|source| {
            let message = toml_problem(text, &source);
            ConfigError::Parse { origin: origin.to_owned(), message }
        })
    }

    /// Reads and validates the file that a run keeps of its configuration. It has every key that the version which began the
    /// run knew; see [`ModelConfig::complete_older`] for what holds where one is missing.
    ///
    /// # Errors
    /// As [`Config::from_file`].
    pub fn from_run(path: &Path) -> Result<Self, ConfigError> {
        let text = read(path)?;
        let mut config = Self::from_toml(&text, &path.display().to_string())?;
        let written: toml::Table = toml::from_str(&text).unwrap_or_default();
        let model = written.get("model").and_then(toml::Value::as_table);
        config.model.complete_older(|key| model.is_some_and(|model| model.contains_key(key)));
        Ok(config)
    }

    /// Parses and validates the JSON form that the learner hands to actors and writes into checkpoints. It has every key that
    /// its version knew; see [`ModelConfig::complete_older`] for what holds where one is missing.
    ///
    /// # Errors
    /// As [`Config::from_toml`].
    pub fn from_json(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let mut config: Self = serde_json::from_str(text).map_err(|source| ConfigError::Parse {
            origin: origin.to_owned(),
            message: source.to_string(),
        })?;
        let written: serde_json::Value = serde_json::from_str(text).unwrap_or_default();
        config.model.complete_older(|key| written["model"].get(key).is_some());
        config.validate().map_err(|error| error.of(origin))?;
        Ok(config)
    }

    /// The JSON form, keys in declaration order, without insignificant white space.
    #[must_use]
    pub fn to_json(&self) -> String {
        // The structure holds only numbers, strings and lists, which always serialise.
        serde_json::to_string(self).expect("a configuration serialises")
    }

    /// The TOML form, as `cross train` writes it into the run directory.
    #[must_use]
    pub fn to_toml(&self) -> String {
        // As above.
        toml::to_string_pretty(self).expect("a configuration serialises")
    }

    /// What actor and learner must agree on: 16 hex digits of SHA-256 over the environment and model sections.
    ///
    /// Algorithm and process settings may differ between a checkpoint and the run that resumes it; these two may not,
    /// because they decide what a weight means.
    #[must_use]
    pub fn compatibility_hash(&self) -> String {
        // As above.
        let json = serde_json::to_string(&(&self.env, &self.model)).expect("a configuration serialises");
        // Before there was this key, this was what it says now: runs that were begun then can go on.
        let json = json.replace(r#""lane_green":"strongest","#, "");
        hex::encode(&Sha256::digest(json)[..8])
    }

    /// 16 hex digits of SHA-256 over the whole configuration, as checkpoints record it.
    #[must_use]
    pub fn hash(&self) -> String {
        hex::encode(&Sha256::digest(self.to_json().as_bytes())[..8])
    }

    /// Checks that the values can work together.
    ///
    /// # Errors
    /// [`ConfigError::Invalid`] with the first key at fault and what it may be.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if self.scenarios.is_empty() {
            return Err(ConfigError::invalid("scenarios", "is empty; name at least one scenario"));
        }
        let mut names = self.scenarios.clone();
        names.sort();
        names.dedup();
        if names.len() != self.scenarios.len() {
            return Err(ConfigError::invalid("scenarios", "names a scenario twice; list each once"));
        }
        self.env.validate()?;
        self.model.validate()?;
        self.ppo.validate(&self.env)?;
        self.learner.validate(&self.env)?;
        self.actor.validate(&self.env)?;
        if self.learner.serial && !self.ppo.round_steps.is_multiple_of(self.env.steps_per_episode()) {
            return Err(ConfigError::invalid(
                "ppo.round_steps",
                format!(
                    "is {}, but serial mode resumes exactly only between whole episodes; make it a multiple of {}",
                    self.ppo.round_steps,
                    self.env.steps_per_episode()
                ),
            ));
        }
        Ok(())
    }
}

/// What is wrong with a TOML text, and in which line, in one line; the parser's own display spreads over five and draws.
#[must_use]
pub fn toml_problem(text: &str, error: &toml::de::Error) -> String {
    let what = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
    // A key that is missing is missing in no line.
    let span = error.span().filter(|_| !what.starts_with("missing field"));
    let Some(before) = span.and_then(|span| text.get(..span.start)) else { return what };
    let line = before.lines().count() + usize::from(before.is_empty() || before.ends_with('\n'));
    let written = text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
    let written: String = written.trim().chars().filter(|letter| !letter.is_control()).collect();
    if written.is_empty() { what } else { format!("line {line}, `{written}`: {what}") }
}

fn read(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_round_trips_through_toml_and_json() {
        let config = Config::default();
        assert_eq!(Config::from_toml(&config.to_toml(), "test").unwrap(), config);
        assert_eq!(Config::from_json(&config.to_json(), "test").unwrap(), config);
    }

    #[test]
    fn weights_of_an_older_version_keep_what_it_did() {
        let mut written: serde_json::Value = serde_json::from_str(&Config::default().to_json()).unwrap();
        written["model"].as_object_mut().unwrap().remove("lane_green");
        let config = Config::from_json(&written.to_string(), "test").unwrap();
        assert_eq!(config.model.lane_green, LaneGreen::Strongest);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("config.toml");
        let text = config.to_toml();
        std::fs::write(&file, text.replace("lane_green = \"strongest\"\n", "")).unwrap();
        assert_eq!(Config::from_run(&file).unwrap(), config);
        assert_eq!(Config::from_file(&file).unwrap().model.lane_green, LaneGreen::Mean);
        std::fs::write(&file, text.replace("strongest", "mean")).unwrap();
        assert_eq!(Config::from_run(&file).unwrap().model.lane_green, LaneGreen::Mean);
        assert_eq!(
            Config::from_toml("[model]\nhidden = 64\n", "test").unwrap().model.lane_green,
            LaneGreen::Mean
        );
    }

    #[test]
    fn a_run_that_was_begun_before_the_key_existed_goes_on() {
        let mut config = Config::default();
        config.env.detection = Detection::Fine;
        (config.env.reward_range_metres, config.env.reward_beyond) = (50.0, 0.6);
        config.model.lane_green = LaneGreen::Strongest;
        // As the policy `seven` (docs/experiments.md) has it, which is of such a version.
        assert_eq!(config.compatibility_hash(), "9203c7fc0e75e450");
        config.model.lane_green = LaneGreen::Mean;
        assert_ne!(config.compatibility_hash(), "9203c7fc0e75e450");
    }

    #[test]
    fn an_episode_too_short_to_train_on_can_be_evaluated() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("short.toml");
        std::fs::write(&file, "[env]\nepisode_seconds = 200\n").unwrap();
        assert!(Config::from_file(&file).is_err());
        assert_eq!(Config::env_from_file(&file).unwrap().episode_seconds, 200);
        std::fs::write(&file, "[env]\nepisode_seconds = 205\n").unwrap();
        assert!(Config::env_from_file(&file).unwrap_err().to_string().contains("episode_seconds"));
        std::fs::write(&file, "[ppo]\nepoch = 1\n").unwrap();
        assert!(Config::env_from_file(&file).unwrap_err().to_string().contains("epoch"));
    }

    #[test]
    fn unknown_key_is_refused_by_name() {
        let error = Config::from_toml("[ppo]\nlearning_rat = 1.0\n", "my.toml").unwrap_err().to_string();
        assert!(
            error.contains("my.toml") && error.contains("line 2") && error.contains("learning_rat"),
            "{error}"
        );
        assert!(!error.contains('\n'), "{error}");
    }

    #[test]
    fn a_value_that_cannot_work_is_refused_with_file_and_key() {
        let error = Config::from_toml("[ppo]\nactor_lr = -inf\n", "my.toml").unwrap_err().to_string();
        assert!(error.contains("my.toml") && error.contains("ppo.actor_lr is -inf"), "{error}");
        let error = Config { scenarios: Vec::new(), ..Config::default() }.validate().unwrap_err().to_string();
        assert!(error.starts_with("the configuration key scenarios is empty"), "{error}");
    }

    #[test]
    fn algorithm_changes_keep_compatibility_and_model_changes_do_not() {
        let base = Config::default();
        let mut other = base.clone();
        other.ppo.clip_ratio = 0.1;
        assert_eq!(base.compatibility_hash(), other.compatibility_hash());
        assert_ne!(base.hash(), other.hash());
        other.model.experts = 4;
        assert_ne!(base.compatibility_hash(), other.compatibility_hash());
    }

    #[test]
    fn serial_mode_needs_whole_episodes() {
        let mut config = Config::default();
        config.learner.serial = true;
        config.ppo.round_steps = 100;
        let error = config.validate().unwrap_err().to_string();
        assert!(error.contains("ppo.round_steps") && error.contains("360"), "{error}");
    }
}
