//! The networks.

use crate::error::{ConfigError, in_range};
use serde::{Deserialize, Serialize};

/// Form of the General Feature Extraction module.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Gfe {
    /// The paper's: all movements in link order, flattened and padded.
    Paper,
    /// Ours: sums over each phase's green lanes, which carries over to networks never seen.
    Movement,
}

/// What a lane of several movements counts for in a phase that opens some of them, in the form `movement`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LaneGreen {
    /// As much as the movement with the best right of way.
    Strongest,
    /// The mean over the lane's movements, on incoming lanes: whoever waits there wants any of them, but for turning round, which
    /// counts only on a lane for nothing else.
    Mean,
}

/// Networks of actor and critic (each has its own weights).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// Feature extraction: `paper` or `movement`.
    pub gfe: Gfe,
    /// Weight of a phase's green lanes in its sums: `strongest` or `mean`. `gfe = "paper"` does not use it.
    pub lane_green: LaneGreen,
    /// Predictive contrastive clustering; without it the router sees the phase features alone.
    pub pcc: bool,
    /// Mixture of experts; without it one dense expert of the same active size.
    pub moe: bool,
    /// Hidden width d.
    pub hidden: i64,
    /// Width of the clustering space d_z.
    pub latent: i64,
    /// Heads of the cross-attention.
    pub heads: i64,
    /// Number of cluster centres K.
    pub clusters: i64,
    /// Number of experts N_E.
    pub experts: i64,
    /// Experts active for a phase, k.
    pub top_k: i64,
    /// Temperature of the soft assignment to centres.
    pub tau_k: f64,
    /// Temperature of the contrastive loss.
    pub tau_c: f64,
    /// Temperature of the router.
    pub tau_r: f64,
    /// Whether the soft target of the contrastive loss is detached. With tau_k = tau_c (the paper's values) a detached
    /// target makes the loss's gradient exactly zero, and an attached one makes the loss the assignment's entropy.
    pub detach_contrastive_target: bool,
}

impl Default for ModelConfig {
    fn default() -> Self {
        Self {
            gfe: Gfe::Movement,
            lane_green: LaneGreen::Mean,
            pcc: true,
            moe: true,
            hidden: 128,
            latent: 64,
            heads: 4,
            clusters: 6,
            experts: 6,
            top_k: 2,
            tau_k: 0.1,
            tau_c: 0.1,
            tau_r: 1.0,
            detach_contrastive_target: false,
        }
    }
}

impl ModelConfig {
    /// Corrects what was parsed from text that a program wrote, with every key that it knew; `has` tells whether the text has
    /// a key. For one that came later this sets what versions without it did: their weights would mean something else under
    /// the default of today.
    pub fn complete_older(&mut self, has: impl Fn(&str) -> bool) {
        if !has("lane_green") {
            self.lane_green = LaneGreen::Strongest;
        }
    }

    /// Checks that networks can be built of these.
    ///
    /// # Errors
    /// [`ConfigError::Invalid`] with the first key at fault and what it may be.
    pub fn validate(&self) -> Result<(), ConfigError> {
        in_range("model.hidden", self.hidden, 8, 4096)?;
        in_range("model.latent", self.latent, 2, 4096)?;
        in_range("model.heads", self.heads, 1, 64)?;
        if self.hidden % self.heads != 0 {
            return Err(ConfigError::invalid(
                "model.heads",
                format!("is {}, which does not divide model.hidden = {}", self.heads, self.hidden),
            ));
        }
        in_range("model.clusters", self.clusters, 2, 1024)?;
        in_range("model.experts", self.experts, 1, 1024)?;
        in_range("model.top_k", self.top_k, 1, self.experts)?;
        in_range("model.tau_k", self.tau_k, 1e-3, 100.0)?;
        in_range("model.tau_c", self.tau_c, 1e-3, 100.0)?;
        in_range("model.tau_r", self.tau_r, 1e-3, 100.0)
    }
}
