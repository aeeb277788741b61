//! What an update learns from: the layouts of three networks, and made-up traffic on them.
//!
//! An update's cost depends on how many intersections there are and on their phases, movements and lanes, hardly on the
//! counts. So the layouts are the real scenarios' wherever these are installed, and the traffic is drawn at random.

use cross_config::{Config, EnvConfig};
use cross_sim::layout::{Intersection, Lane, Movement, NetworkLayout, Phase, Road, load_layout};
use cross_sim::scenario::Scenario;
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, RecurrentState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// A named network.
pub type Named = (String, Arc<NetworkLayout>);

/// Intersections that are alike.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// How many there are.
    pub agents: usize,
    /// Phases of each.
    pub phases: usize,
    /// Movements.
    pub movements: usize,
    /// Incoming lanes, and as many outgoing ones.
    pub lanes: usize,
}

/// The paper's three synthetic networks.
const SHAPES: [(&str, Shape); 3] = [
    ("grid4x4", Shape { agents: 16, phases: 8, movements: 36, lanes: 12 }),
    ("arterial4x4", Shape { agents: 16, phases: 5, movements: 12, lanes: 6 }),
    ("grid5x5", Shape { agents: 25, phases: 5, movements: 12, lanes: 12 }),
];

/// Layouts of the paper's three synthetic networks; `tell` hears of one that is not installed, in whose place a network of
/// the same numbers stands.
pub fn layouts(env: &EnvConfig, tell: &dyn Fn(&str)) -> Vec<Named> {
    let load = |&(name, shape): &(&str, Shape)| {
        let layout = installed(name, env).unwrap_or_else(|reason| {
            let Shape { agents, phases, movements, .. } = shape;
            tell(&format!(
                "{name} cannot be loaded ({reason}); a made-up network of {agents} intersections, {phases} phases and {movements} movements stands in"
            ));
            Arc::new(network(&[shape]))
        });
        (name.to_owned(), layout)
    };
    SHAPES.iter().map(load).collect()
}

fn installed(name: &str, env: &EnvConfig) -> Result<Arc<NetworkLayout>, String> {
    let scenario = Scenario::load(name).map_err(|error| error.to_string())?;
    load_layout(&scenario, env).map_err(|error| error.to_string())
}

/// A made-up network.
#[must_use]
pub fn network(shapes: &[Shape]) -> NetworkLayout {
    let all = shapes.iter().flat_map(|shape| std::iter::repeat_n(shape, shape.agents));
    NetworkLayout { intersections: all.enumerate().map(|(i, shape)| intersection(i, shape)).collect() }
}

/// Made-up networks of the three's numbers, for tests that must not depend on what is installed.
#[must_use]
pub fn made_up_layouts() -> Vec<Named> {
    SHAPES.iter().map(|(name, shape)| ((*name).to_owned(), Arc::new(network(&[*shape])))).collect()
}

fn intersection(number: usize, shape: &Shape) -> Intersection {
    let lane =
        |side: &str, i: usize| Lane::new(format!("j{number}_{side}{i}"), 100.0 + 10.0 * i as f32, 13.9);
    let road = |side: &str, i: usize| Road {
        id: format!("j{number}_{side}road{i}"),
        length: 150.0 + 20.0 * i as f32,
        speed: 13.9,
        lanes: shape.lanes.div_ceil(4),
        movements: shape.movements.div_ceil(4),
    };
    let movements =
        (0..shape.movements).map(|m| Movement::new(m % shape.lanes, (m / 2) % shape.lanes)).collect();
    let phases = (0..shape.phases)
        .map(|p| {
            let green = (0..shape.movements).map(|m| match (m % shape.phases == p, (m + p) % 7 == 0) {
                (true, _) => 1.0,
                (false, true) => 0.5,
                (false, false) => 0.0,
            });
            let green: Vec<f32> = green.collect();
            let letter = |&green: &f32| {
                if green > 0.5 {
                    'G'
                } else if green > 0.0 {
                    'g'
                } else {
                    'r'
                }
            };
            Phase { state: green.iter().map(letter).collect(), green }
        })
        .collect();
    Intersection {
        id: format!("j{number}"),
        position: (0.0, 0.0),
        incoming: (0..shape.lanes).map(|i| lane("in", i)).collect(),
        outgoing: (0..shape.lanes).map(|i| lane("out", i)).collect(),
        movements,
        phases,
        roads_in: (0..4).map(|i| road("in", i)).collect(),
        roads_out: (0..4).map(|i| road("out", i)).collect(),
    }
}

/// One episode of `steps` decisions on each network, cut off by time, drawn from a seed; `number` is the episode's.
#[must_use]
pub fn episodes(networks: &[Named], config: &Config, steps: u32, number: u64) -> Vec<Fragment> {
    let mut rng = ChaCha8Rng::seed_from_u64(number);
    networks.iter().map(|(name, layout)| episode(name, layout, config, steps, number, &mut rng)).collect()
}

fn episode(
    scenario: &str,
    layout: &NetworkLayout,
    config: &Config,
    steps: u32,
    number: u64,
    rng: &mut ChaCha8Rng,
) -> Fragment {
    let counts = (steps as usize + 1) * layout.lane_rows() * config.env.detection.bands();
    let decisions = steps as usize * layout.agents();
    let mut choices = |rows: usize| -> Vec<u8> {
        (0..rows)
            .flat_map(|_| &layout.intersections)
            .map(|junction| rng.random_range(0..junction.phases.len() as u8))
            .collect()
    };
    let actions = choices(steps as usize);
    let phases = choices(steps as usize + 1);
    let agents = layout.agents();
    let log_probs = (0..decisions)
        .map(|i| -(layout.intersections[i % agents].phases.len() as f32).ln() + rng.random_range(-0.1..0.1))
        .collect();
    Fragment {
        id: FragmentId { actor: "bench".to_owned(), session_epoch: 1, episode: number, sequence: 0 },
        scenario: scenario.to_owned(),
        layout_hash: layout.hash(),
        policy_version: 1,
        first_step: 0,
        steps,
        counts: (0..counts).map(|_| rng.random_range(0..12u16).saturating_sub(5)).collect(),
        phases,
        actions,
        log_probs,
        rewards: (0..decisions).map(|_| -f32::from(rng.random_range(0..20u8))).collect(),
        recurrent: RecurrentState::default(),
        end: FragmentEnd::Truncated,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_made_up_networks_have_the_papers_numbers() {
        let networks = made_up_layouts();
        assert_eq!(networks.iter().map(|(_, layout)| layout.agents()).sum::<usize>(), 57);
        let (_, grid) = &networks[0];
        assert_eq!((grid.intersections[0].phases.len(), grid.intersections[0].movements.len()), (8, 36));
    }

    #[test]
    fn an_episode_repeats_from_its_number() {
        let networks = made_up_layouts();
        let config = Config::default();
        assert_eq!(episodes(&networks, &config, 3, 7), episodes(&networks, &config, 3, 7));
        assert_ne!(episodes(&networks, &config, 3, 7), episodes(&networks, &config, 3, 8));
    }
}
