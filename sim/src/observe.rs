//! Observation and reward, from counts per lane.

use crate::lanes::{LaneCounts, LaneTable};
use cross_config::Detection;

/// Writes the counts `[lane rows, bands]` of an observation; `out` is reused.
pub fn observe(lanes: &LaneTable, detection: Detection, out: &mut Vec<u16>) {
    out.clear();
    for lane in lanes.rows() {
        match detection {
            Detection::Paper => out.extend([lane.stopped_near, lane.moving_near()]),
            Detection::Default => {
                out.extend([lane.stopped, lane.moving_middle, lane.moving() - lane.moving_middle]);
            }
            Detection::Fine => out.extend([
                lane.stopped_near,
                lane.stopped - lane.stopped_near,
                lane.moving_near(),
                lane.moving_middle - lane.moving_near(),
                lane.moving_far - lane.moving_middle,
                lane.moving() - lane.moving_far,
            ]),
        }
    }
}

/// Writes the reward of each agent: minus the vehicles stopped on its incoming lanes, where one within the reward's range
/// counts 1 and one farther from the stop line `beyond`.
pub fn rewards(lanes: &LaneTable, beyond: f32, out: &mut Vec<f32>) {
    let stopped = |lane: &LaneCounts| {
        let within = lane.stopped_in_reward_range;
        f32::from(within) + beyond * f32::from(lane.stopped - within)
    };
    out.clear();
    out.extend((0..lanes.agents()).map(|agent| -lanes.incoming_of(agent).map(stopped).sum::<f32>()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{Intersection, Lane, NetworkLayout};

    /// Two intersections in a row: `a` leads into the first, `b` from the first into the second.
    fn table() -> LaneTable {
        let lane = |id: &str| Lane { id: id.to_owned(), length: 200.0, speed: 10.0 };
        let intersection = |incoming: &[&str], outgoing: &[&str]| Intersection {
            id: String::new(),
            position: (0.0, 0.0),
            incoming: incoming.iter().map(|id| lane(id)).collect(),
            outgoing: outgoing.iter().map(|id| lane(id)).collect(),
            movements: vec![],
            phases: vec![],
            roads_in: vec![],
            roads_out: vec![],
        };
        let intersections = vec![intersection(&["a"], &["b"]), intersection(&["b"], &["c"])];
        LaneTable::new(&NetworkLayout { intersections }, 50.0)
    }

    #[test]
    fn vehicles_fall_into_the_bands_of_both_detections() {
        let mut lanes = table();
        lanes.add("b", 199.0, 0.0); // at the stop line, standing
        lanes.add("b", 149.9, 0.05); // standing beyond 50 m
        lanes.add("b", 150.0, 0.1); // exactly 50 m away, just moving
        lanes.add("b", 100.0, 5.0); // exactly 100 m away, moving
        lanes.add("b", 99.9, 5.0); // farther, moving
        lanes.add(":J_0_0", 1.0, 0.0); // inside a junction
        lanes.add("b", -0.1, 5.0); // more than 200 m away
        let (mut paper, mut default, mut fine) = (Vec::new(), Vec::new(), Vec::new());
        observe(&lanes, Detection::Paper, &mut paper);
        observe(&lanes, Detection::Default, &mut default);
        observe(&lanes, Detection::Fine, &mut fine);
        // Rows: a, b of the first intersection; b, c of the second.
        assert_eq!(paper, [0, 0, 1, 1, 1, 1, 0, 0]);
        assert_eq!(default, [0, 0, 0, 2, 2, 2, 2, 2, 2, 0, 0, 0]);
        assert_eq!(fine[..12], [0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1]);
        assert_eq!(fine[12..], [1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn reward_counts_incoming_lanes_and_less_beyond_its_range() {
        let mut lanes = table();
        lanes.add("b", 199.0, 0.0);
        lanes.add("b", 160.0, 0.0);
        lanes.add("b", 140.0, 0.0);
        lanes.add("a", 190.0, 3.0);
        let mut out = Vec::new();
        rewards(&lanes, 0.0, &mut out);
        assert_eq!(out, [0.0, -2.0]);
        rewards(&lanes, 0.25, &mut out);
        assert_eq!(out, [0.0, -2.25], "one stands beyond 50 m");
        rewards(&lanes, 1.0, &mut out);
        assert_eq!(out, [0.0, -3.0], "as if the range were the whole lane");
        lanes.clear();
        rewards(&lanes, 1.0, &mut out);
        assert_eq!(out, [0.0, 0.0]);
    }

    #[test]
    fn a_lane_between_two_signals_is_counted_once_for_the_network() {
        let mut lanes = table();
        lanes.add("b", 10.0, 0.0);
        assert_eq!(lanes.signalised_incoming().map(|lane| lane.stopped).sum::<u16>(), 1);
        assert_eq!(lanes.outgoing(0, 0), lanes.incoming(1, 0));
        assert_eq!(lanes.rows().len(), 4);
    }
}
