//! Acting without libtorch: the forward pass of both networks for one observation, in plain Rust.
//!
//! A decision is some fifty small matrix products. libtorch spends as long on getting to each of them as on computing it,
//! and on packing and allocating for it; here weights are laid out once for each version, buffers are kept, and what does
//! not depend on the observation is computed once for each network of streets. Training keeps to libtorch, whose gradients
//! it needs; tests hold the two together. Figures: `docs/performance.md`.
//!
//! ```text
//!  observation ─ features ─┬─ phases, lanes ─> Features (GFE) ─ h_sp ─┬─> Moe ─> score of every phase
//!                          └─ context ───────> Pcc ─ assignment ──────┘
//! ```
//! Rows are phases: agents in layout order, each with its phases. What a row gives does not depend on the others beside it.

mod gfe;
mod lanes;
mod moe;
mod norm;
mod pcc;
#[cfg(test)]
mod tests;
mod weights;

use crate::error::ModelError;
use crate::features::{FeatureSizes, NetworkSpec, Track};
use crate::net::{Net, Role};
use crate::vector::Isa;
use cross_config::ModelConfig;
use gfe::{Features, FeaturesWork, Recurrent, RecurrentWork};
use moe::{Moe, MoeWork};
use pcc::{Pcc, PccConstant, PccWork};
use weights::Weights;

/// The actor's network.
#[derive(Debug)]
pub(crate) struct Actor {
    features: Features,
    pcc: Option<Pcc>,
    moe: Moe,
}

/// What the actor network computes once for a network of streets.
#[derive(Debug, Default)]
pub(crate) struct Constant {
    phases: Vec<f32>,
    pcc: PccConstant,
}

/// Buffers of [`Actor::forward`], and its result.
#[derive(Debug, Default)]
pub(crate) struct ActorWork {
    /// The score of every phase `[rows]`: a logit.
    pub(crate) scores: Vec<f32>,
    features: FeaturesWork,
    pcc: PccWork,
    moe: MoeWork,
    h_sp: Vec<f32>,
    assignment: Vec<f32>,
}

impl ActorWork {
    /// Weight of every expert in every phase `[rows, experts]`; empty without a mixture.
    pub(crate) fn gates(&self) -> Vec<f32> {
        self.moe.gates(self.scores.len())
    }

    /// Soft assignment of every phase `[rows, clusters]`; empty without clustering.
    pub(crate) fn assignment(&self) -> &[f32] {
        &self.assignment
    }
}

impl Actor {
    /// From an actor network's weights.
    ///
    /// # Errors
    /// [`ModelError::Mismatch`] if a weight is missing.
    pub(crate) fn new(
        isa: Isa,
        net: &Net,
        config: &ModelConfig,
        sizes: &FeatureSizes,
    ) -> Result<Self, ModelError> {
        let tensors = weights::by_name(net.params());
        let weights = Weights::new(&tensors, Role::Actor.name());
        let pcc = config.pcc.then(|| Pcc::new(isa, &weights.sub("pcc"), config)).transpose()?;
        Ok(Self {
            features: Features::new(isa, &weights.sub("gfe"), config, sizes.lane as usize)?,
            moe: Moe::new(isa, &weights, config, pcc.as_ref().map(Pcc::centres))?,
            pcc,
        })
    }

    /// What no observation on this network changes.
    pub(crate) fn constant(&self, network: &NetworkSpec) -> Constant {
        Constant {
            phases: self.features.constant(network),
            pcc: self.pcc.as_ref().map_or_else(PccConstant::default, |pcc| pcc.constant(network)),
        }
    }

    /// Scores every phase and takes the recurrent state `[agents, hidden]` one observation on.
    pub(crate) fn forward(
        &self,
        network: &NetworkSpec,
        constant: &Constant,
        seen: &Track,
        state: &mut [f32],
        work: &mut ActorWork,
    ) {
        self.features.forward(network, &constant.phases, seen, state, &mut work.features, &mut work.h_sp);
        if let Some(pcc) = &self.pcc {
            pcc.assign(network, &constant.pcc, seen, &mut work.pcc, &mut work.assignment);
        }
        self.moe.forward(&work.h_sp, &work.assignment, &mut work.moe, &mut work.scores);
    }
}

/// What acting needs of the critic: its recurrent state, which a fragment records.
#[derive(Debug)]
pub(crate) struct Critic {
    recurrent: Recurrent,
}

/// Buffers of [`Critic::advance`].
#[derive(Debug, Default)]
pub(crate) struct CriticWork(RecurrentWork);

impl Critic {
    /// From a critic network's weights.
    ///
    /// # Errors
    /// As [`Actor::new`].
    pub(crate) fn new(isa: Isa, net: &Net, config: &ModelConfig) -> Result<Self, ModelError> {
        let tensors = weights::by_name(net.params());
        let weights = Weights::new(&tensors, Role::Critic.name());
        Ok(Self { recurrent: Recurrent::new(isa, &weights.sub("gfe"), config)? })
    }

    /// Takes the recurrent state `[agents, hidden]` one observation on.
    pub(crate) fn advance(
        &self,
        network: &NetworkSpec,
        seen: &Track,
        state: &mut [f32],
        work: &mut CriticWork,
    ) {
        self.recurrent.advance(network, seen, state, &mut work.0);
    }
}
