//! Predictive contrastive clustering (paper, section IV-B).
//!
//! The first layer is linear in its concatenated input, so each part is projected where it varies: counts per sample,
//! phase per row, topology per agent.

use super::layers::{LayerNorm, Linear, Projection};
use crate::batch::{Batch, Inputs};
use crate::features::FeatureSizes;
use crate::params::Init;
use cross_config::{Gfe, ModelConfig};
use tch::{Kind, Tensor};

/// What clustering gives for every packed phase row.
#[derive(Debug)]
pub struct PccOutput {
    /// Predictive latent `[rows, latent]`.
    pub z: Tensor,
    /// Cosine similarities to the centres `[rows, clusters]`.
    pub similarity: Tensor,
    /// Soft assignment `[rows, clusters]`.
    pub weights: Tensor,
    /// Quantised pattern `[rows, latent]`.
    pub z_hat: Tensor,
}

#[derive(Debug)]
pub(super) struct Pcc {
    tau_k: f64,
    phase: Projection,
    state: Projection,
    topology: Linear,
    second: Linear,
    predict: Linear,
    project: Linear,
    norm: LayerNorm,
    centres: Tensor,
}

impl Pcc {
    pub(super) fn new(init: &mut Init<'_>, config: &ModelConfig, sizes: &FeatureSizes) -> Self {
        let (phase, state, target) = match config.gfe {
            Gfe::Paper => (sizes.movements, sizes.state, sizes.state),
            Gfe::Movement => (sizes.phase, 2 * sizes.phase, sizes.pooled),
        };
        let fan_in = phase + state + sizes.topology;
        let (hidden, latent) = (config.hidden, config.latent);
        Self {
            tau_k: config.tau_k,
            phase: Projection::new(&mut init.sub("phase"), phase, 2 * hidden, fan_in),
            state: Projection::new(&mut init.sub("state"), state, 2 * hidden, fan_in),
            topology: Linear::new(&mut init.sub("topology"), sizes.topology, 2 * hidden),
            second: Linear::new(&mut init.sub("second"), hidden, latent),
            predict: Linear::new(&mut init.sub("predict"), latent, target),
            project: Linear::new(&mut init.sub("project"), latent, latent),
            norm: LayerNorm::new(&mut init.sub("norm"), latent),
            centres: init.uniform("centres", &[config.clusters, latent], 1.0 / (latent as f64).sqrt()),
        }
    }

    pub(super) fn forward(&self, batch: &Batch) -> PccOutput {
        // Topology is constant in time: one row per sequence, repeated over its steps.
        let topology = batch.repeat_over_steps(&self.topology.forward(&batch.topology));
        let (phase, state) = match &batch.inputs {
            Inputs::Paper(paper) => {
                let phase = self.phase.forward(&paper.phase_states).index_select(0, &paper.phase_of_row);
                (phase, self.state.forward(&paper.states))
            }
            Inputs::Movement(movement) => {
                (self.phase.forward(&movement.phases), self.state.forward(&movement.context))
            }
        };
        let hidden = (phase + batch.repeat_over_phases(&(state + topology))).glu(-1);
        let z = self.second.forward(&hidden);
        let projected = unit_rows(&self.norm.forward(&self.project.forward(&z)));
        let similarity = projected.matmul(&unit_rows(&self.centres).transpose(0, 1));
        let weights = (&similarity / self.tau_k).softmax(-1, Kind::Float);
        let z_hat = weights.matmul(&self.centres);
        PccOutput { z, similarity, weights, z_hat }
    }

    pub(super) fn predict(&self, output: &PccOutput, chosen_rows: &Tensor) -> Tensor {
        self.predict.forward(&output.z.index_select(0, chosen_rows))
    }
}

/// Rows scaled to length 1.
fn unit_rows(x: &Tensor) -> Tensor {
    let square: Tensor = x * x;
    x / square.sum_dim_intlist(-1, true, Kind::Float).clamp_min(1e-12).sqrt()
}
