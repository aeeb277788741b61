//! The topology vector (paper, section III-C): intersection type, phase configuration, and the roads.

use super::{LENGTH_SCALE, MAX_ROADS, NUMBER_SCALE, SPEED_SCALE};
use cross_sim::layout::{Intersection, Road};

const IN_FEATURES: usize = 4;
const OUT_FEATURES: usize = 3;
/// At most three approaches, four, five or more.
const TYPES: usize = 3;

fn one_hots(max_phases: usize) -> usize {
    // Phase counts from 2 to the limit.
    TYPES + max_phases - 1
}

/// Length of the `paper` form: roads one after another, padded to [`MAX_ROADS`].
pub(super) fn ordered_size(max_phases: usize) -> usize {
    one_hots(max_phases) + MAX_ROADS * (IN_FEATURES + OUT_FEATURES)
}

/// Length of the `movement` form: mean and maximum over the roads, which no order of roads can change.
pub(super) fn pooled_size(max_phases: usize) -> usize {
    one_hots(max_phases) + 2 * (IN_FEATURES + OUT_FEATURES)
}

fn push_one_hots(intersection: &Intersection, max_phases: usize, out: &mut Vec<f32>) {
    let approaches = intersection.roads_in.len();
    let kind = approaches.clamp(3, 5) - 3;
    out.extend((0..TYPES).map(|t| f32::from(u8::from(t == kind))));
    let phases = intersection.phases.len();
    out.extend((2..=max_phases).map(|count| f32::from(u8::from(count == phases))));
}

fn road(road: &Road) -> [f32; IN_FEATURES] {
    [
        road.length / LENGTH_SCALE,
        road.speed / SPEED_SCALE,
        road.lanes as f32 / NUMBER_SCALE,
        road.movements as f32 / NUMBER_SCALE,
    ]
}

/// The caller has refused more roads than [`MAX_ROADS`].
pub(super) fn ordered(intersection: &Intersection, max_phases: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(ordered_size(max_phases));
    push_one_hots(intersection, max_phases, &mut out);
    for (roads, features) in [(&intersection.roads_in, IN_FEATURES), (&intersection.roads_out, OUT_FEATURES)]
    {
        let start = out.len();
        for own in roads.iter().take(MAX_ROADS) {
            out.extend_from_slice(&road(own)[..features]);
        }
        out.resize(start + MAX_ROADS * features, 0.0);
    }
    out
}

pub(super) fn pooled(intersection: &Intersection, max_phases: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(pooled_size(max_phases));
    push_one_hots(intersection, max_phases, &mut out);
    for (roads, features) in [(&intersection.roads_in, IN_FEATURES), (&intersection.roads_out, OUT_FEATURES)]
    {
        let count = roads.len().max(1) as f32;
        for feature in 0..features {
            out.push(roads.iter().map(|own| road(own)[feature]).sum::<f32>() / count);
        }
        for feature in 0..features {
            out.push(roads.iter().map(|own| road(own)[feature]).fold(0.0, f32::max));
        }
    }
    out
}
