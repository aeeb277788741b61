//! What an agent sees and does.

use crate::error::{ConfigError, in_range};
use serde::{Deserialize, Serialize};

/// Which vehicles on a lane, and on what lies behind or beyond it on the same street, are counted, and into which bands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Detection {
    /// Two bands per lane: stopped and moving vehicles within 50 m of the lane's end (paper, section III-C).
    Paper,
    /// Three bands per lane: stopped on the whole lane, moving within 100 m of its end, moving beyond.
    Default,
    /// Six bands per lane: stopped within 50 m of its end, stopped beyond; moving within 50 m, from there to 100 m, to 200 m,
    /// and beyond. A vehicle that drives is seen nearer from decision to decision.
    Fine,
}

impl Detection {
    /// Number of counts per lane.
    #[must_use]
    pub fn bands(self) -> usize {
        match self {
            Self::Paper => 2,
            Self::Default => 3,
            Self::Fine => 6,
        }
    }

    /// How many of these, the first ones, count stopped vehicles; the others count moving ones.
    #[must_use]
    pub fn stopped_bands(self) -> usize {
        match self {
            Self::Paper | Self::Default => 1,
            Self::Fine => 2,
        }
    }
}

/// Decisions, signals, observation and reward.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvConfig {
    /// Seconds between two decisions.
    pub decision_seconds: u32,
    /// Seconds of yellow when the phase changes, inside the decision interval.
    pub yellow_seconds: u32,
    /// Simulated seconds of an episode; an episode that ends here is a truncation.
    pub episode_seconds: u32,
    /// Detection bands of the observation.
    pub detection: Detection,
    /// Metres before the stop line within which a stopped vehicle counts against the reward (paper: 50).
    pub reward_range_metres: f32,
    /// What a vehicle that is stopped farther from the stop line than that costs, where one within costs 1 (paper: 0).
    pub reward_beyond: f32,
    /// Most movements (lane-to-lane links) an intersection may have.
    pub max_movements: usize,
    /// Most green phases an intersection may have.
    pub max_phases: usize,
}

impl Default for EnvConfig {
    fn default() -> Self {
        Self {
            decision_seconds: 10,
            yellow_seconds: 3,
            episode_seconds: 3600,
            detection: Detection::Default,
            reward_range_metres: 50.0,
            reward_beyond: 0.0,
            max_movements: 36,
            max_phases: 8,
        }
    }
}

impl EnvConfig {
    /// Decisions of each agent in a full episode.
    #[must_use]
    pub fn steps_per_episode(&self) -> u32 {
        self.episode_seconds / self.decision_seconds.max(1)
    }

    /// Checks that the values can work together.
    ///
    /// # Errors
    /// [`ConfigError::Invalid`] with the first key at fault and what it may be.
    pub fn validate(&self) -> Result<(), ConfigError> {
        in_range("env.decision_seconds", self.decision_seconds, 1, 600)?;
        if self.yellow_seconds >= self.decision_seconds {
            return Err(ConfigError::invalid(
                "env.yellow_seconds",
                format!(
                    "is {}, which leaves no green in a decision interval of {} s; make it shorter",
                    self.yellow_seconds, self.decision_seconds
                ),
            ));
        }
        in_range("env.episode_seconds", self.episode_seconds, self.decision_seconds, 7 * 24 * 3600)?;
        if !self.episode_seconds.is_multiple_of(self.decision_seconds) {
            return Err(ConfigError::invalid(
                "env.episode_seconds",
                format!(
                    "is {}, which is not a whole number of decisions of {} s",
                    self.episode_seconds, self.decision_seconds
                ),
            ));
        }
        in_range("env.reward_range_metres", self.reward_range_metres, 1.0, 10_000.0)?;
        in_range("env.reward_beyond", self.reward_beyond, 0.0, 1.0)?;
        in_range("env.max_movements", self.max_movements, 1, 1024)?;
        in_range("env.max_phases", self.max_phases, 2, 64)
    }
}
