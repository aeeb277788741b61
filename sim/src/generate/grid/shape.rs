//! What makes a grid irregular: roads that are left out, crossings that are not quite where they should be.

use super::GridOptions;
use super::roads::{Heading, Place, fringe, is_outside, neighbour, places};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeSet, HashMap, HashSet};

/// Fewest roads that meet at a crossing: with two there would be nothing to decide.
const FEWEST_ARMS: usize = 3;
/// Fewest dead ends: vehicles come from one and go to another.
const FEWEST_ENDS: usize = 2;

/// The shape of one grid. It follows from the options alone; a regular grid draws nothing.
#[derive(Debug)]
pub(crate) struct Shape {
    closed: HashSet<(Place, Place)>,
    moved: HashMap<Place, (f64, f64)>,
}

impl Shape {
    pub(crate) fn new(options: &GridOptions) -> Self {
        // A stream of its own, so that departures are drawn as if the grid were regular.
        let mut generator = ChaCha8Rng::seed_from_u64(options.seed);
        generator.set_stream(1);
        let mut moved = HashMap::new();
        if options.jitter > 0.0 {
            for place in places(options) {
                let mut metres = || generator.random_range(-options.jitter..=options.jitter);
                moved.insert(place, (metres(), metres()));
            }
        }
        let mut shape = Self { closed: HashSet::new(), moved };
        if options.closed > 0.0 {
            shape.close(options, &mut generator);
        }
        shape
    }

    /// Leaves out the asked share of roads, or as many as may go.
    fn close(&mut self, options: &GridOptions, generator: &mut ChaCha8Rng) {
        let mut roads: Vec<(Place, Heading)> = places(options)
            .flat_map(|place| [Heading::East, Heading::North].map(|heading| (place, heading)))
            .filter(|&(place, heading)| !is_outside(neighbour(place, heading), options))
            .chain(fringe(options))
            .collect();
        let asked = (options.closed * roads.len() as f64).round() as usize;
        roads.shuffle(generator);
        for (place, heading) in roads {
            if self.closed.len() == asked {
                break;
            }
            let ends = [place, neighbour(place, heading)];
            let road = key(ends);
            self.closed.insert(road);
            let crossings = ends.into_iter().filter(|&end| !is_outside(end, options));
            let arms_left = crossings.map(|crossing| self.arms(crossing)).min().unwrap_or_default();
            let ends_left = fringe(options).iter().filter(|&&(end, into)| self.is_open(end, into)).count();
            if arms_left < FEWEST_ARMS || ends_left < FEWEST_ENDS || !self.hangs_together(options) {
                self.closed.remove(&road);
            }
        }
    }

    /// Whether there is a road from a place that way.
    pub(crate) fn is_open(&self, from: Place, heading: Heading) -> bool {
        !self.closed.contains(&key([from, neighbour(from, heading)]))
    }

    /// The dead ends that are left, each with the heading that leads into the grid.
    pub(crate) fn ends(&self, options: &GridOptions) -> Vec<(Place, Heading)> {
        fringe(options).into_iter().filter(|&(end, into)| self.is_open(end, into)).collect()
    }

    /// How far a place lies from where a regular grid has it, metres east and north.
    pub(crate) fn moved(&self, place: Place) -> (f64, f64) {
        self.moved.get(&place).copied().unwrap_or_default()
    }

    /// Roads that meet at a crossing.
    pub(crate) fn arms(&self, crossing: Place) -> usize {
        Heading::APPROACHES.into_iter().filter(|&heading| self.is_open(crossing, heading)).count()
    }

    /// Whether every crossing can be reached from every other one; roads lead both ways.
    fn hangs_together(&self, options: &GridOptions) -> bool {
        let mut reached = BTreeSet::new();
        let mut next: Vec<Place> = places(options).take(1).collect();
        while let Some(place) = next.pop() {
            if reached.insert(place) {
                let ways = Heading::APPROACHES.into_iter().filter(|&heading| self.is_open(place, heading));
                next.extend(
                    ways.map(|heading| neighbour(place, heading)).filter(|&to| !is_outside(to, options)),
                );
            }
        }
        reached.len() == places(options).count()
    }
}

/// A road by its ends, whichever comes first.
fn key([one, other]: [Place; 2]) -> (Place, Place) {
    if one < other { (one, other) } else { (other, one) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_regular_grid_is_whole_and_in_place() {
        let options = GridOptions::default();
        let shape = Shape::new(&options);
        assert!(places(&options).all(|place| shape.arms(place) == 4 && shape.moved(place) == (0.0, 0.0)));
        assert_eq!(shape.ends(&options), fringe(&options));
    }

    #[test]
    fn the_asked_share_of_roads_goes_and_another_seed_takes_others() {
        let options =
            GridOptions { columns: 4, rows: 4, closed: 0.2, jitter: 10.0, ..GridOptions::default() };
        let shape = Shape::new(&options);
        // 24 roads between crossings and 16 to dead ends.
        assert_eq!(shape.closed.len(), 8);
        assert!(places(&options).all(|place| shape.arms(place) >= 3));
        assert!(places(&options).any(|place| shape.arms(place) == 3));
        assert_eq!(shape.closed, Shape::new(&options).closed);
        assert_ne!(shape.closed, Shape::new(&GridOptions { seed: 1, ..options }).closed);
    }

    #[test]
    fn one_crossing_keeps_three_arms_whatever_is_asked() {
        let options = GridOptions { columns: 1, rows: 1, closed: 0.5, ..GridOptions::default() };
        assert_eq!(Shape::new(&options).closed.len(), 1);
    }
}
