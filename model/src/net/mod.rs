//! One CROSS network (paper, section IV): general feature extraction, predictive contrastive clustering, mixture of
//! experts, head. Actor and critic are two of these with weights of their own.
//!
//! ```text
//!  batch ─> Gfe ─> h_sp ──────────────┬────────> Moe ─> h_moe ─> head ─> one number per phase
//!              └─> recurrent state    │            ^
//!  batch ─> Pcc ─> z_hat ─────────────┴─ router ───┘
//! ```

mod experts;
mod gate;
mod gfe;
mod gru;
mod lanes;
mod layers;
mod moe;
mod pcc;
mod tape;

pub use moe::MoeOutput;
pub use pcc::PccOutput;

use crate::batch::Batch;
use crate::features::FeatureSizes;
use crate::params::{Init, Params};
use crate::placement::Placement;
use cross_config::{Gfe, ModelConfig};
use gfe::{GfeNet, PhaseFeatures};
use layers::Linear;
use moe::{Moe, Pattern};
use pcc::Pcc;
use rand_chacha::ChaCha8Rng;
use std::rc::Rc;
use tape::Tape;
use tch::{Device, TchError, Tensor};

/// What a network is for; decides the initial scale of its head.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Chooses phases.
    Actor,
    /// Estimates returns.
    Critic,
}

impl Role {
    /// Prefix of the parameters' names.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Actor => "actor",
            Self::Critic => "critic",
        }
    }
}

/// A network with its parameters.
#[derive(Debug)]
pub struct Net {
    params: Params,
    gfe: GfeNet,
    pcc: Option<Pcc>,
    moe: Moe,
    head: Linear,
    device: Device,
}

/// All that a forward pass gives.
#[derive(Debug)]
pub struct Forward {
    /// One number per packed phase row `[rows]`: a logit or a value.
    pub scores: Tensor,
    /// Recurrent state after every step `[sequences, steps, hidden]`.
    pub states: Tensor,
    /// Clustering, if configured.
    pub pcc: Option<PccOutput>,
    /// Routing.
    pub moe: MoeOutput,
    h_sp: PhaseFeatures,
    tape: Rc<Tape>,
}

/// How gradients get from a loss to a network's weights: by libtorch's graph, and past its end where this network has a way
/// back of its own.
#[derive(Debug, Clone)]
pub struct WayBack(Rc<Tape>);

impl WayBack {
    /// Leaves the gradients of `loss`, which this pass led to, at all parameters. Once for each pass.
    ///
    /// # Errors
    /// libtorch's.
    pub fn descend_from(&self, loss: &Tensor) -> Result<(), TchError> {
        loss.f_backward()?;
        self.0.backward()
    }
}

impl Forward {
    /// The way that gradients take.
    #[must_use]
    pub fn way_back(&self) -> WayBack {
        WayBack(Rc::clone(&self.tape))
    }
}

impl Net {
    /// A network with fresh weights, in single precision on the CPU.
    #[must_use]
    pub fn new(role: Role, config: &ModelConfig, sizes: &FeatureSizes, rng: &mut ChaCha8Rng) -> Self {
        Self::placed(role, config, sizes, rng, Placement::CPU)
    }

    /// A network with fresh weights; the same ones wherever it is.
    #[must_use]
    pub fn placed(
        role: Role,
        config: &ModelConfig,
        sizes: &FeatureSizes,
        rng: &mut ChaCha8Rng,
        placement: Placement,
    ) -> Self {
        let mut params = Params::new();
        let mut init = Init::placed(role.name(), &mut params, rng, placement);
        let gfe = GfeNet::new(&mut init.sub("gfe"), config, sizes);
        let pcc = config.pcc.then(|| Pcc::new(&mut init.sub("pcc"), config, sizes));
        let context = if config.pcc { config.latent } else { 0 };
        let moe = Moe::new(&mut init.sub("moe"), config, context);
        // A small policy head starts near the uniform policy, which explores.
        let gain = if role == Role::Actor { 0.01 } else { 1.0 };
        // One column: nothing to gain from a lower precision, and logits and values would lose digits.
        let head = Linear::with_gain(&mut init.sub("head"), config.hidden, 1, gain).in_full_precision();
        Self { params, gfe, pcc, moe, head, device: placement.device }
    }

    /// How many parameters (scalars) such a network has, without building it. The configuration must be a valid one.
    #[must_use]
    pub fn scalars(config: &ModelConfig, sizes: &FeatureSizes) -> i64 {
        let linear = |inputs: i64, outputs: i64| (inputs + 1) * outputs;
        let mlp = |inputs: i64, hidden: i64, outputs: i64| linear(inputs, hidden) + linear(hidden, outputs);
        let (hidden, latent) = (config.hidden, config.latent);
        let square = linear(hidden, hidden);
        let (phase, state, target, gfe) = match config.gfe {
            Gfe::Paper => {
                let gfe = mlp(sizes.movements, 64, hidden) + mlp(sizes.state, hidden, hidden);
                (sizes.movements, sizes.state, sizes.state, gfe)
            }
            Gfe::Movement => {
                let attention = 2 * hidden + 2 * square + 2 * sizes.lane * hidden;
                let gfe = mlp(sizes.phase, hidden, hidden) + mlp(2 * hidden, hidden, hidden) + attention;
                (sizes.phase, 2 * sizes.phase, sizes.pooled, gfe)
            }
        };
        let recurrent = 6 * square + 2 * square;
        let pcc = 2 * hidden * (phase + state)
            + linear(sizes.topology, 2 * hidden)
            + linear(hidden, latent)
            + linear(latent, target)
            + linear(latent, latent)
            + 2 * latent
            + config.clusters * latent;
        let context = if config.pcc { latent } else { 0 };
        let moe = if config.moe {
            mlp(hidden + context, hidden, config.experts) + config.experts * mlp(hidden, hidden, hidden)
        } else {
            mlp(hidden, config.top_k * hidden, hidden)
        };
        gfe + recurrent + if config.pcc { pcc } else { 0 } + moe + linear(hidden, 1)
    }

    /// Names and tensors of its weights.
    #[must_use]
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// Where it is; batches and states have to be there too.
    #[must_use]
    pub fn device(&self) -> Device {
        self.device
    }

    /// The whole pass. `state` is the recurrent state at the start of each sequence `[sequences, hidden]`.
    #[must_use]
    pub fn forward(&self, batch: &Batch, state: &Tensor) -> Forward {
        self.pass(batch, state, Tape::new(&self.sample()))
    }

    /// The same with libtorch's operations alone, as on devices other than the CPU. Slower there; for tests.
    #[must_use]
    pub fn forward_without_loops(&self, batch: &Batch, state: &Tensor) -> Forward {
        self.pass(batch, state, Tape::without_loops(&self.sample()))
    }

    /// Something computed from a parameter: where it is, and whether gradients are wanted at present.
    fn sample(&self) -> Tensor {
        self.head.bias() * 1.0
    }

    fn pass(&self, batch: &Batch, state: &Tensor, mut tape: Tape) -> Forward {
        let gfe = self.gfe.forward(batch, state, &mut tape);
        let clustered = self.pcc.as_ref().map(|pcc| (pcc.forward(batch, &mut tape), pcc.centres()));
        let pattern = clustered.as_ref().map(|(pcc, centres)| Pattern { weights: &pcc.weights, centres });
        let moe = self.moe.forward(batch, &gfe.h_sp, pattern.as_ref(), &self.head, &mut tape);
        let pcc = clustered.map(|(pcc, _)| pcc);
        Forward {
            scores: moe.scores.shallow_clone(),
            states: gfe.states,
            h_sp: gfe.h_sp,
            tape: Rc::new(tape),
            pcc,
            moe,
        }
    }

    /// Phase-aware representation of every packed row `[rows, hidden]`.
    pub fn h_sp(&self, batch: &Batch, forward: &Forward) -> Tensor {
        forward.h_sp.rows(batch)
    }

    /// The mixture's output `[rows, hidden]`, which a pass has no need of.
    pub fn h_moe(&self, batch: &Batch, forward: &Forward) -> Tensor {
        self.moe.mixed(&self.h_sp(batch, forward), &forward.moe)
    }

    /// The latent z of every row `[rows, latent]`, of which a pass needs only a projection.
    #[must_use]
    pub fn latent(&self, pcc: &PccOutput) -> Option<Tensor> {
        self.pcc.as_ref().map(|module| module.latent(pcc))
    }

    /// The pattern that the router sees, `z_hat` `[rows, latent]`.
    #[must_use]
    pub fn pattern(&self, pcc: &PccOutput) -> Option<Tensor> {
        self.pcc.as_ref().map(|module| pcc.weights.matmul(module.centres()))
    }

    /// The recurrent path alone: state after every step `[sequences, steps, hidden]`.
    pub fn advance(&self, batch: &Batch, state: &Tensor) -> Tensor {
        self.gfe.recurrent(batch, state, &mut Tape::new(&self.sample())).states
    }

    /// The linear prediction `[samples, target]` of the next step's features from the chosen phases' latents.
    #[must_use]
    pub fn predict(&self, pcc: &PccOutput, chosen_rows: &Tensor) -> Option<Tensor> {
        self.pcc.as_ref().map(|module| module.predict(pcc, chosen_rows))
    }

    /// The same in the form `paper`, an entry for each group, of the state's columns that are not padding in all of it.
    pub(crate) fn predict_real(
        &self,
        pcc: &PccOutput,
        batch: &Batch,
        chosen_rows: &Tensor,
    ) -> Option<Vec<Tensor>> {
        self.pcc.as_ref().map(|module| module.predict_real(pcc, batch, chosen_rows))
    }
}

/// Parts one below the other; a single one as it is.
fn join(mut parts: Vec<Tensor>) -> Tensor {
    if parts.len() == 1 { parts.remove(0) } else { Tensor::cat(&parts, 0) }
}
