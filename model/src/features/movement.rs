//! Features of the `movement` form: what a phase's green lanes hold, in no order.

use super::{AgentSpec, COUNT_SCALE, LENGTH_SCALE, NUMBER_SCALE, Track};
use cross_config::LaneGreen;
use cross_sim::layout::{Intersection, Movement};

/// Features of a phase: summed counts of its green incoming and outgoing lanes per band, whether it is the current
/// phase, and how many green lanes lead in and out.
pub(super) fn phase_features(bands: usize) -> usize {
    2 * bands + 3
}

/// Features of a lane token: counts per band, incoming, outgoing, length.
pub(super) fn lane_features(bands: usize) -> usize {
    bands + 3
}

/// `[phases, lanes]`: the strongest green that any movement from (incoming) or to (outgoing) the lane has in the phase; under
/// [`LaneGreen::Mean`] an incoming lane has the mean over its movements instead, those for turning round left out where there
/// are others: hardly anybody waits for them, and they are open in phases for left turns.
///
/// An outgoing lane keeps the strongest in either: it fills up from whichever movement is open, and that others into it are
/// closed takes nothing away.
pub(super) fn lane_green(intersection: &Intersection, weight: LaneGreen) -> Vec<f32> {
    let (lanes, incoming) = (intersection.lanes(), intersection.incoming.len());
    let only_round = |lane| intersection.movements.iter().all(|m| m.turnaround || m.incoming != lane);
    let only_round: Vec<bool> = (0..incoming).map(only_round).collect();
    let counts = |movement: &Movement| !movement.turnaround || only_round[movement.incoming];
    let mut movements = vec![0.0f32; incoming];
    for movement in intersection.movements.iter().filter(|movement| counts(movement)) {
        movements[movement.incoming] += 1.0;
    }
    let mut green = vec![0.0f32; intersection.phases.len() * lanes];
    for (phase, row) in intersection.phases.iter().zip(green.chunks_exact_mut(lanes.max(1))) {
        for (movement, &value) in intersection.movements.iter().zip(&phase.green) {
            let (from, to) = (movement.incoming, incoming + movement.outgoing);
            row[to] = row[to].max(value);
            match weight {
                LaneGreen::Strongest => row[from] = row[from].max(value),
                LaneGreen::Mean if counts(movement) => row[from] += value,
                LaneGreen::Mean => {}
            }
        }
        if weight == LaneGreen::Mean {
            for (sum, &of) in row.iter_mut().zip(&movements) {
                *sum /= of.max(1.0);
            }
        }
    }
    green
}

/// `[lanes, 3]`: incoming, outgoing, length, that of the lanes behind an incoming one included. An outgoing one has its own alone:
/// with those beyond it `ingolstadt21` jammed in three seeds of five instead of one.
pub(super) fn lane_constants(intersection: &Intersection) -> Vec<f32> {
    let incoming = intersection.incoming.iter().flat_map(|lane| [1.0, 0.0, lane.reach() / LENGTH_SCALE]);
    let outgoing = intersection.outgoing.iter().flat_map(|lane| [0.0, 1.0, lane.length / LENGTH_SCALE]);
    incoming.chain(outgoing).collect()
}

/// Appends one observation.
pub(super) fn push(spec: &AgentSpec, bands: usize, counts: &[u16], current: usize, track: &mut Track) {
    let width = phase_features(bands);
    let start = track.phases.len();
    for p in 0..spec.phases {
        let at = track.phases.len();
        track.phases.resize(at + width, 0.0);
        let row = &mut track.phases[at..];
        let mut open = [0.0f32; 2];
        for lane in 0..spec.lanes {
            let green = spec.lane_green[p * spec.lanes + lane];
            if green == 0.0 {
                continue;
            }
            let side = usize::from(lane >= spec.incoming);
            open[side] += 1.0;
            for band in 0..bands {
                row[side * bands + band] += green * f32::from(counts[lane * bands + band]) / COUNT_SCALE;
            }
        }
        row[2 * bands] = f32::from(u8::from(p == current));
        row[2 * bands + 1] = open[0] / NUMBER_SCALE;
        row[2 * bands + 2] = open[1] / NUMBER_SCALE;
    }
    let rows = &track.phases[start..];
    for feature in 0..width {
        let column = rows.iter().skip(feature).step_by(width);
        track.context.push(column.sum::<f32>() / spec.phases as f32);
    }
    for feature in 0..width {
        let column = rows.iter().skip(feature).step_by(width);
        track.context.push(column.copied().fold(f32::NEG_INFINITY, f32::max));
    }
    for lane in 0..spec.lanes {
        let own = &counts[lane * bands..(lane + 1) * bands];
        track.lanes.extend(own.iter().map(|&count| f32::from(count) / COUNT_SCALE));
        track.lanes.extend_from_slice(&spec.lane_constants[lane * 3..(lane + 1) * 3]);
    }
}

#[cfg(test)]
mod tests {
    use super::{Intersection, Movement, lane_constants, lane_green};
    use cross_config::LaneGreen;
    use cross_sim::layout::{Lane, Phase, Stretch};

    /// A shared lane (left, straight on, right) and a lane for left turns alone, which lead to three lanes out; in phase 0 the
    /// shared lane may go and left turns give way, phase 1 is for left turns alone.
    fn shared_lane() -> Intersection {
        let lane = |id: &str| Lane::new(id, 300.0, 13.9);
        let phase = |state: &str, green: [f32; 4]| Phase { state: state.to_owned(), green: green.to_vec() };
        Intersection {
            id: "j".to_owned(),
            position: (0.0, 0.0),
            incoming: vec![lane("shared"), lane("left")],
            outgoing: vec![lane("west"), lane("north"), lane("east")],
            movements: [(0, 0), (0, 1), (0, 2), (1, 0)].map(|(from, to)| Movement::new(from, to)).into(),
            phases: vec![phase("gGGg", [0.5, 1.0, 1.0, 0.5]), phase("GrrG", [1.0, 0.0, 0.0, 1.0])],
            roads_in: Vec::new(),
            roads_out: Vec::new(),
        }
    }

    #[test]
    fn the_strongest_green_does_not_tell_a_shared_lanes_phases_apart() {
        let green = lane_green(&shared_lane(), LaneGreen::Strongest);
        assert_eq!(green, [1.0, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn the_mean_tells_how_much_of_a_shared_lane_may_go() {
        let green = lane_green(&shared_lane(), LaneGreen::Mean);
        let expected = [2.5 / 3.0, 0.5, 0.5, 1.0, 1.0, 1.0 / 3.0, 1.0, 1.0, 0.0, 0.0];
        for (have, want) in green.iter().zip(expected) {
            assert!((have - want).abs() < 1e-6, "{green:?}");
        }
    }

    #[test]
    fn an_incoming_lane_is_as_long_as_what_is_seen_of_it() {
        let mut intersection = shared_lane();
        let stretch = |metres| Stretch { id: "more".to_owned(), length: 60.0, metres };
        intersection.incoming[0].behind.push(stretch(300.0));
        intersection.outgoing[0].beyond.push(stretch(0.0));
        let lengths: Vec<f32> = lane_constants(&intersection).chunks_exact(3).map(|lane| lane[2]).collect();
        assert_eq!(lengths, [1.2, 1.0, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn turning_round_counts_only_where_there_is_nothing_else() {
        let without = lane_green(&shared_lane(), LaneGreen::Mean);
        let mut intersection = shared_lane();
        // From the shared lane back to the west, with the left turns; the lane for left turns becomes one for turning round.
        intersection.movements.push(Movement { turnaround: true, ..Movement::new(0, 0) });
        intersection.movements[3].turnaround = true;
        for (phase, green) in intersection.phases.iter_mut().zip([0.5, 1.0]) {
            phase.green.push(green);
        }
        assert_eq!(lane_green(&intersection, LaneGreen::Mean), without);
    }

    #[test]
    fn a_lane_of_one_movement_is_the_same_in_both() {
        let mut intersection = shared_lane();
        intersection.movements = vec![Movement::new(0, 1), Movement::new(1, 0)];
        for phase in &mut intersection.phases {
            phase.green = vec![phase.green[1], phase.green[3]];
        }
        let strongest = lane_green(&intersection, LaneGreen::Strongest);
        assert_eq!(strongest, lane_green(&intersection, LaneGreen::Mean));
    }
}
