//! Attention from phases to the junction's lanes and its state token (form `movement`; paper, section IV-A).
//!
//! Everything around the softmax is linear, and a junction has few lanes with few numbers each, so the wide vectors per row
//! (queries, attended values, their projection) never exist: keys, values and the projections on both ends are multiplied
//! together first, per lane feature and head, or per sample for the state token. The results are the same.

use super::join;
use super::layers::{LayerNorm, Linear, Projection};
use crate::batch::{Batch, Lanes, MovementInputs};
use crate::params::Init;
use cross_config::ModelConfig;
use tch::{Kind, Tensor};

#[derive(Debug)]
pub(super) struct LaneAttention {
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
    pub(super) fn new(init: &mut Init<'_>, config: &ModelConfig, lane: i64) -> Self {
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

    /// Phase features with what they attend to, projected by `value` and `output`, added: `h_sp` `[rows, hidden]`.
    pub(super) fn forward(
        &self,
        batch: &Batch,
        inputs: &MovementInputs,
        phases: &Tensor,
        h_s: &Tensor,
        value: &Linear,
        output: &Linear,
    ) -> Tensor {
        let (heads, width, hidden) = (self.heads, self.width, self.heads * self.width);
        let lane = self.lane_key.weight().size()[1];
        let scale = 1.0 / (width as f64).sqrt();
        let normed = self.norm.forward(phases);

        // Query times key, from the normed phase to every head's lane features.
        let key = self.per_head(self.lane_key.weight()).transpose(0, 1) * scale;
        let to_lanes = self.query.under(&key);
        // And to every head's score with the state token.
        let own = self.state_key.forward(h_s).view([-1, heads, width]) * scale;
        let (query, query_bias) = (self.query.weight(), self.query.bias().view([1, heads, width]));
        let to_state = own.transpose(0, 1).bmm(&query.view([heads, width, hidden])).transpose(0, 1);
        let state_bias = (&own * query_bias).sum_dim_intlist(-1, false, Kind::Float).unsqueeze(1);
        // Values and the projection behind them likewise.
        let from_lanes = output.after_product(&self.per_head(self.lane_value.weight()));
        let own = value.forward(h_s).view([-1, heads, width]).transpose(0, 1);
        let per_head = output.weight().view([hidden, heads, width]).permute([1, 2, 0]);
        let from_state = own.bmm(&per_head).transpose(0, 1);

        let (rows, samples) = (batch.group_rows(), batch.group_samples());
        let by_rows = |x: &Tensor| x.split_with_sizes(rows.as_slice(), 0);
        let by_samples = |x: &Tensor| x.split_with_sizes(samples.as_slice(), 0);
        let (lane_queries, phases, normed) =
            (by_rows(&to_lanes.forward(&normed)), by_rows(phases), by_rows(&normed));
        let (to_state, state_bias, from_state) =
            (by_samples(&to_state), by_samples(&state_bias), by_samples(&from_state));
        let parts = batch.groups.iter().zip(&inputs.lanes).enumerate().map(|(i, (group, lanes))| {
            let (n, p) = (group.samples, group.phases);
            let tokens = tokens(lanes);
            let state_scores =
                state_bias[i].baddbmm(&normed[i].view([n, p, hidden]), &to_state[i].transpose(1, 2), 1, 1);
            let queries = Tensor::cat(
                &[lane_queries[i].view([n, p, heads, lane]), state_scores.view([n, p, heads, 1])],
                3,
            );
            let mut scores = queries.view([n, p * heads, lane + 1]).bmm(&tokens.transpose(1, 2));
            if lanes.padded {
                let _ = scores.g_add_(&lanes.mask.constant_pad_nd([0, 1]).unsqueeze(1));
            }
            let sums = scores.softmax(-1, Kind::Float).bmm(&tokens).view([n * p, heads, lane + 1]);
            let sums = sums.split_with_sizes([lane, 1].as_slice(), 2);
            let state = sums[1].reshape([n, p, heads]).bmm(&from_state[i]);
            // In place: nothing going backward needs the sum's parts.
            let mut out = from_lanes.forward(&sums[0].reshape([n * p, heads * lane]));
            let _ = out.g_add_(&state.view([n * p, hidden]));
            out.g_add_(&phases[i])
        });
        join(parts.collect())
    }
}

/// Lanes and the state token `[samples, lanes + 1, lane + 1]`: the state token is 1 in a feature of its own, so that one
/// product gives the scores of all tokens, and one more the sums over lanes and the state token's weight.
fn tokens(lanes: &Lanes) -> Tensor {
    let size = lanes.features.size();
    let tokens = lanes.features.constant_pad_nd([0, 1, 0, 1]);
    let _ = tokens.select(1, size[1]).select(1, size[2]).fill_(1.0);
    tokens
}
