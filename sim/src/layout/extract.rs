//! From a net to the intersections that agents control.

use super::stretches::Street;
use super::{Intersection, Lane, LayoutError, Movement, NetworkLayout, Phase, Road};
use crate::net::{Net, TrafficLight};
use cross_config::EnvConfig;
use std::collections::HashSet;

/// A traffic light that keeps its own program because it leaves nothing to decide.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FixedSignal {
    /// SUMO traffic light id.
    pub id: String,
    /// Number of its distinct green phases: 0 or 1, or more where it controls no vehicles.
    pub phases: usize,
    /// Number of vehicle movements it controls.
    pub movements: usize,
}

impl NetworkLayout {
    /// The agents of a net, in its order of traffic lights.
    ///
    /// A traffic light with fewer than two green phases, or without vehicle movements, is no agent: it keeps its own
    /// program ([`NetworkLayout::fixed_signals`] lists such lights).
    ///
    /// # Errors
    /// [`LayoutError`] if an intersection exceeds a limit of `env`, if signal states and links do not fit together, or
    /// if no agent is left.
    pub fn from_net(net: &Net, env: &EnvConfig) -> Result<Self, LayoutError> {
        if net.traffic_lights.is_empty() {
            return Err(LayoutError::NoSignals { path: net.path.clone() });
        }
        let street = Street::new(net);
        let mut intersections = Vec::new();
        for light in &net.traffic_lights {
            let states = green_states(light);
            check_states(net, light, &states)?;
            if is_fixed(light, &states) {
                continue;
            }
            check_limits(net, light, &states, env)?;
            intersections.push(intersection(net, light, &states, &street));
        }
        if intersections.is_empty() {
            return Err(LayoutError::NoAgents { path: net.path.clone(), lights: net.traffic_lights.len() });
        }
        Ok(Self { intersections })
    }

    /// The traffic lights that [`NetworkLayout::from_net`] leaves to their own programs.
    #[must_use]
    pub fn fixed_signals(net: &Net) -> Vec<FixedSignal> {
        let lights = net.traffic_lights.iter().map(|light| (light, green_states(light)));
        lights
            .filter(|(light, states)| is_fixed(light, states))
            .map(|(light, states)| FixedSignal {
                id: light.id.clone(),
                phases: states.len(),
                movements: light.links.len(),
            })
            .collect()
    }
}

fn is_fixed(light: &TrafficLight, states: &[&str]) -> bool {
    states.len() < 2 || light.links.is_empty()
}

/// Distinct green states in program order. A state with yellow (`y`, or `u` before green) is a transition, one without
/// any green is all-red; neither is a choice.
fn green_states(light: &TrafficLight) -> Vec<&str> {
    let mut seen = HashSet::new();
    let states = light.program().map(|program| program.states.as_slice()).unwrap_or_default();
    states
        .iter()
        .map(String::as_str)
        .filter(|state| state.contains(['G', 'g']) && !state.contains(['y', 'u']))
        .filter(|state| seen.insert(*state))
        .collect()
}

fn check_states(net: &Net, light: &TrafficLight, states: &[&str]) -> Result<(), LayoutError> {
    let Some(&first) = states.first() else { return Ok(()) };
    if let Some(other) = states.iter().find(|state| state.len() != first.len()) {
        let lengths = (first.len(), other.len());
        return Err(LayoutError::UnevenStates { path: net.path.clone(), light: light.id.clone(), lengths });
    }
    match light.links.last() {
        Some(link) if link.index >= first.len() => Err(LayoutError::ShortState {
            path: net.path.clone(),
            light: light.id.clone(),
            index: link.index,
            state: first.to_owned(),
        }),
        _ => Ok(()),
    }
}

fn check_limits(
    net: &Net,
    light: &TrafficLight,
    states: &[&str],
    env: &EnvConfig,
) -> Result<(), LayoutError> {
    let (path, intersection) = (net.path.clone(), light.id.clone());
    let movements = light.links.len();
    if movements > env.max_movements {
        return Err(LayoutError::TooManyMovements {
            path,
            intersection,
            movements,
            limit: env.max_movements,
        });
    }
    let phases = states.len();
    // Phases travel and are stored as one byte, whatever the configuration allows.
    let limit = env.max_phases.min(usize::from(u8::MAX));
    if phases > limit {
        return Err(LayoutError::TooManyPhases { path, intersection, phases, limit });
    }
    Ok(())
}

fn intersection(net: &Net, light: &TrafficLight, states: &[&str], street: &Street) -> Intersection {
    let mut incoming = Distinct::default();
    let mut outgoing = Distinct::default();
    let mut edges_in = Distinct::default();
    let mut edges_out = Distinct::default();
    let mut movements = Vec::with_capacity(light.links.len());
    for link in &light.links {
        let (from, to) = (incoming.index(link.from), outgoing.index(link.to));
        movements.push(Movement { turnaround: link.turnaround, ..Movement::new(from, to) });
        edges_in.index(link.from.0);
        edges_out.index(link.to.0);
    }
    let green = |state: &str| {
        let letters = state.as_bytes();
        light.links.iter().map(|link| greenness(letters[link.index])).collect()
    };
    Intersection {
        id: light.id.clone(),
        position: position(net, light, &edges_in.0),
        incoming: incoming
            .0
            .iter()
            .map(|&at| Lane { behind: street.behind(net, at), ..lane(net, at) })
            .collect(),
        outgoing: outgoing
            .0
            .iter()
            .map(|&at| Lane { beyond: street.beyond(net, at), ..lane(net, at) })
            .collect(),
        movements,
        phases: states
            .iter()
            .map(|state| Phase { state: (*state).to_owned(), green: green(state) })
            .collect(),
        roads_in: edges_in
            .0
            .iter()
            .map(|&edge| road(net, edge, light.links.iter().filter(|link| link.from.0 == edge).count()))
            .collect(),
        roads_out: edges_out
            .0
            .iter()
            .map(|&edge| road(net, edge, light.links.iter().filter(|link| link.to.0 == edge).count()))
            .collect(),
    }
}

/// Protected green 1, permissive green 0.5, everything else (also `s`, right turn on red after a stop) 0.
fn greenness(letter: u8) -> f32 {
    match letter {
        b'G' => 1.0,
        b'g' => 0.5,
        _ => 0.0,
    }
}

/// Centre of the junctions that the light controls: those its incoming edges lead to. A light that joins several
/// junctions bears the name of none of them.
fn position(net: &Net, light: &TrafficLight, edges_in: &[usize]) -> (f32, f32) {
    let mut seen = HashSet::new();
    let controlled = edges_in.iter().map(|&edge| net.edges[edge].to.as_str()).filter(|&id| seen.insert(id));
    let mut positions: Vec<_> = controlled.filter_map(|id| net.junctions.get(id)).collect();
    if positions.is_empty() {
        positions.extend(net.junctions.get(&light.id));
    }
    let count = positions.len().max(1) as f64;
    let x = positions.iter().map(|junction| junction.x).sum::<f64>() / count;
    let y = positions.iter().map(|junction| junction.y).sum::<f64>() / count;
    (x as f32, y as f32)
}

fn lane(net: &Net, at: (usize, usize)) -> Lane {
    let lane = net.lane(at);
    Lane::new(lane.id.clone(), lane.length as f32, lane.speed as f32)
}

fn road(net: &Net, edge: usize, movements: usize) -> Road {
    let edge = &net.edges[edge];
    let lanes = edge.lanes.len();
    Road {
        id: edge.id.clone(),
        length: (edge.lanes.iter().map(|lane| lane.length).sum::<f64>() / lanes.max(1) as f64) as f32,
        // Lanes of one road rarely differ; the fastest is the road's limit.
        speed: edge.lanes.iter().map(|lane| lane.speed).fold(0.0, f64::max) as f32,
        lanes,
        movements,
    }
}

/// Values in order of first appearance.
struct Distinct<T>(Vec<T>);

impl<T> Default for Distinct<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T: PartialEq> Distinct<T> {
    fn index(&mut self, value: T) -> usize {
        // An intersection has a few dozen lanes: a search is cheaper than a map.
        if let Some(index) = self.0.iter().position(|known| *known == value) {
            return index;
        }
        self.0.push(value);
        self.0.len() - 1
    }
}
