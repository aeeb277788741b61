//! General feature extraction (paper, section IV-A), in two forms.
//!
//! `paper`: one state token from all movements in link order, phases from their green masks.
//!
//! `movement`: phases from the summed counts of their green lanes, one state token from the phases' mean and maximum,
//! and the junction's lanes as further tokens. Both join phases and tokens by multi-head cross-attention with the
//! residual on the phase's side; over the paper's single token the softmax is 1, so queries and keys do not exist there.

use super::layers::{Gru, LayerNorm, Linear, Mlp, Projection};
use crate::batch::{Batch, Inputs};
use crate::features::FeatureSizes;
use crate::params::Init;
use cross_config::{Gfe, ModelConfig};
use tch::{Kind, Tensor};

/// What feature extraction hands on.
#[derive(Debug)]
pub struct GfeOutput {
    /// Phase-aware representation `[rows, hidden]`.
    pub h_sp: Tensor,
    /// Recurrent state after every step `[sequences, steps, hidden]`.
    pub states: Tensor,
}

/// The recurrent path's intermediate results.
pub(super) struct Recurrent {
    /// `h_p` of every row (`movement`) or of every static phase (`paper`).
    phases: Tensor,
    /// `h_s` `[samples, hidden]`.
    h_s: Tensor,
    /// Recurrent state after every step `[sequences, steps, hidden]`.
    pub(super) states: Tensor,
}

#[derive(Debug)]
pub(super) struct GfeNet {
    hidden: i64,
    state: Mlp,
    gru: Gru,
    phase: Mlp,
    value: Linear,
    output: Linear,
    lanes: Option<LaneAttention>,
}

impl GfeNet {
    pub(super) fn new(init: &mut Init<'_>, config: &ModelConfig, sizes: &FeatureSizes) -> Self {
        let hidden = config.hidden;
        let (phase, state_inputs, lanes) = match config.gfe {
            Gfe::Paper => (Mlp::new(&mut init.sub("phase"), sizes.movements, 64, hidden), sizes.state, None),
            Gfe::Movement => (
                Mlp::new(&mut init.sub("phase"), sizes.phase, hidden, hidden),
                2 * hidden,
                Some(LaneAttention::new(&mut init.sub("attention"), config, sizes.lane)),
            ),
        };
        Self {
            hidden,
            state: Mlp::new(&mut init.sub("state"), state_inputs, hidden, hidden),
            gru: Gru::new(&mut init.sub("gru"), hidden),
            phase,
            value: Linear::new(&mut init.sub("value"), hidden, hidden),
            output: Linear::new(&mut init.sub("output"), hidden, hidden),
            lanes,
        }
    }

    pub(super) fn recurrent(&self, batch: &Batch, state: &Tensor) -> Recurrent {
        let (phases, state_input) = match &batch.inputs {
            Inputs::Paper(paper) => (self.phase.forward(&paper.phase_states), paper.states.shallow_clone()),
            Inputs::Movement(movement) => {
                let phases = self.phase.forward(&movement.phases);
                let pooled = batch.map_groups(&phases, |rows| {
                    Tensor::cat(&[rows.mean_dim(1, false, Kind::Float), rows.amax(1, false)], 1)
                });
                (phases, pooled)
            }
        };
        let e = self.state.forward(&state_input);
        let sequences = e.view([batch.sequences, batch.steps, self.hidden]);
        let states = self.gru.forward(&sequences, state);
        let h_s = e + states.reshape([-1, self.hidden]);
        Recurrent { phases, h_s, states }
    }

    pub(super) fn forward(&self, batch: &Batch, state: &Tensor) -> GfeOutput {
        let Recurrent { phases, h_s, states } = self.recurrent(batch, state);
        let value = self.value.forward(&h_s);
        let h_sp = match (&batch.inputs, &self.lanes) {
            (Inputs::Movement(movement), Some(lanes)) => {
                let attended = lanes.forward(batch, movement, &phases, &h_s, &value);
                phases + self.output.forward(&attended)
            }
            (Inputs::Paper(paper), _) => {
                let phases = phases.index_select(0, &paper.phase_of_row);
                phases + batch.repeat_over_phases(&self.output.forward(&value))
            }
            // A movement batch only meets a network built for movements: both come from one configuration.
            (Inputs::Movement(_), None) => phases + batch.repeat_over_phases(&self.output.forward(&value)),
        };
        GfeOutput { h_sp, states }
    }
}

/// Attention from phases to the junction's lanes and its state token.
///
/// Keys and values are linear in a lane's few raw features, so scores and sums are taken in that small space and
/// projected afterwards: the same numbers without a hidden vector per lane.
#[derive(Debug)]
struct LaneAttention {
    heads: i64,
    width: i64,
    norm: LayerNorm,
    query: Linear,
    state_key: Linear,
    lane_key: Projection,
    lane_value: Projection,
    /// `[hidden, heads]`, 1 where a column belongs to a head.
    head_of: Tensor,
}

impl LaneAttention {
    fn new(init: &mut Init<'_>, config: &ModelConfig, lane: i64) -> Self {
        let (hidden, heads) = (config.hidden, config.heads);
        let width = hidden / heads;
        let head_of =
            Tensor::eye(heads, (Kind::Float, init.device())).repeat_interleave_self_int(width, 0, None);
        Self {
            heads,
            width,
            norm: LayerNorm::new(&mut init.sub("norm"), hidden),
            query: Linear::new(&mut init.sub("query"), hidden, hidden),
            state_key: Linear::new(&mut init.sub("state_key"), hidden, hidden),
            lane_key: Projection::new(&mut init.sub("lane_key"), lane, hidden, lane),
            lane_value: Projection::new(&mut init.sub("lane_value"), lane, hidden, lane),
            head_of,
        }
    }

    /// Per-head projection `[hidden, heads * lane]` from `[hidden, lane]`: block-diagonal over the heads.
    fn per_head(&self, weight: &Tensor) -> Tensor {
        (weight.unsqueeze(1) * self.head_of.unsqueeze(2)).view([self.heads * self.width, -1])
    }

    /// Attended values `[rows, hidden]` before the output projection.
    fn forward(
        &self,
        batch: &Batch,
        inputs: &crate::batch::MovementInputs,
        phases: &Tensor,
        h_s: &Tensor,
        state_value: &Tensor,
    ) -> Tensor {
        let (heads, width, hidden) = (self.heads, self.width, self.heads * self.width);
        let query = self.query.forward(&self.norm.forward(phases)) / (width as f64).sqrt();
        let state_key = self.state_key.forward(h_s);
        let key = self.per_head(self.lane_key.weight());
        let value = self.per_head(self.lane_value.weight()).transpose(0, 1);
        let parts: Vec<Tensor> = batch
            .groups
            .iter()
            .zip(&inputs.lanes)
            .map(|(group, lanes)| {
                let (n, p) = (group.samples, group.phases);
                let query = query.narrow(0, group.first_row, n * p);
                let lane_count = lanes.features.size()[1];
                let features = lanes.features.size()[2];
                let lane_scores =
                    query.matmul(&key).view([n, p * heads, features]).bmm(&lanes.features.transpose(1, 2))
                        + lanes.mask.unsqueeze(1);
                let query = query.view([n, p, heads, width]);
                let own = state_key.narrow(0, group.first_sample, n).view([n, 1, heads, width]);
                let state_scores =
                    (query * own).sum_dim_intlist(-1, false, Kind::Float).view([n, p * heads, 1]);
                let weights = Tensor::cat(&[lane_scores, state_scores], 2).softmax(-1, Kind::Float);
                let from_lanes = weights
                    .narrow(2, 0, lane_count)
                    .bmm(&lanes.features)
                    .view([n * p, heads * features])
                    .matmul(&value);
                let own = state_value.narrow(0, group.first_sample, n).view([n, 1, heads, width]);
                let from_state = weights.narrow(2, lane_count, 1).view([n, p, heads, 1]) * own;
                from_lanes + from_state.reshape([n * p, hidden])
            })
            .collect();
        Tensor::cat(&parts, 0)
    }
}
