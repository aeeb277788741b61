//! Max-Pressure: green to the phase whose lanes hold the most more vehicles than the lanes they lead to.

use super::{Controller, ControllerError, ControllerView, first_highest};
use crate::lanes::LaneCounts;

/// Which vehicles count on an outgoing lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Outgoing {
    /// All of them.
    All,
    /// Those that stand still.
    Stopped,
}

/// Which part of a lane is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Range {
    /// From its beginning to its end.
    WholeLane,
    /// The last 50 m before its end.
    Last50m,
}

/// The pressure of a phase is the sum, over its green links (protected or permissive), of the stopped vehicles on the
/// link's incoming lane minus the vehicles on its outgoing lane; the highest pressure gets green, the lowest phase
/// index among equals.
///
/// A lane counts once for each link that it feeds, so that a lane with three target lanes weighs threefold: this is what
/// reproduces the published numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MaxPressure {
    outgoing: Outgoing,
    range: Range,
}

impl MaxPressure {
    /// The variant with these two choices.
    #[must_use]
    pub fn new(outgoing: Outgoing, range: Range) -> Self {
        Self { outgoing, range }
    }

    fn upstream(self, lane: &LaneCounts) -> i64 {
        i64::from(match self.range {
            Range::WholeLane => lane.stopped,
            Range::Last50m => lane.stopped_near,
        })
    }

    fn downstream(self, lane: &LaneCounts) -> i64 {
        i64::from(match (self.outgoing, self.range) {
            (Outgoing::All, Range::WholeLane) => lane.total,
            (Outgoing::All, Range::Last50m) => lane.total_near,
            (Outgoing::Stopped, Range::WholeLane) => lane.stopped,
            (Outgoing::Stopped, Range::Last50m) => lane.stopped_near,
        })
    }
}

impl Controller for MaxPressure {
    fn name(&self) -> &str {
        match (self.outgoing, self.range) {
            (Outgoing::All, Range::WholeLane) => "max-pressure-all",
            (Outgoing::All, Range::Last50m) => "max-pressure-all-50m",
            (Outgoing::Stopped, Range::WholeLane) => "max-pressure-stopped",
            (Outgoing::Stopped, Range::Last50m) => "max-pressure-stopped-50m",
        }
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        for (agent, (action, intersection)) in actions.iter_mut().zip(&view.layout.intersections).enumerate()
        {
            *action = first_highest(intersection.phases.iter().map(|phase| {
                let links = phase.green.iter().zip(&intersection.movements);
                let green = links.filter(|(green, _)| **green > 0.0);
                green
                    .map(|(_, link)| {
                        self.upstream(view.lanes.incoming(agent, link.incoming))
                            - self.downstream(view.lanes.outgoing(agent, link.outgoing))
                    })
                    .sum()
            }));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::test_network::TestNetwork;

    fn decide(network: &TestNetwork, outgoing: Outgoing, range: Range) -> Vec<u8> {
        let mut actions = network.observation.phases.clone();
        MaxPressure::new(outgoing, range).act(&network.view(), &mut actions).unwrap();
        actions
    }

    const ALL_VARIANTS: [(Outgoing, Range); 4] = [
        (Outgoing::All, Range::WholeLane),
        (Outgoing::All, Range::Last50m),
        (Outgoing::Stopped, Range::WholeLane),
        (Outgoing::Stopped, Range::Last50m),
    ];

    #[test]
    fn an_empty_network_gets_the_first_phase() {
        let network = TestNetwork::crossing();
        for (outgoing, range) in ALL_VARIANTS {
            assert_eq!(decide(&network, outgoing, range), [0, 0]);
        }
    }

    #[test]
    fn the_longest_queue_gets_green_and_moving_vehicles_do_not_pull() {
        let mut network = TestNetwork::crossing();
        network.stopped("a_west", 2, 0.0).moving("a_north", 9, 0.0);
        for (outgoing, range) in ALL_VARIANTS {
            assert_eq!(decide(&network, outgoing, range)[0], 1, "{outgoing:?} {range:?}");
        }
    }

    #[test]
    fn a_full_street_downstream_holds_the_phase_back() {
        let mut network = TestNetwork::crossing();
        // Three wait in the north and two in the west, but where the northern ones go, two already stand.
        network.stopped("a_north", 3, 0.0).stopped("a_west", 2, 0.0).stopped("a_south_out", 2, 0.0);
        for (outgoing, range) in ALL_VARIANTS {
            assert_eq!(decide(&network, outgoing, range)[0], 1, "{outgoing:?} {range:?}");
        }
    }

    #[test]
    fn moving_vehicles_downstream_count_only_in_the_variant_with_all() {
        let mut network = TestNetwork::crossing();
        network.stopped("a_north", 3, 0.0).stopped("a_west", 2, 0.0).moving("a_south_out", 2, 0.0);
        assert_eq!(decide(&network, Outgoing::All, Range::WholeLane)[0], 1);
        assert_eq!(decide(&network, Outgoing::Stopped, Range::WholeLane)[0], 0);
    }

    #[test]
    fn vehicles_beyond_50_m_count_only_on_the_whole_lane() {
        let mut network = TestNetwork::crossing();
        network.stopped("a_north", 1, 10.0).stopped("a_west", 5, 60.0);
        assert_eq!(decide(&network, Outgoing::Stopped, Range::WholeLane)[0], 1);
        assert_eq!(decide(&network, Outgoing::Stopped, Range::Last50m)[0], 0);
        assert_eq!(decide(&network, Outgoing::All, Range::WholeLane)[0], 1);
        assert_eq!(decide(&network, Outgoing::All, Range::Last50m)[0], 0);
    }

    #[test]
    fn permissive_greens_count_in_full_and_a_lane_counts_once_per_link() {
        let mut network = TestNetwork::crossing();
        // The side lane has two links, one of them permissive: twice its one vehicle is more than the other lanes' one.
        network.stopped("a_side", 1, 0.0).stopped("a_north", 1, 0.0).stopped("a_west", 1, 0.0);
        assert_eq!(decide(&network, Outgoing::Stopped, Range::WholeLane)[0], 2);
    }

    #[test]
    fn agents_decide_each_for_itself() {
        let mut network = TestNetwork::crossing();
        network.stopped("a_west", 1, 0.0).stopped("b_east", 1, 0.0);
        assert_eq!(decide(&network, Outgoing::Stopped, Range::WholeLane), [1, 1]);
    }
}
