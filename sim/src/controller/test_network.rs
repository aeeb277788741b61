//! A hand-made network with two intersections, for the controllers' tests.

use super::ControllerView;
use crate::lanes::LaneTable;
use crate::layout::{Intersection, Lane, Movement, NetworkLayout, Phase};
use crate::trajectory::Observation;

const LENGTH: f32 = 200.0;

pub(super) struct TestNetwork {
    pub(super) layout: NetworkLayout,
    pub(super) observation: Observation,
    lanes: LaneTable,
}

impl TestNetwork {
    /// Agent `a`: links north->south, west->east, side->east and side->south; phases north, west, side, the first of
    /// its two links permissive. Agent `b`: links north->south, east->west, one phase for each.
    pub(super) fn crossing() -> Self {
        let layout = NetworkLayout {
            intersections: vec![
                intersection(
                    "a",
                    &["a_north", "a_west", "a_side"],
                    &["a_south_out", "a_east_out"],
                    &[(0, 0), (1, 1), (2, 1), (2, 0)],
                    &["Grrr", "rGrr", "rrgG"],
                ),
                intersection(
                    "b",
                    &["b_north", "b_east"],
                    &["b_south_out", "b_west_out"],
                    &[(0, 0), (1, 1)],
                    &["Gr", "rG"],
                ),
            ],
        };
        let lanes = LaneTable::new(&layout, 50.0);
        let observation = Observation { counts: vec![0; layout.lane_rows() * 2], phases: vec![0; 2] };
        Self { layout, observation, lanes }
    }

    /// Puts stopped vehicles so many metres before the end of a lane.
    pub(super) fn stopped(&mut self, lane: &str, vehicles: usize, before_end: f64) -> &mut Self {
        self.put(lane, vehicles, before_end, 0.0)
    }

    /// Puts moving vehicles so many metres before the end of a lane.
    pub(super) fn moving(&mut self, lane: &str, vehicles: usize, before_end: f64) -> &mut Self {
        self.put(lane, vehicles, before_end, 5.0)
    }

    fn put(&mut self, lane: &str, vehicles: usize, before_end: f64, speed: f64) -> &mut Self {
        for _ in 0..vehicles {
            self.lanes.add(lane, f64::from(LENGTH) - before_end, speed);
        }
        self
    }

    pub(super) fn view(&self) -> ControllerView<'_> {
        ControllerView {
            layout: &self.layout,
            observation: &self.observation,
            lanes: &self.lanes,
            step: 0,
            time: 0.0,
        }
    }
}

fn intersection(
    id: &str,
    incoming: &[&str],
    outgoing: &[&str],
    links: &[(usize, usize)],
    states: &[&str],
) -> Intersection {
    let lane = |id: &&str| Lane::new(*id, LENGTH, 10.0);
    Intersection {
        id: id.to_owned(),
        position: (0.0, 0.0),
        incoming: incoming.iter().map(lane).collect(),
        outgoing: outgoing.iter().map(lane).collect(),
        movements: links.iter().map(|&(incoming, outgoing)| Movement::new(incoming, outgoing)).collect(),
        phases: states
            .iter()
            .map(|state| Phase {
                state: (*state).to_owned(),
                green: state
                    .chars()
                    .map(|letter| match letter {
                        'G' => 1.0,
                        'g' => 0.5,
                        _ => 0.0,
                    })
                    .collect(),
            })
            .collect(),
        roads_in: Vec::new(),
        roads_out: Vec::new(),
    }
}
