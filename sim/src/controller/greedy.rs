//! Greedy: green to the phase that serves the most waiting vehicles.

use super::{Controller, ControllerError, ControllerView, first_highest};

/// Chooses the phase with the most stopped vehicles on the incoming lanes that it gives green to, each lane counted once
/// and over its whole length; the lowest phase index among equals. Unlike Max-Pressure it does not look downstream.
#[derive(Debug, Clone, Default)]
pub struct Greedy {
    /// Whether a lane of the agent at hand was counted for the phase at hand; kept between calls for its memory.
    counted: Vec<bool>,
}

impl Controller for Greedy {
    fn name(&self) -> &str {
        "greedy"
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        for (agent, (action, intersection)) in actions.iter_mut().zip(&view.layout.intersections).enumerate()
        {
            *action = first_highest(intersection.phases.iter().map(|phase| {
                self.counted.clear();
                self.counted.resize(intersection.incoming.len(), false);
                let mut waiting = 0;
                for (green, link) in phase.green.iter().zip(&intersection.movements) {
                    if *green > 0.0 && !std::mem::replace(&mut self.counted[link.incoming], true) {
                        waiting += i64::from(view.lanes.incoming(agent, link.incoming).stopped);
                    }
                }
                waiting
            }));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::test_network::TestNetwork;

    fn decide(network: &TestNetwork) -> Vec<u8> {
        let mut actions = network.observation.phases.clone();
        Greedy::default().act(&network.view(), &mut actions).unwrap();
        actions
    }

    #[test]
    fn serves_the_most_stopped_vehicles_and_ignores_moving_ones() {
        let mut network = TestNetwork::crossing();
        network.stopped("a_north", 1, 0.0).moving("a_north", 8, 0.0).stopped("a_west", 2, 0.0);
        assert_eq!(decide(&network), [1, 0]);
    }

    #[test]
    fn does_not_look_downstream() {
        let mut network = TestNetwork::crossing();
        network.stopped("a_west", 2, 0.0).stopped("a_east_out", 20, 0.0);
        assert_eq!(decide(&network)[0], 1);
    }

    #[test]
    fn counts_a_lane_once_however_many_links_it_has() {
        let mut network = TestNetwork::crossing();
        // The side lane has two links, but three vehicles are three: equal to the north, so that the lower phase wins.
        network.stopped("a_north", 3, 0.0).stopped("a_side", 3, 0.0);
        assert_eq!(decide(&network)[0], 0);
        network.stopped("a_side", 1, 0.0);
        assert_eq!(decide(&network)[0], 2, "permissive greens serve, too");
    }
}
