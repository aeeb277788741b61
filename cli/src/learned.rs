//! The learned policy as a controller, so that it is evaluated exactly as the rules are.

use crate::routing::RoutingLog;
use cross_model::{ActMode, ModelError, Policy};
use cross_sim::controller::{Controller, ControllerError, ControllerView};
use cross_sim::layout::NetworkLayout;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// How a learned policy's phases are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Acting {
    /// The most probable phase, always.
    Greedy,
    /// At random, by their probabilities, as in training. The same seed, the same episode.
    Sampled,
}

/// The policy of a snapshot.
#[derive(Debug)]
pub(crate) struct Learned {
    name: String,
    policy: Policy,
    acting: Acting,
    rng: ChaCha8Rng,
    /// Where to write what experts and clusters it uses, if somebody wants to know.
    log: Option<RoutingLog>,
}

impl Learned {
    /// Loads the weights; `name` is what tables call it.
    pub(crate) fn new(
        name: String,
        snapshot: &[u8],
        acting: Acting,
        log: Option<RoutingLog>,
    ) -> Result<Self, ModelError> {
        let policy = Policy::from_snapshot(snapshot)?.only_acting();
        Ok(Self { name, policy, acting, rng: ChaCha8Rng::seed_from_u64(0), log })
    }
}

impl Controller for Learned {
    fn name(&self) -> &str {
        &self.name
    }

    fn reset(&mut self, layout: &NetworkLayout, seed: u64) -> Result<(), ControllerError> {
        self.rng = ChaCha8Rng::seed_from_u64(seed);
        if let Some(log) = &self.log {
            log.clear();
        }
        Ok(self.policy.begin_episode(layout)?)
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        let mode = match self.acting {
            Acting::Greedy => ActMode::Greedy,
            Acting::Sampled => ActMode::Sample(&mut self.rng),
        };
        let decision = self.policy.act(view.observation, mode)?;
        actions.copy_from_slice(&decision.actions);
        if let Some(log) = &self.log {
            log.add(view.time, actions.len(), &self.policy.routing());
        }
        Ok(())
    }
}
