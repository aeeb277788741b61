//! Acting: a snapshot's networks on one network of streets, with their recurrent state.

use crate::error::ModelError;
use crate::features::{FeatureSizes, NetworkSpec, Track};
use crate::inference::{Actor, ActorWork, Constant, Critic, CriticWork};
use crate::net::{Net, Role};
use crate::routing::{Routing, means_by_agent};
use crate::snapshot::{self, PolicyMetadata};
use crate::vector::Isa;
use cross_config::{EnvConfig, ModelConfig};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::{Observation, RecurrentState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

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
    isa: Isa,
    actor: Actor,
    critic: Critic,
    network: Option<Begun>,
    state: RecurrentState,
    /// The critic's recurrent state is one observation behind the actor's; that observation is still in the buffers.
    critic_behind: bool,
    /// Nobody records what it does, so that nobody needs the critic's state.
    only_acts: bool,
    buffers: Buffers,
}

/// The network of streets that an episode was begun on.
#[derive(Debug)]
struct Begun {
    spec: NetworkSpec,
    /// What the present weights make of it.
    constant: Constant,
}

/// Kept from decision to decision, so that none allocates.
#[derive(Debug, Default)]
struct Buffers {
    seen: Track,
    actor: ActorWork,
    critic: CriticWork,
    log_probs: Vec<f32>,
}

impl Policy {
    /// Loads the weights of a snapshot.
    ///
    /// # Errors
    /// [`ModelError`] if the bytes are damaged, foreign or do not fit their own description.
    pub fn from_snapshot(bytes: &[u8]) -> Result<Self, ModelError> {
        Self::with(Isa::best(), bytes)
    }

    /// As [`Policy::from_snapshot`], with these instructions.
    pub(crate) fn with(isa: Isa, bytes: &[u8]) -> Result<Self, ModelError> {
        let metadata = snapshot::read_metadata(bytes)?;
        let sizes = FeatureSizes::new(&metadata.env, &metadata.model);
        let (actor, critic) = networks(bytes, &metadata, &sizes)?;
        Ok(Self {
            isa,
            actor: Actor::new(isa, &actor, &metadata.model, &sizes)?,
            critic: Critic::new(isa, &critic, &metadata.model)?,
            metadata,
            network: None,
            state: RecurrentState::default(),
            critic_behind: false,
            only_acts: false,
            buffers: Buffers::default(),
        })
    }

    /// The same policy for whoever acts and records nothing: the critic's state, a fifth of the work of a decision, stays
    /// what it was at the episode's start.
    #[must_use]
    pub fn only_acting(self) -> Self {
        Self { only_acts: true, ..self }
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
        let spec = NetworkSpec::new(layout, &self.metadata.env, &self.metadata.model)?;
        let zeros = || vec![0.0; spec.agents.len() * self.metadata.model.hidden as usize];
        self.state = RecurrentState { actor: zeros(), critic: zeros() };
        self.critic_behind = false;
        // Nothing that was decided on another network is this one's.
        self.buffers = Buffers::default();
        let constant = self.actor.constant(&spec);
        self.network = Some(Begun { spec, constant });
        Ok(())
    }

    /// Goes on from a state that [`Policy::recurrent_state`] gave, instead of zero; for acting a recorded fragment again.
    ///
    /// # Errors
    /// [`ModelError::Shape`] if it is not one of the network that [`Policy::begin_episode`] named.
    pub fn resume(&mut self, state: RecurrentState) -> Result<(), ModelError> {
        for (own, given) in [(&self.state.actor, &state.actor), (&self.state.critic, &state.critic)] {
            if own.len() != given.len() {
                return Err(shape("the recurrent state", given.len(), own.len()));
            }
        }
        self.state = state;
        self.critic_behind = false;
        Ok(())
    }

    /// Takes newer weights of the same configuration; the recurrent state stays.
    ///
    /// # Errors
    /// [`ModelError`] if the bytes are damaged, foreign or of another configuration; the old weights then remain.
    pub fn replace_weights(&mut self, bytes: &[u8]) -> Result<(), ModelError> {
        let other = Self::with(self.isa, bytes)?;
        // What the old weights have seen is theirs to remember.
        self.catch_up();
        if other.metadata.model != self.metadata.model || other.metadata.env != self.metadata.env {
            return Err(ModelError::Mismatch {
                what: "policy",
                reason: "its env or model configuration differs from the one in use".to_owned(),
            });
        }
        let Self { metadata, actor, critic, .. } = other;
        if let Some(network) = &mut self.network {
            network.constant = actor.constant(&network.spec);
        }
        (self.metadata, self.actor, self.critic) = (metadata, actor, critic);
        Ok(())
    }

    /// Chooses a phase for every agent and advances the recurrent state, the critic's with the next
    /// [`Policy::catch_up`] or whatever needs it.
    ///
    /// # Errors
    /// [`ModelError::Shape`] if the observation is not of the network that [`Policy::begin_episode`] named, or holds a
    /// phase that an agent does not have.
    pub fn act(&mut self, observation: &Observation, mode: ActMode<'_>) -> Result<Decision, ModelError> {
        self.catch_up();
        let Begun { spec, constant } = self.network.as_ref().ok_or_else(no_episode)?;
        check(spec, observation)?;
        let Buffers { seen, actor, log_probs, .. } = &mut self.buffers;
        spec.look(&observation.counts, &observation.phases, seen);
        self.actor.forward(spec, constant, seen, &mut self.state.actor, actor);
        self.critic_behind = true;
        log_softmax(spec, &actor.scores, log_probs);
        Ok(choose(spec, log_probs, mode))
    }

    /// Takes the critic's recurrent state past the last observation. No decision waits for it, so that this can be done
    /// while SUMO simulates; what is left undone, the next call that needs it does.
    pub fn catch_up(&mut self) {
        if !std::mem::take(&mut self.critic_behind) || self.only_acts {
            return;
        }
        if let Some(Begun { spec, .. }) = &self.network {
            let Buffers { seen, critic, .. } = &mut self.buffers;
            self.critic.advance(spec, seen, &mut self.state.critic, critic);
        }
    }

    /// Log-probability of every phase at the last decision `[phases of all agents]`, in layout order; before the first
    /// decision empty.
    #[must_use]
    pub fn log_probs(&self) -> &[f32] {
        &self.buffers.log_probs
    }

    /// The experts and clusters that the last decision went through; before the first decision of a network empty.
    #[must_use]
    pub fn routing(&self) -> Routing {
        let Some(Begun { spec, .. }) = &self.network else { return Routing::default() };
        let model = &self.metadata.model;
        Routing {
            experts: means_by_agent(spec, &self.buffers.actor.gates(), model.experts as usize),
            clusters: means_by_agent(spec, self.buffers.actor.assignment(), model.clusters as usize),
        }
    }

    /// The recurrent state before the next [`Policy::act`], row-major `[agents, hidden]` each.
    #[must_use]
    pub fn recurrent_state(&mut self) -> RecurrentState {
        self.catch_up();
        self.state.clone()
    }
}

/// A snapshot's networks.
pub(crate) fn networks(
    bytes: &[u8],
    metadata: &PolicyMetadata,
    sizes: &FeatureSizes,
) -> Result<(Net, Net), ModelError> {
    // Networks are as large as their description says, and that may be wrong: the file must hold as much.
    let needed = 2 * Net::scalars(&metadata.model, sizes).unsigned_abs() * size_of::<f32>() as u64;
    if (bytes.len() as u64) < needed {
        return Err(ModelError::Mismatch {
            what: "policy",
            reason: format!("it has {} bytes, and its networks' weights alone take {needed}", bytes.len()),
        });
    }
    // The weights are overwritten at once, so the seed does not matter.
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let actor = Net::new(Role::Actor, &metadata.model, sizes, &mut rng);
    let critic = Net::new(Role::Critic, &metadata.model, sizes, &mut rng);
    snapshot::load_weights(bytes, &actor, &critic)?;
    Ok((actor, critic))
}

pub(crate) fn no_episode() -> ModelError {
    ModelError::Shape { what: "the policy", scenario: "(none begun)".to_owned(), got: 0, wanted: 1 }
}

fn shape(what: &'static str, got: usize, wanted: usize) -> ModelError {
    ModelError::Shape { what, scenario: "observed".to_owned(), got, wanted }
}

pub(crate) fn check(network: &NetworkSpec, observation: &Observation) -> Result<(), ModelError> {
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

/// Log-probabilities of each agent's phases from their scores.
fn log_softmax(network: &NetworkSpec, scores: &[f32], out: &mut Vec<f32>) {
    out.clear();
    let mut rest = scores;
    for agent in &network.agents {
        let (own, others) = rest.split_at(agent.phases);
        rest = others;
        let most = own.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let total: f32 = own.iter().map(|score| (score - most).exp()).sum();
        out.extend(own.iter().map(|score| score - most - total.ln()));
    }
}

/// Chooses from log-probabilities in layout order.
pub(crate) fn choose(network: &NetworkSpec, log_probs: &[f32], mut mode: ActMode<'_>) -> Decision {
    let mut decision = Decision {
        actions: Vec::with_capacity(network.agents.len()),
        log_probs: Vec::with_capacity(network.agents.len()),
    };
    let mut rest = log_probs;
    for agent in &network.agents {
        let (own, others) = rest.split_at(agent.phases);
        rest = others;
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

pub(crate) fn floats(tensor: &Tensor) -> Vec<f32> {
    let flat = tensor.contiguous().view([-1]);
    let mut values = vec![0.0f32; flat.numel()];
    let count = values.len();
    flat.copy_data(&mut values, count);
    values
}
