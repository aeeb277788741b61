//! Observation and reward, from counts per lane.

use crate::lanes::{LaneCounts, LaneTable};
use cross_config::Detection;

/// Writes the counts `[lane rows, bands]` of an observation; `out` is reused. A lane counts with what is behind
/// or beyond it.
pub fn observe(lanes: &LaneTable, detection: Detection, out: &mut Vec<u16>) {
    out.clear();
    for lane in lanes.seen() {
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

/// Writes the reward of each agent: minus the vehicles stopped on its incoming lanes and behind them, where one within the reward's range
/// counts 1 and one farther from the stop line `beyond`.
pub fn rewards(lanes: &LaneTable, beyond: f32, out: &mut Vec<f32>) {
    let stopped = |lane: &LaneCounts| {
        let within = lane.stopped_in_reward_range;
        f32::from(within) + beyond * f32::from(lane.stopped - within)
    };
    out.clear();
    out.extend((0..lanes.agents()).map(|agent| -lanes.seen_incoming_of(agent).map(stopped).sum::<f32>()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{Intersection, Lane, NetworkLayout, Stretch};

    /// Two intersections in a row: `a` leads into the first, `b` from the first into the second.
    fn layout() -> NetworkLayout {
        let lane = |id: &str| Lane::new(id, 200.0, 10.0);
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
        NetworkLayout { intersections: vec![intersection(&["a"], &["b"]), intersection(&["b"], &["c"])] }
    }

    fn table() -> LaneTable {
        LaneTable::new(&layout(), 50.0)
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
    fn vehicles_behind_an_incoming_lane_are_seen_and_cost_but_are_no_queue_of_its_own() {
        let mut layout = layout();
        // 30 m behind the stop line of `a`, and 80 m behind that of `b`.
        let behind = |metres| Stretch { id: "before".to_owned(), length: 100.0, metres };
        layout.intersections[0].incoming[0].behind.push(behind(30.0));
        layout.intersections[1].incoming[0].behind.push(behind(80.0));
        let mut lanes = LaneTable::new(&layout, 50.0);
        for _ in 0..3 {
            lanes.add("before", 90.0, 0.0);
        }
        lanes.add("a", 190.0, 0.0);
        let (mut seen, mut out) = (Vec::new(), Vec::new());
        observe(&lanes, Detection::Fine, &mut seen);
        // By turns: two are 40 m from the one stop line, with the vehicle on the lane itself, and one 90 m from the other.
        assert_eq!(
            seen[..12],
            [3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            "the lane out of the first is a lane alone"
        );
        assert_eq!(seen[12..], [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        rewards(&lanes, 0.5, &mut out);
        assert_eq!(out, [-3.0, -0.5]);
        assert_eq!(lanes.incoming(0, 0).stopped, 1, "rules go by lanes");
        assert_eq!(lanes.signalised_incoming().map(|lane| lane.stopped).sum::<u16>(), 1);
        lanes.clear();
        lanes.add("before", 90.0, 0.0);
        observe(&lanes, Detection::Fine, &mut seen);
        assert_eq!(seen[0], 1, "turns begin anew");
    }

    #[test]
    fn vehicles_beyond_an_outgoing_lane_are_seen_in_every_exit_and_cost_nothing() {
        let mut layout = layout();
        // `b`, 200 m, leads out of the first; after it come 40 m of the same street. `c` leads there too.
        let beyond = Stretch { id: "after".to_owned(), length: 40.0, metres: 0.0 };
        layout.intersections[0].outgoing[0].beyond.push(beyond.clone());
        layout.intersections[1].outgoing[0].beyond.push(beyond);
        assert_eq!(layout.intersections[0].outgoing[0].reach(), 240.0);
        let mut lanes = LaneTable::new(&layout, 50.0);
        lanes.add("after", 1.0, 0.0);
        lanes.add("b", 195.0, 0.0);
        let (mut seen, mut out) = (Vec::new(), Vec::new());
        observe(&lanes, Detection::Paper, &mut seen);
        // The second stands 45 m before the end of the street, and 5 m before the stop line of `b`.
        assert_eq!(seen, [0, 0, 2, 0, 1, 0, 1, 0]);
        rewards(&lanes, 1.0, &mut out);
        assert_eq!(out, [0.0, -1.0]);
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
