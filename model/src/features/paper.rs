//! Features of the `paper` form: five numbers per movement in link order, padded.

use super::{AgentSpec, COUNT_SCALE, NetworkSpec};
use cross_sim::layout::Intersection;

/// Activation, stopped in, stopped out, moving in, moving out (paper, equation 1).
pub(super) const STATE_FEATURES: usize = 5;

/// `[phases, max_movements]`.
pub(super) fn phase_state(intersection: &Intersection, max_movements: usize) -> Vec<f32> {
    let mut state = vec![0.0; intersection.phases.len() * max_movements];
    for (row, phase) in state.chunks_mut(max_movements).zip(&intersection.phases) {
        row[..phase.green.len()].copy_from_slice(&phase.green);
    }
    state
}

/// Appends one padded state `[max_movements * 5]`. With more than two bands, all moving bands are summed.
pub(super) fn push_state(
    spec: &AgentSpec,
    network: &NetworkSpec,
    counts: &[u16],
    current: usize,
    states: &mut Vec<f32>,
) {
    let at = states.len();
    states.resize(at + network.max_movements * STATE_FEATURES, 0.0);
    let green = &spec.phase_state[current * network.max_movements..];
    let lane = |row: usize| {
        let own = &counts[row * network.bands..(row + 1) * network.bands];
        let moving: u32 = own[1..].iter().map(|&count| u32::from(count)).sum();
        (f32::from(own[0]) / COUNT_SCALE, moving as f32 / COUNT_SCALE)
    };
    for (m, &(incoming, outgoing)) in spec.movements.iter().enumerate() {
        let (stopped_in, moving_in) = lane(incoming);
        let (stopped_out, moving_out) = lane(outgoing);
        let cell = &mut states[at + m * STATE_FEATURES..at + (m + 1) * STATE_FEATURES];
        cell.copy_from_slice(&[green[m], stopped_in, stopped_out, moving_in, moving_out]);
    }
}
