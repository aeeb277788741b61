//! Random: any phase with equal probability, the floor that every other controller must beat.

use super::{Controller, ControllerError, ControllerView};
use crate::layout::NetworkLayout;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws every agent's phase anew at every decision.
#[derive(Debug, Clone)]
pub struct Random {
    generator: ChaCha8Rng,
}

impl Default for Random {
    fn default() -> Self {
        Self { generator: ChaCha8Rng::seed_from_u64(0) }
    }
}

impl Controller for Random {
    fn name(&self) -> &str {
        "random"
    }

    fn reset(&mut self, _layout: &NetworkLayout, seed: u64) -> Result<(), ControllerError> {
        self.generator = ChaCha8Rng::seed_from_u64(seed);
        Ok(())
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        for (action, intersection) in actions.iter_mut().zip(&view.layout.intersections) {
            // A layout has at least one phase an agent and at most 64 (EnvConfig::max_phases).
            *action = self.generator.random_range(0..intersection.phases.len().max(1) as u8);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::test_network::TestNetwork;

    fn draw(seed: u64) -> Vec<Vec<u8>> {
        let network = TestNetwork::crossing();
        let mut controller = Random::default();
        controller.reset(&network.layout, seed).unwrap();
        let mut actions = network.observation.phases.clone();
        let mut all = Vec::new();
        for _ in 0..200 {
            controller.act(&network.view(), &mut actions).unwrap();
            all.push(actions.clone());
        }
        all
    }

    #[test]
    fn one_seed_gives_one_sequence_and_another_seed_another() {
        assert_eq!(draw(7), draw(7));
        assert_ne!(draw(7), draw(8));
    }

    #[test]
    fn draws_every_phase_of_every_agent_and_no_other() {
        let all = draw(1);
        for (agent, phases) in [(0, 3), (1, 2)] {
            let mut seen: Vec<u8> = all.iter().map(|actions| actions[agent]).collect();
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen, (0..phases).collect::<Vec<u8>>());
        }
    }
}
