//! Acting through libtorch: the networks as they train, one forward pass for each decision.
//!
//! Actors use [`Policy`](crate::Policy), which computes the same several times faster. This is what tests hold it against,
//! and the baseline that the benchmark prints beside it.

use crate::batch::{Batch, Sequence};
use crate::error::ModelError;
use crate::features::{FeatureSizes, NetworkSpec, Track};
use crate::net::Net;
use crate::policy::{self, ActMode, Decision, floats};
use crate::snapshot::{self, PolicyMetadata};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::{Observation, RecurrentState};
use tch::{Device, Kind, Tensor};

/// A policy that acts through libtorch. Owned by one thread.
#[derive(Debug)]
pub struct PlainPolicy {
    metadata: PolicyMetadata,
    sizes: FeatureSizes,
    actor: Net,
    critic: Net,
    network: Option<NetworkSpec>,
    actor_state: Tensor,
    critic_state: Tensor,
    log_probs: Vec<f32>,
}

impl PlainPolicy {
    /// Builds the networks that a snapshot describes and loads its weights.
    ///
    /// # Errors
    /// [`ModelError`] if the bytes are damaged, foreign or do not fit their own description.
    pub fn from_snapshot(bytes: &[u8]) -> Result<Self, ModelError> {
        let metadata = snapshot::read_metadata(bytes)?;
        let sizes = FeatureSizes::new(&metadata.env, &metadata.model);
        let (actor, critic) = policy::networks(bytes, &metadata, &sizes)?;
        let empty = || Tensor::zeros([0, metadata.model.hidden], (Kind::Float, Device::Cpu));
        let (actor_state, critic_state) = (empty(), empty());
        Ok(Self {
            metadata,
            sizes,
            actor,
            critic,
            network: None,
            actor_state,
            critic_state,
            log_probs: Vec::new(),
        })
    }

    /// As [`Policy::begin_episode`](crate::Policy::begin_episode).
    ///
    /// # Errors
    /// As there.
    pub fn begin_episode(&mut self, layout: &NetworkLayout) -> Result<(), ModelError> {
        let network = NetworkSpec::new(layout, &self.metadata.env, &self.metadata.model)?;
        let shape = [network.agents.len() as i64, self.metadata.model.hidden];
        let zeros = || Tensor::zeros(shape, (Kind::Float, Device::Cpu));
        (self.actor_state, self.critic_state) = (zeros(), zeros());
        self.network = Some(network);
        Ok(())
    }

    /// As [`Policy::act`](crate::Policy::act).
    ///
    /// # Errors
    /// As there.
    pub fn act(&mut self, observation: &Observation, mode: ActMode<'_>) -> Result<Decision, ModelError> {
        let network = self.network.as_ref().ok_or_else(policy::no_episode)?;
        policy::check(network, observation)?;
        let tracks: Vec<Track> = (0..network.agents.len())
            .map(|agent| Track::new(network, agent, &observation.counts, &observation.phases))
            .collect();
        let list: Vec<Sequence<'_>> = tracks
            .iter()
            .enumerate()
            .map(|(agent, track)| Sequence { network, agent, track, start: 0 })
            .collect();
        let batch = Batch::new(&list, 1, &self.sizes);
        let order = Tensor::from_slice(&batch.order.iter().map(|&i| i as i64).collect::<Vec<_>>());
        let (log_probs, actor_states, critic_states) = tch::no_grad(|| {
            let forward = self.actor.forward(&batch, &self.actor_state.index_select(0, &order));
            let critic = self.critic.advance(&batch, &self.critic_state.index_select(0, &order));
            (batch.log_softmax(&forward.scores), forward.states.squeeze_dim(1), critic.squeeze_dim(1))
        });
        // Packed order back to layout order.
        let unpack = |states: &Tensor| states.zeros_like().index_copy(0, &order, states);
        (self.actor_state, self.critic_state) = (unpack(&actor_states), unpack(&critic_states));
        self.log_probs = unpack_rows(&batch, &floats(&log_probs));
        Ok(policy::choose(network, &self.log_probs, mode))
    }

    /// As [`Policy::log_probs`](crate::Policy::log_probs).
    #[must_use]
    pub fn log_probs(&self) -> &[f32] {
        &self.log_probs
    }

    /// As [`Policy::recurrent_state`](crate::Policy::recurrent_state).
    #[must_use]
    pub fn recurrent_state(&self) -> RecurrentState {
        RecurrentState { actor: floats(&self.actor_state), critic: floats(&self.critic_state) }
    }
}

/// One number for each packed row to layout order.
fn unpack_rows(batch: &Batch, packed: &[f32]) -> Vec<f32> {
    let mut ranges = vec![0..0; batch.order.len()];
    for group in &batch.groups {
        for sample in 0..group.samples {
            let first = (group.first_row + sample * group.phases) as usize;
            ranges[batch.order[(group.first_sample + sample) as usize]] =
                first..first + group.phases as usize;
        }
    }
    ranges.into_iter().flat_map(|range| packed[range].iter().copied()).collect()
}
