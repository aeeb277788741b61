//! The learned policy as a controller, so that it is evaluated exactly as the rules are.

use cross_model::{ActMode, ModelError, Policy};
use cross_sim::controller::{Controller, ControllerError, ControllerView};
use cross_sim::layout::NetworkLayout;

/// The greedy policy of a snapshot: the most probable phase, always.
#[derive(Debug)]
pub(crate) struct Learned {
    name: String,
    policy: Policy,
}

impl Learned {
    /// Loads the weights; `name` is what tables call it.
    pub(crate) fn new(name: String, snapshot: &[u8]) -> Result<Self, ModelError> {
        Ok(Self { name, policy: Policy::from_snapshot(snapshot)? })
    }
}

impl Controller for Learned {
    fn name(&self) -> &str {
        &self.name
    }

    fn reset(&mut self, layout: &NetworkLayout, _seed: u64) -> Result<(), ControllerError> {
        Ok(self.policy.begin_episode(layout)?)
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        let decision = self.policy.act(view.observation, ActMode::Greedy)?;
        actions.copy_from_slice(&decision.actions);
        Ok(())
    }
}
