//! Fixed-Time: every phase for one decision interval, in the order of the net's program.

use super::{Controller, ControllerError, ControllerView};

/// Moves every agent to its next phase at every decision, whatever the traffic.
#[derive(Debug, Clone, Copy, Default)]
pub struct FixedTime;

impl Controller for FixedTime {
    fn name(&self) -> &str {
        "fixed-time"
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        for (action, intersection) in actions.iter_mut().zip(&view.layout.intersections) {
            let next = usize::from(*action) + 1;
            *action = if next < intersection.phases.len() { next as u8 } else { 0 };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::test_network::TestNetwork;

    #[test]
    fn goes_round_through_each_agents_own_phases() {
        let network = TestNetwork::crossing();
        let mut controller = FixedTime;
        let mut actions = network.observation.phases.clone();
        let mut seen = Vec::new();
        for _ in 0..4 {
            controller.act(&network.view(), &mut actions).unwrap();
            seen.push(actions.clone());
        }
        // The first agent has three phases, the second two.
        assert_eq!(seen, [vec![1, 1], vec![2, 0], vec![0, 1], vec![1, 0]]);
    }
}
