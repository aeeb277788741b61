//! Where vehicles stand: the queue of each road and each intersection, on the network's drawing.

use super::figure::{Figure, points};
use super::number::{self, pixel};
use cross_sim::evaluate::{Details, NetworkDrawing};
use maud::{Markup, html};
use std::collections::HashMap;

/// Shades from nothing to the most.
const SHADES: usize = 7;
/// Power by which the bounds of the shades grow: 1 would be evenly.
const GROWTH: f64 = 1.5;
const WIDTH: f64 = 340.0;
const MARGIN: f64 = 8.0;
/// A network much longer than wide is not drawn higher than this.
const MAX_HEIGHT: f64 = 400.0;

/// Means over the seeds of one evaluation, by the places of [`NetworkDrawing`].
pub(super) struct Queues {
    /// Stopped vehicles per incoming lane of each signal.
    signals: Vec<f64>,
    /// Stopped vehicles per lane of each edge that leads to a signal.
    edges: HashMap<String, f64>,
}

impl Queues {
    /// Of an evaluation; seeds that tell of other intersections than the drawing are left out.
    pub(super) fn of(details: &Details) -> Self {
        let signals = &details.network.signals;
        let fits = details.seeds.iter().filter(|seed| seed.intersections.len() == signals.len());
        let seeds: Vec<_> = fits.collect();
        let share = 1.0 / seeds.len().max(1) as f64;
        let mut queues = Self { signals: vec![0.0; signals.len()], edges: HashMap::new() };
        for seed in seeds {
            for (sum, intersection) in queues.signals.iter_mut().zip(&seed.intersections) {
                *sum += intersection.queue_length * share;
                for road in &intersection.roads {
                    *queues.edges.entry(road.edge.clone()).or_default() += road.queue_length * share;
                }
            }
        }
        queues
    }

    fn values(&self) -> impl Iterator<Item = f64> {
        self.signals.iter().chain(self.edges.values()).copied()
    }

    /// The intersection with the longest queue.
    fn worst<'n>(&self, network: &'n NetworkDrawing) -> Option<(&'n str, f64)> {
        let named = network.signals.iter().zip(&self.signals);
        let worst = named.max_by(|a, b| a.1.total_cmp(b.1))?;
        Some((&worst.0.id, *worst.1))
    }
}

/// The shades that all maps of a scenario share. Each is wider than the one before: queues differ by more than shades could
/// tell if all were equally wide, and the short ones are most.
pub(super) struct Shades {
    most: f64,
}

impl Shades {
    pub(super) fn over<'q>(queues: impl IntoIterator<Item = &'q Queues>) -> Self {
        let most = queues.into_iter().flat_map(Queues::values).fold(0.0, f64::max);
        // A map without any queue is one shade, whatever the scale.
        Self { most: if most > 0.0 && most.is_finite() { most } else { 1.0 } }
    }

    /// Where a shade begins.
    fn bound(&self, shade: usize) -> f64 {
        self.most * (shade as f64 / SHADES as f64).powf(GROWTH)
    }

    fn class(&self, value: f64) -> String {
        let shade = (1..SHADES).rev().find(|&shade| value >= self.bound(shade)).unwrap_or(0);
        format!("h{shade}")
    }

    /// What each shade means.
    pub(super) fn legend(&self) -> Markup {
        let bound = |shade: usize| number::brief(self.bound(shade));
        html! {
            p .shades {
                span .note { "stopped vehicles per lane, mean over the episode" }
                @for shade in 0..SHADES {
                    span .shade { span .swatch .(format!("h{shade}")) {} (bound(shade)) "–" (bound(shade + 1)) }
                }
            }
        }
    }
}

/// One map.
pub(super) struct HeatMap<'a> {
    pub(super) id: &'a str,
    pub(super) title: &'a str,
    pub(super) network: &'a NetworkDrawing,
    pub(super) queues: &'a Queues,
    pub(super) shades: &'a Shades,
}

impl HeatMap<'_> {
    pub(super) fn draw(&self) -> Markup {
        let view = View::of(self.network);
        let spacing = spacing(self.network, &view);
        let radius = (spacing * 0.17).clamp(3.5, 13.0);
        let width = (spacing * 0.07).clamp(1.8, 6.0);
        let shown = |value: f64| number::short(value);
        let content = html! {
            g .roads stroke-width=(pixel(width)) {
                @for edge in self.network.edges.iter().filter(|edge| edge.shape.len() > 1) {
                    @let line = points(beside(&view.line(&edge.shape), width / 2.0 + 0.6));
                    @match self.queues.edges.get(&edge.id) {
                        Some(&queue) => polyline .(self.shades.class(queue)) points=(line) {
                            title { "road " (edge.id) ": " (shown(queue)) " stopped per lane" }
                        },
                        None => polyline .plain points=(line) {},
                    }
                }
            }
            g .signals {
                @for (signal, &queue) in self.network.signals.iter().zip(&self.queues.signals) {
                    @let (x, y) = view.at([signal.x, signal.y]);
                    circle .(self.shades.class(queue)) cx=(pixel(x)) cy=(pixel(y)) r=(pixel(radius)) {
                        title { (signal.id) ": " (shown(queue)) " stopped per incoming lane" }
                    }
                }
            }
        };
        let worst = self.queues.worst(self.network);
        let note =
            worst.map_or_else(String::new, |(id, queue)| format!("longest queue: {id}, {}", shown(queue)));
        let description = format!(
            "Map of {} intersections, each shaded by its mean queue. {note}.",
            self.network.signals.len()
        );
        Figure {
            id: self.id,
            title: self.title,
            note: &note,
            description: &description,
            size: (WIDTH, view.height),
            class: "map",
            legend: Markup::default(),
        }
        .draw(&content)
    }
}

/// From metres to pixels, north up.
struct View {
    scale: f64,
    left: f64,
    top: f64,
    origin: (f64, f64),
    height: f64,
}

impl View {
    fn of(network: &NetworkDrawing) -> Self {
        let signals = network.signals.iter().map(|signal| [signal.x, signal.y]);
        let all = network.edges.iter().flat_map(|edge| edge.shape.iter().copied()).chain(signals);
        let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for [x, y] in all.filter(|place| place.iter().all(|value| value.is_finite())) {
            bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x), bounds[3].max(y)];
        }
        let [west, south, east, north] = if bounds[0] <= bounds[2] { bounds } else { [0.0; 4] };
        // A single junction has no extent.
        let (wide, high) = ((east - west).max(1.0), (north - south).max(1.0));
        let scale = ((WIDTH - 2.0 * MARGIN) / wide).min((MAX_HEIGHT - 2.0 * MARGIN) / high);
        Self {
            scale,
            left: (WIDTH - wide * scale) / 2.0,
            top: MARGIN,
            origin: (west, north),
            height: high * scale + 2.0 * MARGIN,
        }
    }

    fn at(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        (self.left + (x - self.origin.0) * self.scale, self.top + (self.origin.1 - y) * self.scale)
    }

    fn line(&self, shape: &[[f64; 2]]) -> Vec<(f64, f64)> {
        shape.iter().map(|&place| self.at(place)).collect()
    }
}

/// Distance between neighbouring signals, pixels: a typical one.
fn spacing(network: &NetworkDrawing, view: &View) -> f64 {
    let places: Vec<_> = network.signals.iter().map(|signal| view.at([signal.x, signal.y])).collect();
    let nearest = |own: usize| {
        let others = places.iter().enumerate().filter(|(other, _)| *other != own);
        let distance = |&(x, y): &(f64, f64)| (x - places[own].0).hypot(y - places[own].1);
        others.map(|(_, place)| distance(place)).fold(WIDTH / 4.0, f64::min)
    };
    let mut distances: Vec<f64> = (0..places.len()).map(nearest).collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied().unwrap_or(WIDTH / 4.0)
}

/// The line moved to its right by so many pixels, so that both directions of a street are seen.
fn beside(line: &[(f64, f64)], aside: f64) -> Vec<(f64, f64)> {
    let direction = |from: (f64, f64), to: (f64, f64)| {
        let (x, y) = (to.0 - from.0, to.1 - from.1);
        let length = x.hypot(y).max(1e-9);
        (x / length, y / length)
    };
    let last = line.len().saturating_sub(1);
    let moved = |place: usize| {
        let before = direction(line[place.saturating_sub(1)], line[place]);
        let after = direction(line[place], line[(place + 1).min(last)]);
        let (x, y) = (before.0 + after.0, before.1 + after.1);
        let length = x.hypot(y).max(1e-9);
        // Pixels grow downwards, so that the right of (x, y) is (-y, x).
        (line[place].0 - y / length * aside, line[place].1 + x / length * aside)
    };
    (0..line.len()).map(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use cross_sim::evaluate::{EdgeDrawing, SignalDrawing};

    fn network() -> NetworkDrawing {
        let signal = |id: &str, x: f64| SignalDrawing { id: id.to_owned(), x, y: 100.0 };
        let edge =
            |id: &str, shape: &[[f64; 2]]| EdgeDrawing { id: id.to_owned(), lanes: 2, shape: shape.to_vec() };
        NetworkDrawing {
            edges: vec![
                edge("east", &[[0.0, 100.0], [300.0, 100.0]]),
                edge("out", &[[300.0, 100.0], [300.0, 0.0]]),
                edge("dot", &[]),
            ],
            signals: vec![signal("A<0", 0.0), signal("B0", 300.0)],
        }
    }

    #[test]
    fn every_signal_and_road_is_drawn_once_and_shaded_by_its_queue() {
        let network = network();
        let queues = Queues { signals: vec![0.0, 7.0], edges: HashMap::from([("east".to_owned(), 3.5)]) };
        let shades = Shades::over([&queues]);
        let text = HeatMap { id: "m", title: "greedy", network: &network, queues: &queues, shades: &shades }
            .draw()
            .into_string();
        assert_eq!(text.matches("<circle").count(), 2);
        assert_eq!(text.matches("<polyline").count(), 2);
        assert!(
            text.contains("class=\"h0\"") && text.contains("class=\"h6\"") && text.contains("class=\"h4\""),
            "{text}"
        );
        assert!(text.contains("A&lt;0: 0 stopped") && text.contains("longest queue: B0, 7.00"), "{text}");
        assert_eq!(shades.legend().into_string().matches("swatch").count(), SHADES);
    }

    #[test]
    fn north_is_up_and_everything_inside() {
        let network = network();
        let view = View::of(&network);
        let (signal, south) = (view.at([300.0, 100.0]), view.at([300.0, 0.0]));
        assert!(signal.1 < south.1 && south.1 <= view.height && signal.0 <= WIDTH);
        let empty = View::of(&NetworkDrawing::default());
        assert!(empty.height.is_finite());
    }

    #[test]
    fn both_directions_of_a_street_are_seen() {
        let east = beside(&[(0.0, 0.0), (10.0, 0.0)], 2.0);
        let west = beside(&[(10.0, 0.0), (0.0, 0.0)], 2.0);
        assert_eq!(east, [(0.0, 2.0), (10.0, 2.0)]);
        assert_eq!(west, [(10.0, -2.0), (0.0, -2.0)]);
        assert!(beside(&[], 2.0).is_empty());
    }
}
