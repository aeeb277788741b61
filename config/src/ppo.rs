//! The algorithm.

use crate::env::EnvConfig;
use crate::error::{ConfigError, in_range};
use serde::{Deserialize, Serialize};

/// How raw rewards (minus stopped vehicles) are scaled before learning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RewardScale {
    /// As the environment gives them.
    Raw,
    /// Divided by 7 vehicles (what 50 m of lane hold) times the number of incoming lanes, so that networks weigh alike.
    Capacity,
}

/// The size at which the critic learns returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ValueScale {
    /// As they are.
    Raw,
    /// Shifted and scaled to mean 0 and deviation 1, each scenario by itself, by running moments.
    Scenario,
}

/// Weight of the entropy bonus over the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EntropySchedule {
    /// The same throughout.
    Constant,
    /// Falls in a straight line to a tenth at the last update.
    Linear,
}

/// Recurrent multi-scenario PPO.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PpoConfig {
    /// Steps (decisions of every agent) collected of each scenario for one update.
    pub round_steps: u32,
    /// Passes over a round's data (paper: 6). Simulating is cheaper than learning here, so fresh data beats used data.
    pub epochs: u32,
    /// Length of a training sequence in steps; the recurrent state at its start is recomputed, never zero mid-episode.
    pub sequence_steps: u32,
    /// Agent-decisions in a minibatch, at least; sequences are never split.
    pub minibatch_decisions: u32,
    /// Learning rate of the actor's Adam.
    pub actor_lr: f64,
    /// Learning rate of the critic's Adam.
    pub critic_lr: f64,
    /// Fall both learning rates in a straight line to a tenth at the last update.
    pub lr_decay: bool,
    /// Largest gradient norm of each network.
    pub max_grad_norm: f64,
    /// Clip ratio epsilon.
    pub clip_ratio: f64,
    /// Discount per decision.
    pub gamma: f64,
    /// GAE lambda.
    pub gae_lambda: f64,
    /// Weight of the entropy bonus.
    pub entropy: f64,
    /// How that weight moves over the run.
    pub entropy_schedule: EntropySchedule,
    /// Weight of the value loss.
    pub value: f64,
    /// Weight of the prediction loss.
    pub prediction: f64,
    /// Weight of the clustering loss.
    pub clustering: f64,
    /// Weight of the diversity term inside the clustering loss. At 1 the contrastive term, which can fall by log K, wins
    /// and all rows end in one cluster.
    pub diversity: f64,
    /// Weight of the experts' load balancing.
    pub load_balance: f64,
    /// Weight of the routing entropy.
    pub selection_entropy: f64,
    /// Normalise advantages per scenario.
    pub normalise_advantages: bool,
    /// Reward scaling for learning; logs always show the raw reward.
    pub reward_scale: RewardScale,
    /// Further constant factor on the reward for learning.
    pub reward_factor: f64,
    /// Size at which the critic learns returns.
    pub value_scale: ValueScale,
}

impl Default for PpoConfig {
    fn default() -> Self {
        Self {
            round_steps: 720,
            epochs: 1,
            sequence_steps: 30,
            minibatch_decisions: 1440,
            actor_lr: 7e-4,
            critic_lr: 7e-4,
            lr_decay: true,
            max_grad_norm: 10.0,
            clip_ratio: 0.2,
            gamma: 0.95,
            gae_lambda: 0.95,
            entropy: 0.01,
            entropy_schedule: EntropySchedule::Constant,
            value: 0.5,
            prediction: 0.05,
            clustering: 0.1,
            diversity: 4.0,
            load_balance: 0.001,
            selection_entropy: 0.0001,
            normalise_advantages: true,
            reward_scale: RewardScale::Capacity,
            reward_factor: 10.0,
            value_scale: ValueScale::Scenario,
        }
    }
}

impl PpoConfig {
    pub(crate) fn validate(&self, env: &EnvConfig) -> Result<(), ConfigError> {
        in_range("ppo.round_steps", self.round_steps, 1, 1_000_000)?;
        in_range("ppo.epochs", self.epochs, 1, 1000)?;
        in_range("ppo.sequence_steps", self.sequence_steps, 1, env.steps_per_episode())?;
        in_range("ppo.minibatch_decisions", self.minibatch_decisions, 1, 100_000_000)?;
        for (key, value, high) in [
            ("ppo.actor_lr", self.actor_lr, 1.0),
            ("ppo.critic_lr", self.critic_lr, 1.0),
            ("ppo.entropy", self.entropy, 100.0),
            ("ppo.value", self.value, 100.0),
            ("ppo.prediction", self.prediction, 100.0),
            ("ppo.clustering", self.clustering, 100.0),
            ("ppo.diversity", self.diversity, 100.0),
            ("ppo.load_balance", self.load_balance, 100.0),
            ("ppo.selection_entropy", self.selection_entropy, 100.0),
            ("ppo.gamma", self.gamma, 1.0),
            ("ppo.gae_lambda", self.gae_lambda, 1.0),
        ] {
            in_range(key, value, 0.0, high)?;
        }
        in_range("ppo.max_grad_norm", self.max_grad_norm, 1e-6, 1e9)?;
        in_range("ppo.clip_ratio", self.clip_ratio, 1e-6, 10.0)?;
        in_range("ppo.reward_factor", self.reward_factor, 1e-6, 1e6)
    }
}
