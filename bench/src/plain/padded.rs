//! A minibatch with every intersection padded to the most phases, movements and lanes.

use cross_config::EnvConfig;
use cross_model::batch::{Batch, Inputs};
use cross_model::losses::Targets;
use cross_model::rounds::Minibatch;
use tch::{Kind, Tensor};

/// A minibatch of `B` sequences of `L` steps, in the packed one's order of sequences.
#[derive(Debug)]
pub struct PaddedMinibatch {
    /// Sequences.
    pub sequences: i64,
    /// Steps of each.
    pub steps: i64,
    /// Phases that all are padded to.
    pub phases: i64,
    /// True where a phase is real `[B, L, P]`.
    pub phase_mask: Tensor,
    /// Topology `[B, L, topology]`.
    pub topology: Tensor,
    /// By form.
    pub inputs: PaddedInputs,
    /// Chosen phases `[B, L]`.
    pub actions: Tensor,
    /// Behaviour log-probabilities `[B, L]`.
    pub log_probs: Tensor,
    /// Advantages `[B, L]`.
    pub advantages: Tensor,
    /// Value targets `[B, L]`.
    pub returns: Tensor,
    /// What prediction should meet `[B, L, target]`.
    pub next: Tensor,
    /// 1 where the next step exists `[B, L]`.
    pub has_next: Tensor,
    /// Recurrent state of the actor network at the start `[B, hidden]`.
    pub actor_state: Tensor,
    /// The same for the critic.
    pub critic_state: Tensor,
}

/// Network inputs by form.
#[derive(Debug)]
pub enum PaddedInputs {
    /// Flattened movements.
    Paper {
        /// `[B, L, M * 5]`.
        states: Tensor,
        /// Green masks `[B, L, P, M]`: the same at every step.
        greens: Tensor,
        /// 1 where a state entry is real `[B, L, M * 5]`.
        real: Tensor,
    },
    /// Sums per phase.
    Movement {
        /// `[B, L, P, phase]`.
        phases: Tensor,
        /// Mean and maximum over the phases `[B, L, 2 * phase]`.
        context: Tensor,
        /// Lane tokens `[B, L, lanes, lane]`.
        lanes: Tensor,
        /// True where a lane is real `[B, L, lanes]`.
        lane_mask: Tensor,
    },
}

impl PaddedMinibatch {
    /// Pads a packed minibatch.
    #[must_use]
    pub fn new(packed: &Minibatch, env: &EnvConfig) -> Self {
        let Minibatch { batch, targets, actor_state, critic_state, .. } = packed;
        let (b, l, p) = (batch.sequences, batch.steps, env.max_phases as i64);
        let by_step = |x: &Tensor| x.view([b, l]);
        let wide = |x: &Tensor| x.view([b, l, -1]);
        let ones = Tensor::ones([batch.rows, 1], (Kind::Float, batch.topology.device()));
        let phase_mask = pad_rows(batch, &ones, p).view([b, l, p]).gt(0.5);
        let inputs = match &batch.inputs {
            Inputs::Paper(paper) => PaddedInputs::Paper {
                states: wide(&paper.states),
                greens: pad_rows(batch, &paper.phase_states.index_select(0, &paper.phase_of_row), p)
                    .view([b, l, p, -1]),
                real: wide(&paper.real),
            },
            Inputs::Movement(movement) => {
                let most = movement.lanes.iter().map(|lanes| lanes.features.size()[1]).max().unwrap_or(0);
                let join = |parts: Vec<Tensor>| Tensor::cat(&parts, 0);
                let missing = |tensor: &Tensor| most - tensor.size()[1];
                let lanes = movement
                    .lanes
                    .iter()
                    .map(|lanes| lanes.features.constant_pad_nd([0, 0, 0, missing(&lanes.features)]));
                let masks = movement.lanes.iter().map(|lanes| {
                    lanes.mask.isfinite().to_kind(Kind::Float).constant_pad_nd([0, missing(&lanes.mask)])
                });
                PaddedInputs::Movement {
                    phases: pad_rows(batch, &movement.phases, p).view([b, l, p, -1]),
                    context: wide(&movement.context),
                    lanes: join(lanes.collect()).view([b, l, most, -1]),
                    lane_mask: join(masks.collect()).view([b, l, most]).gt(0.5),
                }
            }
        };
        let Targets { chosen_rows, log_probs, advantages, returns, next, has_next } = targets;
        Self {
            sequences: b,
            steps: l,
            phases: p,
            phase_mask,
            topology: wide(&batch.repeat_over_steps(&batch.topology)),
            inputs,
            actions: by_step(&actions(batch, chosen_rows)),
            log_probs: by_step(log_probs),
            advantages: by_step(advantages),
            returns: by_step(returns),
            next: wide(next),
            has_next: by_step(has_next),
            actor_state: actor_state.shallow_clone(),
            critic_state: critic_state.shallow_clone(),
        }
    }
}

/// Packed rows `[rows, w]` as `[samples, phases, w]`, zero where padded.
fn pad_rows(batch: &Batch, rows: &Tensor, phases: i64) -> Tensor {
    batch.map_groups(rows, |own| own.constant_pad_nd([0, 0, 0, phases - own.size()[1]]))
}

/// The phase of every sample from its row.
fn actions(batch: &Batch, chosen_rows: &Tensor) -> Tensor {
    let parts: Vec<Tensor> = batch
        .groups
        .iter()
        .map(|group| {
            let own = chosen_rows.narrow(0, group.first_sample, group.samples) - group.first_row;
            own.remainder(group.phases)
        })
        .collect();
    Tensor::cat(&parts, 0)
}
