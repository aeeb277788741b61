//! General feature extraction (paper, section IV-A), in two forms.
//!
//! `paper`: one state token from all movements in link order, phases from their green masks.
//!
//! `movement`: phases from the summed counts of their green lanes, one state token from the phases' mean and maximum,
//! and the junction's lanes as further tokens. Both join phases and tokens by multi-head cross-attention with the
//! residual on the phase's side; over the paper's single token the softmax is 1, so queries and keys do not exist there.

use super::gru::Gru;
use super::join;
use super::lanes::LaneAttention;
use super::layers::{Linear, Mlp};
use super::tape::Tape;
use crate::batch::{Batch, Inputs};
use crate::features::FeatureSizes;
use crate::params::Init;
use cross_config::{Gfe, ModelConfig};
use tch::{Kind, Tensor};

/// What feature extraction hands on.
#[derive(Debug)]
pub(super) struct GfeOutput {
    /// Phase-aware representation `h_sp`.
    pub(super) h_sp: PhaseFeatures,
    /// Recurrent state after every step `[sequences, steps, hidden]`.
    pub(super) states: Tensor,
}

/// `h_sp` of every packed row.
///
/// In the form `paper` it is the sum of what a phase is, the same at every step, and of what its sample's state is. A linear
/// layer on it is then the sum of the layer on either, of which there are several times fewer than rows.
#[derive(Debug)]
pub(super) enum PhaseFeatures {
    /// `[rows, hidden]`.
    Rows(Tensor),
    /// Of phases `[static phases, hidden]` and of samples `[samples, hidden]`, and the static phase of every row `[rows]`.
    Sum(Tensor, Tensor, Tensor),
}

impl PhaseFeatures {
    /// All rows `[rows, hidden]`.
    pub(super) fn rows(&self, batch: &Batch) -> Tensor {
        match self {
            Self::Rows(rows) => rows.shallow_clone(),
            Self::Sum(phases, samples, _) => add_per_phase(batch, phases, samples),
        }
    }

    /// A linear layer on all rows.
    pub(super) fn project(&self, batch: &Batch, layer: &Linear) -> Tensor {
        match self {
            Self::Rows(rows) => layer.forward(rows),
            Self::Sum(phases, samples, _) => {
                add_per_phase(batch, &layer.forward(phases), &layer.without_bias().forward(samples))
            }
        }
    }
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

    pub(super) fn recurrent(&self, batch: &Batch, state: &Tensor, tape: &mut Tape) -> Recurrent {
        let (phases, e) = match &batch.inputs {
            Inputs::Paper(paper) => {
                let (first, own) = (self.state.first(), batch.real_columns(&paper.states));
                let groups = batch.groups.iter().zip(&own);
                let hidden = groups.map(|(group, own)| first.first_columns(group.columns).forward(own));
                let e = self.state.second().forward(&join(hidden.collect()).relu_());
                (self.phase.forward(&paper.phase_states), e)
            }
            Inputs::Movement(movement) => {
                // Phases lead on both through the state that is made of them and by themselves.
                let [phases] = tape.cut([&self.phase.forward(&movement.phases)]);
                // Split and not narrowed: going backward, every narrowing fills a tensor as large as the whole.
                let groups = batch.groups.iter().zip(phases.split_with_sizes(batch.group_rows(), 0));
                let pooled = groups.map(|(group, own)| {
                    let own = own.view([group.samples, group.phases, self.hidden]);
                    Tensor::cat(&[own.mean_dim(1, false, Kind::Float), own.amax(1, false)], 1)
                });
                let e = self.state.forward(&join(pooled.collect()));
                (phases, e)
            }
        };
        let sequences = e.view([batch.sequences, batch.steps, self.hidden]);
        let (input, states) = self.gru.forward(&sequences, state, tape);
        let h_s = (input + &states).view([-1, self.hidden]);
        Recurrent { phases, h_s, states }
    }

    pub(super) fn forward(&self, batch: &Batch, state: &Tensor, tape: &mut Tape) -> GfeOutput {
        let Recurrent { phases, h_s, states } = self.recurrent(batch, state, tape);
        let h_sp = match &batch.inputs {
            Inputs::Movement(movement) => {
                // Both come from one configuration; without the lanes, the phases would lose the state in silence.
                let lanes = self.lanes.as_ref().expect("a network that is fed movements was built for them");
                let attended = lanes.forward(batch, movement, &phases, &h_s, &self.value, &self.output);
                PhaseFeatures::Rows(attended)
            }
            // Over the state token alone, attention is two linear layers, one after the other.
            Inputs::Paper(paper) => {
                let samples = self.output.after(&self.value).forward(&h_s);
                // The router and the experts' own way back both lead here.
                let [phases, samples] = tape.cut([&phases, &samples]);
                PhaseFeatures::Sum(phases, samples, paper.phase_of_row.shallow_clone())
            }
        };
        GfeOutput { h_sp, states }
    }
}

/// Adds each sample's vector `[samples, w]` to its phases', which are the same at every step `[static phases, w]`; `[rows, w]`.
fn add_per_phase(batch: &Batch, phases: &Tensor, samples: &Tensor) -> Tensor {
    let width = samples.size()[1];
    let phases = phases.split_with_sizes(batch.group_static_phases(), 0);
    let samples = samples.split_with_sizes(batch.group_samples(), 0);
    let groups = batch.groups.iter().zip(phases).zip(samples);
    join(
        groups
            .map(|((group, phases), samples)| {
                let sequences = group.samples / batch.steps;
                let phases = phases.view([sequences, 1, group.phases, width]);
                let samples = samples.view([sequences, batch.steps, 1, width]);
                (phases + samples).view([group.samples * group.phases, width])
            })
            .collect(),
    )
}
