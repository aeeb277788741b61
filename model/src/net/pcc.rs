//! Predictive contrastive clustering (paper, section IV-B).
//!
//! The first layer is linear in its concatenated input, so each part is projected where it varies: counts per sample,
//! phase per row (in the form `paper` per agent), topology per agent. The latent z is linear in what the gated unit gives,
//! and rows need only z's projection, which is linear in turn: z itself is computed where a prediction is asked for.

use super::gate::{self, Sums};
use super::join;
use super::layers::{LayerNorm, Linear, Projection};
use super::tape::Tape;
use crate::batch::{Batch, Inputs, whole_numbers};
use crate::features::FeatureSizes;
use crate::params::Init;
use cross_config::{Gfe, ModelConfig};
use tch::{Kind, Tensor};

/// What clustering gives for every packed phase row.
#[derive(Debug)]
pub struct PccOutput {
    /// What the gated unit gives `[rows, hidden]`.
    hidden: Tensor,
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

    pub(super) fn forward(&self, batch: &Batch, tape: &mut Tape) -> PccOutput {
        let hidden = self.hidden(batch, tape);
        let phi = self.norm.forward(&self.project.after(&self.second).forward(&hidden));
        // Divided by their length after the product: six numbers instead of the whole row.
        let length = phi.norm_scalaropt_dim(2, [1i64].as_slice(), true);
        let similarity = phi.matmul(&unit_rows(&self.centres).transpose(0, 1)) / length.clamp_min(1e-6);
        let log_weights = (&similarity / self.tau_k).log_softmax(-1, Kind::Float);
        PccOutput { hidden, similarity, weights: log_weights.exp(), log_weights }
    }

    /// The gated unit on `[S, G^p, I]` `[rows, hidden]`.
    fn hidden(&self, batch: &Batch, tape: &mut Tape) -> Tensor {
        let (states, phases) = match &batch.inputs {
            Inputs::Paper(paper) => {
                let own = batch.real_columns(&paper.states);
                let groups = batch.groups.iter().zip(&own);
                let states = groups.map(|(group, own)| self.state.first_columns(group.columns).forward(own));
                (join(states.collect()), self.phase.forward(&paper.phase_states))
            }
            Inputs::Movement(movement) => {
                (self.state.forward(&movement.context), self.phase.forward(&movement.phases))
            }
        };
        // Topology is constant in time: one row per sequence, added at each of its steps.
        let topology = self.topology.forward(&batch.topology).unsqueeze(1);
        let width = topology.size()[2];
        let samples = (states.view([batch.sequences, batch.steps, width]) + topology).view([-1, width]);
        if tape.loops() {
            let phase = match &batch.inputs {
                Inputs::Paper(paper) => whole_numbers(&paper.phase_of_row),
                Inputs::Movement(_) => (0..batch.rows).collect(),
            };
            let sample = whole_numbers(batch.sample_of_row());
            return gate::gated(Sums { phases, samples, phase, sample }, tape);
        }
        // Group by group, so that what phases or steps share is added without being copied.
        let of_phases = match &batch.inputs {
            Inputs::Paper(_) => batch.group_static_phases(),
            Inputs::Movement(_) => batch.group_rows(),
        };
        let phases = phases.split_with_sizes(of_phases, 0);
        let samples = samples.split_with_sizes(batch.group_samples(), 0);
        let groups = batch.groups.iter().zip(samples).zip(phases).map(|((group, sample), phase)| {
            // [sequences, steps or 1, phases, width] + [sequences, steps, 1, width]
            let sequences = group.samples / batch.steps;
            let phase = phase.view([sequences, -1, group.phases, width]);
            let sample = sample.view([sequences, batch.steps, 1, width]);
            (phase + sample).glu(-1).view([group.samples * group.phases, width / 2])
        });
        join(groups.collect())
    }

    /// The latent z of every row `[rows, latent]`.
    pub(super) fn latent(&self, output: &PccOutput) -> Tensor {
        self.second.forward(&output.hidden)
    }

    /// What the router sees of the pattern: `z_hat = weights x centres`.
    pub(super) fn centres(&self) -> &Tensor {
        &self.centres
    }

    /// The latent z of one row of each sample `[samples, latent]`.
    fn chosen_latent(&self, output: &PccOutput, chosen_rows: &Tensor) -> Tensor {
        self.second.forward(&output.hidden.index_select(0, chosen_rows))
    }

    /// The prediction from one row of each sample `[samples, target]`.
    pub(super) fn predict(&self, output: &PccOutput, chosen_rows: &Tensor) -> Tensor {
        self.predict.forward(&self.chosen_latent(output, chosen_rows))
    }

    /// The same in the form `paper`, group by group, of the columns that some movement of the group has.
    pub(super) fn predict_real(
        &self,
        output: &PccOutput,
        batch: &Batch,
        chosen_rows: &Tensor,
    ) -> Vec<Tensor> {
        let latent = self.chosen_latent(output, chosen_rows);
        let groups = batch.groups.iter().zip(latent.split_with_sizes(batch.group_samples(), 0));
        groups.map(|(group, own)| self.predict.first_rows(group.columns).forward(&own)).collect()
    }
}

/// Rows scaled to length 1.
fn unit_rows(x: &Tensor) -> Tensor {
    let square: Tensor = x * x;
    x / square.sum_dim_intlist(-1, true, Kind::Float).clamp_min(1e-12).sqrt()
}
