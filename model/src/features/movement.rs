//! Features of the `movement` form: what a phase's green lanes hold, in no order.

use super::{AgentSpec, COUNT_SCALE, LENGTH_SCALE, NUMBER_SCALE, Track};
use cross_sim::layout::Intersection;

/// Features of a phase: summed counts of its green incoming and outgoing lanes per band, whether it is the current
/// phase, and how many green lanes lead in and out.
pub(super) fn phase_features(bands: usize) -> usize {
    2 * bands + 3
}

/// Features of a lane token: counts per band, incoming, outgoing, length.
pub(super) fn lane_features(bands: usize) -> usize {
    bands + 3
}

/// `[phases, lanes]`: the strongest green that any movement from (incoming) or to (outgoing) the lane has in the phase.
pub(super) fn lane_green(intersection: &Intersection) -> Vec<f32> {
    let lanes = intersection.lanes();
    let mut green = vec![0.0f32; intersection.phases.len() * lanes];
    for (p, phase) in intersection.phases.iter().enumerate() {
        for (movement, &value) in intersection.movements.iter().zip(&phase.green) {
            for lane in [movement.incoming, intersection.incoming.len() + movement.outgoing] {
                let cell = &mut green[p * lanes + lane];
                *cell = cell.max(value);
            }
        }
    }
    green
}

/// `[lanes, 3]`: incoming, outgoing, length.
pub(super) fn lane_constants(intersection: &Intersection) -> Vec<f32> {
    let incoming = intersection.incoming.iter().flat_map(|lane| [1.0, 0.0, lane.length / LENGTH_SCALE]);
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
