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

/// Appends one padded state `[max_movements * 5]`. With more than two bands, those of stopped vehicles are summed, and those of
/// moving ones.
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
        let (stopped, moving) = own.split_at(network.stopped_bands);
        let sum = |counts: &[u16]| counts.iter().map(|&count| f32::from(count)).sum::<f32>() / COUNT_SCALE;
        (sum(stopped), sum(moving))
    };
    for (m, &(incoming, outgoing)) in spec.movements.iter().enumerate() {
        let (stopped_in, moving_in) = lane(incoming);
        let (stopped_out, moving_out) = lane(outgoing);
        let cell = &mut states[at + m * STATE_FEATURES..at + (m + 1) * STATE_FEATURES];
        cell.copy_from_slice(&[green[m], stopped_in, stopped_out, moving_in, moving_out]);
    }
}

#[cfg(test)]
mod tests {
    use crate::features::{NetworkSpec, Track};
    use cross_config::{Config, Detection, Gfe};
    use cross_sim::layout::{Intersection, Lane, Movement, NetworkLayout, Phase, Road};

    fn crossing() -> NetworkLayout {
        let lane = |id: &str| Lane::new(id, 300.0, 13.9);
        let road = |id: &str| Road { id: id.to_owned(), length: 300.0, speed: 13.9, lanes: 1, movements: 1 };
        let phase = |state: &str, green| Phase { state: state.to_owned(), green: vec![green] };
        NetworkLayout {
            intersections: vec![Intersection {
                id: "j".to_owned(),
                position: (0.0, 0.0),
                incoming: vec![lane("in")],
                outgoing: vec![lane("out")],
                movements: vec![Movement::new(0, 0)],
                phases: vec![phase("r", 0.0), phase("G", 1.0)],
                roads_in: vec![road("a")],
                roads_out: vec![road("b")],
            }],
        }
    }

    /// The state's five numbers, under counts of the incoming lane and then of the outgoing one.
    fn state(detection: Detection, counts: &[u16]) -> Vec<f32> {
        let mut config = Config::default();
        config.env.detection = detection;
        config.model.gfe = Gfe::Paper;
        let network = NetworkSpec::new(&crossing(), &config.env, &config.model).unwrap();
        let mut seen = Track::default();
        network.look(counts, &[1], &mut seen);
        assert!(seen.states[5..].iter().all(|&padding| padding == 0.0));
        seen.states.truncate(5);
        seen.states
    }

    #[test]
    fn every_detection_tells_stopped_from_moving() {
        let expected = [1.0, 0.5, 0.7, 0.6, 0.8];
        assert_eq!(state(Detection::Paper, &[5, 6, 7, 8]), expected);
        assert_eq!(state(Detection::Default, &[5, 2, 4, 7, 8, 0]), expected);
        assert_eq!(state(Detection::Fine, &[2, 3, 1, 2, 0, 3, 7, 0, 0, 0, 4, 4]), expected);
    }
}
