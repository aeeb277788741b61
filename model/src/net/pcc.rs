//! Predictive contrastive clustering (paper, section IV-B).
//!
//! The first layer is linear in its concatenated input, so each part is projected where it varies: counts per sample,
//! phase per row (in the form `paper` per agent), topology per agent. The latent z is linear in what the gated unit gives,
//! and rows need only z's projection, which is linear in turn: z itself is computed where a prediction is asked for.

use super::join;
use super::layers::{LayerNorm, Linear, Projection};
use crate::batch::{Batch, Inputs};
use crate::features::FeatureSizes;
use crate::params::Init;
use cross_config::{Gfe, ModelConfig};
use tch::{Kind, Tensor};

/// What clustering gives for every packed phase row.
#[derive(Debug)]
pub struct PccOutput {
    /// What the gated unit gives, one entry `[samples * phases, hidden]` per group.
    hidden: Vec<Tensor>,
    /// Cosine similarities to the centres `[rows, clusters]`.
    pub similarity: Tensor,
    /// Soft assignment `[rows, clusters]`.
    pub weights: Tensor,
    /// Its logarithm `[rows, clusters]`.
    pub log_weights: Tensor,
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
        let hidden = self.hidden(batch);
        let project = self.project.after(&self.second);
        let projected: Vec<Tensor> = hidden.iter().map(|own| project.forward(own)).collect();
        let phi = self.norm.forward(&join(projected));
        // Divided by their length after the product: six numbers instead of the whole row.
        let length = phi.norm_scalaropt_dim(2, [1i64].as_slice(), true);
        let similarity = phi.matmul(&unit_rows(&self.centres).transpose(0, 1)) / length.clamp_min(1e-6);
        let log_weights = (&similarity / self.tau_k).log_softmax(-1, Kind::Float);
        PccOutput { hidden, similarity, weights: log_weights.exp(), log_weights }
    }

    /// The gated unit on `[S, G^p, I]`, group by group, so that what phases or steps share is added without being copied.
    fn hidden(&self, batch: &Batch) -> Vec<Tensor> {
        let (states, static_phases) = match &batch.inputs {
            Inputs::Paper(paper) => {
                let own = batch.real_columns(&paper.states);
                let groups = batch.groups.iter().zip(&own);
                let states = groups.map(|(group, own)| self.state.first_columns(group.columns).forward(own));
                (states.collect::<Vec<_>>(), Some(self.phase.forward(&paper.phase_states)))
            }
            Inputs::Movement(movement) => {
                let states = self.state.forward(&movement.context);
                (states.split_with_sizes(batch.group_samples(), 0), None)
            }
        };
        // Topology is constant in time: one row per sequence, added at each of its steps.
        let topology = self.topology.forward(&batch.topology).unsqueeze(1);
        let topology = topology.split_with_sizes(batch.group_sequences(), 0);
        let bases = states.iter().zip(&topology).map(|(state, topology)| {
            state.view([topology.size()[0], batch.steps, topology.size()[2]]) + topology
        });
        let phases: Vec<Tensor> = match (&batch.inputs, static_phases) {
            (Inputs::Movement(movement), _) => {
                let own = movement.phases.split_with_sizes(batch.group_rows(), 0);
                own.iter().map(|rows| self.phase.forward(rows)).collect()
            }
            (Inputs::Paper(_), Some(phases)) => phases.split_with_sizes(batch.group_static_phases(), 0),
            (Inputs::Paper(_), None) => Vec::new(),
        };
        let groups = batch.groups.iter().zip(bases).zip(phases);
        groups
            .map(|((group, base), phase)| {
                let width = phase.size()[1];
                // [sequences, steps or 1, phases, width] + [sequences, steps, 1, width]
                let phase = phase.view([base.size()[0], -1, group.phases, width]);
                (phase + base.unsqueeze(2)).glu(-1).view([group.samples * group.phases, width / 2])
            })
            .collect()
    }

    /// The latent z of every row `[rows, latent]`.
    pub(super) fn latent(&self, output: &PccOutput) -> Tensor {
        join(output.hidden.iter().map(|own| self.second.forward(own)).collect())
    }

    /// What the router sees of the pattern: `z_hat = weights x centres`.
    pub(super) fn centres(&self) -> &Tensor {
        &self.centres
    }

    /// The latent z of one row of each sample `[samples, latent]`.
    fn chosen_latent(&self, output: &PccOutput, batch: &Batch, chosen_rows: &Tensor) -> Tensor {
        let chosen = chosen_rows.split_with_sizes(batch.group_samples(), 0);
        let groups = batch.groups.iter().zip(&output.hidden).zip(chosen);
        let hidden = groups.map(|((group, hidden), rows)| hidden.index_select(0, &(rows - group.first_row)));
        self.second.forward(&join(hidden.collect()))
    }

    /// The prediction from one row of each sample `[samples, target]`.
    pub(super) fn predict(&self, output: &PccOutput, batch: &Batch, chosen_rows: &Tensor) -> Tensor {
        self.predict.forward(&self.chosen_latent(output, batch, chosen_rows))
    }

    /// The same in the form `paper`, group by group, of the columns that some movement of the group has.
    pub(super) fn predict_real(
        &self,
        output: &PccOutput,
        batch: &Batch,
        chosen_rows: &Tensor,
    ) -> Vec<Tensor> {
        let latent = self.chosen_latent(output, batch, chosen_rows);
        let groups = batch.groups.iter().zip(latent.split_with_sizes(batch.group_samples(), 0));
        groups.map(|(group, own)| self.predict.first_rows(group.columns).forward(&own)).collect()
    }
}

/// Rows scaled to length 1.
fn unit_rows(x: &Tensor) -> Tensor {
    let square: Tensor = x * x;
    x / square.sum_dim_intlist(-1, true, Kind::Float).clamp_min(1e-12).sqrt()
}
