//! Acting: a snapshot's networks on one network of streets, with their recurrent state.

use crate::batch::{Batch, Sequence};
use crate::error::ModelError;
use crate::features::{FeatureSizes, NetworkSpec, Track};
use crate::net::{Net, Role};
use crate::snapshot::{self, PolicyMetadata};
use cross_config::{EnvConfig, ModelConfig};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::{Observation, RecurrentState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor};

/// How phases are picked from their probabilities.
pub enum ActMode<'a> {
    /// At random, by their probability.
    Sample(&'a mut ChaCha8Rng),
    /// The most probable; the lowest index of equals.
    Greedy,
}

/// What the policy chose for every agent.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Decision {
    /// Phase index of each agent `[agents]`.
    pub actions: Vec<u8>,
    /// Log-probabilities of these `[agents]`.
    pub log_probs: Vec<f32>,
}

/// A policy ready to act. Owned by one thread.
#[derive(Debug)]
pub struct Policy {
    metadata: PolicyMetadata,
    sizes: FeatureSizes,
    actor: Net,
    critic: Net,
    network: Option<NetworkSpec>,
    actor_state: Tensor,
    critic_state: Tensor,
}

impl Policy {
    /// Builds the networks that a snapshot describes and loads its weights.
    ///
    /// # Errors
    /// [`ModelError`] if the bytes are damaged, foreign or do not fit their own description.
    pub fn from_snapshot(bytes: &[u8]) -> Result<Self, ModelError> {
        let metadata = snapshot::read_metadata(bytes)?;
        let sizes = FeatureSizes::new(&metadata.env, &metadata.model);
        // The weights are overwritten at once, so the seed does not matter.
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let actor = Net::new(Role::Actor, &metadata.model, &sizes, &mut rng);
        let critic = Net::new(Role::Critic, &metadata.model, &sizes, &mut rng);
        snapshot::load_weights(bytes, &actor, &critic)?;
        let empty = || Tensor::zeros([0, metadata.model.hidden], (Kind::Float, Device::Cpu));
        let (actor_state, critic_state) = (empty(), empty());
        Ok(Self { metadata, sizes, actor, critic, network: None, actor_state, critic_state })
    }

    /// Version of the weights.
    #[must_use]
    pub fn version(&self) -> u64 {
        self.metadata.policy_version
    }

    /// Network configuration.
    #[must_use]
    pub fn config(&self) -> &ModelConfig {
        &self.metadata.model
    }

    /// Environment that it was trained for.
    #[must_use]
    pub fn env(&self) -> &EnvConfig {
        &self.metadata.env
    }

    /// Starts an episode on a network: recurrent state zero.
    ///
    /// # Errors
    /// [`ModelError::TooLarge`] if an intersection exceeds the model's limits.
    pub fn begin_episode(&mut self, layout: &NetworkLayout) -> Result<(), ModelError> {
        let network = NetworkSpec::new(layout, &self.metadata.env, &self.metadata.model)?;
        let zeros = || {
            Tensor::zeros(
                [network.agents.len() as i64, self.metadata.model.hidden],
                (Kind::Float, Device::Cpu),
            )
        };
        (self.actor_state, self.critic_state) = (zeros(), zeros());
        self.network = Some(network);
        Ok(())
    }

    /// Takes newer weights of the same configuration; the recurrent state stays.
    ///
    /// # Errors
    /// [`ModelError`] if the bytes are damaged, foreign or of another configuration; the old weights then remain.
    pub fn replace_weights(&mut self, bytes: &[u8]) -> Result<(), ModelError> {
        let mut other = Self::from_snapshot(bytes)?;
        if other.metadata.model != self.metadata.model || other.metadata.env != self.metadata.env {
            return Err(ModelError::Mismatch {
                what: "policy",
                reason: "its env or model configuration differs from the one in use".to_owned(),
            });
        }
        std::mem::swap(&mut self.actor, &mut other.actor);
        std::mem::swap(&mut self.critic, &mut other.critic);
        self.metadata = other.metadata;
        Ok(())
    }

    /// Chooses a phase for every agent and advances the recurrent state.
    ///
    /// # Errors
    /// [`ModelError::Shape`] if the observation is not of the network that [`Policy::begin_episode`] named, or holds a
    /// phase that an agent does not have.
    pub fn act(&mut self, observation: &Observation, mode: ActMode<'_>) -> Result<Decision, ModelError> {
        let Some(network) = &self.network else {
            return Err(ModelError::Shape {
                what: "the policy",
                scenario: "(none begun)".to_owned(),
                got: 0,
                wanted: 1,
            });
        };
        check(network, observation)?;
        let tracks: Vec<Track> = (0..network.agents.len())
            .map(|agent| Track::new(network, agent, &observation.counts, &observation.phases))
            .collect();
        let list: Vec<Sequence<'_>> = tracks
            .iter()
            .enumerate()
            .map(|(agent, track)| Sequence { network, agent, track, start: 0 })
            .collect();
        let batch = Batch::new(&list, 1, &self.sizes);
        let order = index(&batch.order);
        let (log_probs, actor_states, critic_states) = tch::no_grad(|| {
            let forward = self.actor.forward(&batch, &self.actor_state.index_select(0, &order));
            let critic = self.critic.advance(&batch, &self.critic_state.index_select(0, &order));
            (batch.log_softmax(&forward.scores), forward.states.squeeze_dim(1), critic.squeeze_dim(1))
        });
        // Packed order back to layout order.
        let unpack = |states: &Tensor| states.zeros_like().index_copy(0, &order, states);
        (self.actor_state, self.critic_state) = (unpack(&actor_states), unpack(&critic_states));
        Ok(choose(&batch, &floats(&log_probs), mode))
    }

    /// The recurrent state before the next [`Policy::act`], row-major `[agents, hidden]` each.
    #[must_use]
    pub fn recurrent_state(&self) -> RecurrentState {
        RecurrentState { actor: floats(&self.actor_state), critic: floats(&self.critic_state) }
    }
}

fn check(network: &NetworkSpec, observation: &Observation) -> Result<(), ModelError> {
    let shape = |what, got, wanted| ModelError::Shape { what, scenario: "observed".to_owned(), got, wanted };
    let wanted = network.lane_rows * network.bands;
    if observation.counts.len() != wanted {
        return Err(shape("the observation's counts", observation.counts.len(), wanted));
    }
    if observation.phases.len() != network.agents.len() {
        return Err(shape("the observation's phases", observation.phases.len(), network.agents.len()));
    }
    for (spec, &phase) in network.agents.iter().zip(&observation.phases) {
        if usize::from(phase) >= spec.phases {
            return Err(shape("a current phase", usize::from(phase), spec.phases));
        }
    }
    Ok(())
}

fn choose(batch: &Batch, log_probs: &[f32], mut mode: ActMode<'_>) -> Decision {
    let agents = batch.order.len();
    let mut ranges = vec![0..0; agents];
    for group in &batch.groups {
        for sample in 0..group.samples {
            let first = (group.first_row + sample * group.phases) as usize;
            ranges[batch.order[(group.first_sample + sample) as usize]] =
                first..first + group.phases as usize;
        }
    }
    let mut decision = Decision::default();
    // In layout order, so that the draws do not depend on how the batch is packed.
    for range in ranges {
        let own = &log_probs[range];
        let action = match &mut mode {
            ActMode::Greedy => (1..own.len()).fold(0, |best, p| if own[p] > own[best] { p } else { best }),
            ActMode::Sample(rng) => sample(own, rng.random::<f32>()),
        };
        decision.actions.push(action as u8);
        decision.log_probs.push(own[action].min(0.0));
    }
    decision
}

/// The index at which the summed probabilities pass `draw` in [0, 1).
fn sample(log_probs: &[f32], draw: f32) -> usize {
    let mut rest = draw;
    for (p, log_prob) in log_probs.iter().enumerate() {
        rest -= log_prob.exp();
        if rest < 0.0 {
            return p;
        }
    }
    // Rounding can leave a little over: the last phase that is possible at all.
    log_probs.iter().rposition(|lp| *lp > f32::NEG_INFINITY).unwrap_or(0)
}

fn index(order: &[usize]) -> Tensor {
    Tensor::from_slice(&order.iter().map(|&i| i as i64).collect::<Vec<_>>())
}

pub(crate) fn floats(tensor: &Tensor) -> Vec<f32> {
    let flat = tensor.contiguous().view([-1]);
    let mut values = vec![0.0f32; flat.numel()];
    let count = values.len();
    flat.copy_data(&mut values, count);
    values
}
