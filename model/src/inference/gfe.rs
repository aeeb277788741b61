//! General feature extraction for one observation; the same as the training's `net::gfe`.

use super::lanes::LaneAttention;
use super::weights::Weights;
use crate::error::ModelError;
use crate::features::{NetworkSpec, Track};
use crate::vector::math::{sigmoid, tanh};
use crate::vector::{Dense, Isa, Matrix, Mlp, Work};
use cross_config::{Gfe, ModelConfig};

/// The path that carries the recurrent state: all that acting needs of the critic.
#[derive(Debug)]
pub(super) struct Recurrent {
    hidden: usize,
    gfe: Gfe,
    phase: Mlp,
    state: Mlp,
    gru: Gru,
}

/// Results of [`Recurrent::advance`], and its buffers.
#[derive(Debug, Default)]
pub(super) struct RecurrentWork {
    /// `movement`: `h_p` of every phase `[rows, hidden]`.
    pub(super) phases: Vec<f32>,
    /// `h_s` of every agent `[agents, hidden]`.
    pub(super) h_s: Vec<f32>,
    inner: Vec<f32>,
    pooled: Vec<f32>,
    from_input: Vec<f32>,
    from_state: Vec<f32>,
}

impl Recurrent {
    pub(super) fn new(isa: Isa, weights: &Weights<'_>, config: &ModelConfig) -> Result<Self, ModelError> {
        Ok(Self {
            hidden: config.hidden as usize,
            gfe: config.gfe,
            phase: mlp(isa, &weights.sub("phase"))?,
            state: mlp(isa, &weights.sub("state"))?,
            gru: Gru::new(isa, &weights.sub("gru"))?,
        })
    }

    /// Takes the recurrent state `[agents, hidden]` one observation on.
    pub(super) fn advance(
        &self,
        network: &NetworkSpec,
        seen: &Track,
        state: &mut [f32],
        work: &mut RecurrentWork,
    ) {
        match self.gfe {
            Gfe::Paper => self.state.forward(&seen.states, &mut work.inner, &mut work.h_s),
            Gfe::Movement => {
                self.phase.forward(&seen.phases, &mut work.inner, &mut work.phases);
                pool(network, &work.phases, self.hidden, &mut work.pooled);
                self.state.forward(&work.pooled, &mut work.inner, &mut work.h_s);
            }
        }
        self.gru.advance(&work.h_s, state, &mut work.from_input, &mut work.from_state);
        for (h_s, state) in work.h_s.iter_mut().zip(state) {
            *h_s += *state;
        }
    }

    /// `paper`: `h_p` of every phase `[rows, hidden]`, which no observation changes.
    fn constant_phases(&self, network: &NetworkSpec) -> Vec<f32> {
        let (mut inner, mut phases) = (Vec::new(), Vec::new());
        self.phase.forward(&network.phase_states(), &mut inner, &mut phases);
        phases
    }
}

/// Mean and maximum of each agent's phases `[agents, 2 * hidden]`.
fn pool(network: &NetworkSpec, phases: &[f32], hidden: usize, out: &mut Vec<f32>) {
    out.clear();
    let mut rest = phases;
    for agent in &network.agents {
        let (own, others) = rest.split_at(agent.phases * hidden);
        rest = others;
        let at = out.len();
        out.resize(at + hidden, 0.0);
        out.resize(at + 2 * hidden, f32::NEG_INFINITY);
        let (mean, most) = out[at..].split_at_mut(hidden);
        for row in own.chunks_exact(hidden) {
            for ((mean, most), &value) in mean.iter_mut().zip(most.iter_mut()).zip(row) {
                *mean += value;
                *most = if value > *most { value } else { *most };
            }
        }
        let scale = 1.0 / agent.phases as f32;
        mean.iter_mut().for_each(|value| *value *= scale);
    }
}

/// Phases joined with the state: the whole of feature extraction.
#[derive(Debug)]
pub(super) struct Features {
    recurrent: Recurrent,
    join: Join,
}

#[derive(Debug)]
enum Join {
    /// `paper`: over a single token the attention's weight is 1, which leaves a linear layer of the state.
    State(Dense),
    /// `movement`.
    Lanes(Box<LaneAttention>),
}

/// Buffers of [`Features::forward`].
#[derive(Debug, Default)]
pub(super) struct FeaturesWork {
    recurrent: RecurrentWork,
    lanes: super::lanes::LanesWork,
    joined: Vec<f32>,
}

impl Features {
    pub(super) fn new(
        isa: Isa,
        weights: &Weights<'_>,
        config: &ModelConfig,
        lane: usize,
    ) -> Result<Self, ModelError> {
        let join = match config.gfe {
            Gfe::Paper => {
                let ((value, value_bias), (output, bias)) =
                    (weights.linear("value")?, weights.linear("output")?);
                Join::State(Dense::new(isa, &output.times(&value), Some(&output.apply(&value_bias, &bias))))
            }
            Gfe::Movement => Join::Lanes(Box::new(LaneAttention::new(isa, weights, config, lane)?)),
        };
        Ok(Self { recurrent: Recurrent::new(isa, weights, config)?, join })
    }

    /// What no observation on this network changes: `h_p` of the `paper` form.
    pub(super) fn constant(&self, network: &NetworkSpec) -> Vec<f32> {
        match self.join {
            Join::State(_) => self.recurrent.constant_phases(network),
            Join::Lanes(_) => Vec::new(),
        }
    }

    /// Takes the recurrent state one observation on and writes `h_sp` of every phase `[rows, hidden]`.
    pub(super) fn forward(
        &self,
        network: &NetworkSpec,
        constant: &[f32],
        seen: &Track,
        state: &mut [f32],
        work: &mut FeaturesWork,
        h_sp: &mut Vec<f32>,
    ) {
        self.recurrent.advance(network, seen, state, &mut work.recurrent);
        let RecurrentWork { phases, h_s, .. } = &work.recurrent;
        h_sp.clear();
        match &self.join {
            Join::State(join) => {
                join.forward(h_s, &mut work.joined);
                h_sp.extend_from_slice(constant);
                let mut rows = h_sp.chunks_exact_mut(join.outputs());
                for (agent, joined) in network.agents.iter().zip(work.joined.chunks_exact(join.outputs())) {
                    for row in rows.by_ref().take(agent.phases) {
                        add(row, joined);
                    }
                }
            }
            Join::Lanes(join) => {
                join.forward(network, &seen.lanes, phases, h_s, &mut work.lanes, &mut work.joined);
                h_sp.extend_from_slice(phases);
                add(h_sp, &work.joined);
            }
        }
    }
}

fn add(to: &mut [f32], values: &[f32]) {
    for (to, value) in to.iter_mut().zip(values) {
        *to += value;
    }
}

/// One layer of gated recurrent units.
#[derive(Debug)]
struct Gru {
    isa: Isa,
    input: Dense,
    state: Dense,
}

impl Gru {
    fn new(isa: Isa, weights: &Weights<'_>) -> Result<Self, ModelError> {
        let layer = |weight: &str, bias: &str| -> Result<Dense, ModelError> {
            Ok(Dense::new(isa, &weights.matrix(weight)?, Some(&weights.vector(bias)?)))
        };
        Ok(Self { isa, input: layer("weight_ih", "bias_ih")?, state: layer("weight_hh", "bias_hh")? })
    }

    fn advance(&self, x: &[f32], state: &mut [f32], from_input: &mut Vec<f32>, from_state: &mut Vec<f32>) {
        self.input.forward(x, from_input);
        self.state.forward(state, from_state);
        self.isa.run(Gates { hidden: self.input.outputs() / 3, from_input, from_state, state });
    }
}

/// The gates of every agent, in PyTorch's order: reset, update, new.
struct Gates<'a> {
    hidden: usize,
    from_input: &'a [f32],
    from_state: &'a [f32],
    state: &'a mut [f32],
}

impl Work for Gates<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let hidden = self.hidden;
        let parts = self.from_input.chunks_exact(3 * hidden).zip(self.from_state.chunks_exact(3 * hidden));
        for (state, (x, h)) in self.state.chunks_exact_mut(hidden).zip(parts) {
            let (x, h) = (thirds(x), thirds(h));
            for i in 0..hidden {
                let reset = sigmoid::<FUSED>(x[0][i] + h[0][i]);
                let update = sigmoid::<FUSED>(x[1][i] + h[1][i]);
                let new = tanh::<FUSED>(x[2][i] + reset * h[2][i]);
                state[i] = new + update * (state[i] - new);
            }
        }
    }
}

#[inline(always)]
fn thirds(x: &[f32]) -> [&[f32]; 3] {
    let third = x.len() / 3;
    [&x[..third], &x[third..2 * third], &x[2 * third..]]
}

/// The layers `0` and `1` below a name.
pub(super) fn mlp(isa: Isa, weights: &Weights<'_>) -> Result<Mlp, ModelError> {
    let layer = |name: &str| -> Result<Dense, ModelError> {
        let (weight, bias): (Matrix, Vec<f32>) = weights.linear(name)?;
        Ok(Dense::new(isa, &weight, Some(&bias)))
    };
    Ok(Mlp { first: layer("0")?, second: layer("1")? })
}
