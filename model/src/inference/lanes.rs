//! Attention from an agent's phases to its lanes and its state, for one observation; the same as the training's `net::gfe`.
//!
//! A lane has few features, so that scores and sums are taken over these and projected afterwards.

use super::norm::Norm;
use super::weights::Weights;
use crate::error::ModelError;
use crate::features::{AgentSpec, NetworkSpec};
use crate::vector::math::{dot, fma, softmax};
use crate::vector::{Dense, Isa, Matrix, Work};
use cross_config::ModelConfig;

/// Tokens of an agent are padded to a multiple of this, for the processor's sake.
const TOKENS: usize = 16;

#[derive(Debug)]
pub(super) struct LaneAttention {
    isa: Isa,
    shape: Shape,
    norm: Norm,
    /// From a phase to its query for the state's key `[hidden]`, and to its query for lane features `[heads * lane]`.
    query: Dense,
    /// From `h_s` to the state's key and value `[2 * hidden]`.
    state: Dense,
    /// From summed lane features `[heads * lane]` to values.
    lane_value: Dense,
    output: Dense,
}

#[derive(Debug, Clone, Copy)]
struct Shape {
    hidden: usize,
    heads: usize,
    /// Features of a lane.
    lane: usize,
}

/// Buffers of [`LaneAttention::forward`].
#[derive(Debug, Default)]
pub(super) struct LanesWork {
    normed: Vec<f32>,
    query: Vec<f32>,
    state: Vec<f32>,
    summed: Vec<f32>,
    on_state: Vec<f32>,
    tokens: Vec<f32>,
    scores: Vec<f32>,
    attended: Vec<f32>,
}

impl LaneAttention {
    pub(super) fn new(
        isa: Isa,
        weights: &Weights<'_>,
        config: &ModelConfig,
        lane: usize,
    ) -> Result<Self, ModelError> {
        let shape = Shape { hidden: config.hidden as usize, heads: config.heads as usize, lane };
        let attention = weights.sub("attention");
        let (query, query_bias) = attention.linear("query")?;
        // The scores' scale is in the queries; keys of lanes are in the queries for them.
        let scale = 1.0 / ((shape.hidden / shape.heads) as f64).sqrt();
        let query = query.scaled(scale);
        let query_bias: Vec<f32> = query_bias.iter().map(|&v| (f64::from(v) * scale) as f32).collect();
        let lane_key = shape.per_head(&attention.sub("lane_key").matrix("weight")?).transposed();
        let none = vec![0.0; lane_key.rows];
        let for_lanes = (lane_key.times(&query), lane_key.apply(&query_bias, &none));
        let biases = [query_bias, for_lanes.1].concat();
        let query = Dense::new(isa, &query.above(&for_lanes.0), Some(&biases));

        let ((key, key_bias), (value, value_bias)) =
            (attention.linear("state_key")?, weights.linear("value")?);
        let lane_value = shape.per_head(&attention.sub("lane_value").matrix("weight")?);
        let (output, bias) = weights.linear("output")?;
        Ok(Self {
            isa,
            shape,
            norm: Norm::new(isa, &attention.sub("norm"))?,
            query,
            state: Dense::new(isa, &key.above(&value), Some(&[key_bias, value_bias].concat())),
            lane_value: Dense::new(isa, &lane_value, None),
            output: Dense::new(isa, &output, Some(&bias)),
        })
    }

    /// What attention adds to `phases` `[rows, hidden]`, given the lanes' features `[lane rows, lane]` and `h_s`
    /// `[agents, hidden]`, into `out` `[rows, hidden]`.
    pub(super) fn forward(
        &self,
        network: &NetworkSpec,
        lanes: &[f32],
        phases: &[f32],
        h_s: &[f32],
        work: &mut LanesWork,
        out: &mut Vec<f32>,
    ) {
        let Shape { hidden, heads, lane } = self.shape;
        let rows = phases.len() / hidden;
        self.norm.forward(phases, &mut work.normed);
        self.query.forward(&work.normed, &mut work.query);
        self.state.forward(h_s, &mut work.state);
        work.summed.resize(rows * heads * lane, 0.0);
        work.on_state.resize(rows * heads, 0.0);
        self.isa.run(Attend {
            shape: self.shape,
            agents: &network.agents,
            lanes,
            query: &work.query,
            state: &work.state,
            tokens: &mut work.tokens,
            scores: &mut work.scores,
            summed: &mut work.summed,
            on_state: &mut work.on_state,
        });
        self.lane_value.forward(&work.summed, &mut work.attended);
        let mut attended = work.attended.chunks_exact_mut(hidden / heads);
        let mut on_state = work.on_state.iter();
        for (agent, state) in network.agents.iter().zip(work.state.chunks_exact(2 * hidden)) {
            for _ in 0..agent.phases {
                for value in state[hidden..].chunks_exact(hidden / heads) {
                    let (Some(attended), Some(&weight)) = (attended.next(), on_state.next()) else { return };
                    for (attended, value) in attended.iter_mut().zip(value) {
                        *attended += weight * value;
                    }
                }
            }
        }
        self.output.forward(&work.attended, out);
    }
}

impl Shape {
    /// `[hidden, lane]` to `[hidden, heads * lane]`: block-diagonal over the heads.
    fn per_head(self, weight: &Matrix) -> Matrix {
        let mut values = vec![0.0; self.hidden * self.heads * self.lane];
        for row in 0..self.hidden {
            let head = row / (self.hidden / self.heads);
            let at = (row * self.heads + head) * self.lane;
            values[at..at + self.lane].copy_from_slice(weight.row(row));
        }
        Matrix::new(self.hidden, self.heads * self.lane, values)
    }
}

/// Weights of every phase's heads over lanes and state, and the lanes' features summed by them.
struct Attend<'a> {
    shape: Shape,
    agents: &'a [AgentSpec],
    /// `[lane rows, lane]`.
    lanes: &'a [f32],
    /// `[rows, hidden + heads * lane]`.
    query: &'a [f32],
    /// `[agents, 2 * hidden]`.
    state: &'a [f32],
    tokens: &'a mut Vec<f32>,
    scores: &'a mut Vec<f32>,
    /// `[rows, heads * lane]`.
    summed: &'a mut [f32],
    /// Weight of the state `[rows, heads]`.
    on_state: &'a mut [f32],
}

impl Work for Attend<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Shape { hidden, heads, lane } = self.shape;
        let width = hidden / heads;
        let mut lanes = self.lanes;
        let mut rows = self
            .query
            .chunks_exact(hidden + heads * lane)
            .zip(self.summed.chunks_exact_mut(heads * lane))
            .zip(self.on_state.chunks_exact_mut(heads));
        for (agent, state) in self.agents.iter().zip(self.state.chunks_exact(2 * hidden)) {
            let (own, others) = lanes.split_at(agent.lanes * lane);
            lanes = others;
            // Feature-major; after the lanes the state, which has none, and padding.
            let padded = (agent.lanes + 1).next_multiple_of(TOKENS);
            self.tokens.clear();
            self.tokens.resize(lane * padded, 0.0);
            for (token, features) in own.chunks_exact(lane).enumerate() {
                for (feature, &value) in features.iter().enumerate() {
                    self.tokens[feature * padded + token] = value;
                }
            }
            self.scores.resize(padded, 0.0);
            let scores = &mut self.scores[..padded];
            for ((query, summed), on_state) in rows.by_ref().take(agent.phases) {
                let (for_state, for_lanes) = query.split_at(hidden);
                let keys = for_state.chunks_exact(width).zip(state.chunks_exact(width));
                let heads = for_lanes.chunks_exact(lane).zip(keys).zip(summed.chunks_exact_mut(lane));
                for (((query, (for_state, key)), summed), on_state) in heads.zip(on_state) {
                    scores.fill(0.0);
                    for (&query, features) in query.iter().zip(self.tokens.chunks_exact(padded)) {
                        for (score, &feature) in scores.iter_mut().zip(features) {
                            *score = fma::<FUSED>(query, feature, *score);
                        }
                    }
                    scores[agent.lanes] = dot::<FUSED>(for_state, key);
                    scores[agent.lanes + 1..].fill(f32::NEG_INFINITY);
                    softmax::<FUSED>(scores);
                    for (sum, features) in summed.iter_mut().zip(self.tokens.chunks_exact(padded)) {
                        *sum = dot::<FUSED>(scores, features);
                    }
                    *on_state = scores[agent.lanes];
                }
            }
        }
    }
}
