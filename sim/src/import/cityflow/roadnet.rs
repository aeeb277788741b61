//! CityFlow's road network file, read and checked.

use super::{ImportError, input};
use serde::Deserialize;
use std::collections::{HashMap, HashSet};
use std::io::Read;
use std::path::Path;

/// A city of ten thousand intersections has 300 MB; beyond that a file is not one.
const MAX_BYTES: u64 = 512 << 20;
const MAX_LANES: usize = 16;
const MAX_PHASES: usize = 255;

#[derive(Debug, Deserialize)]
pub(super) struct RoadNet {
    pub(super) intersections: Vec<Intersection>,
    pub(super) roads: Vec<Road>,
    #[serde(skip)]
    intersection_of_id: HashMap<String, usize>,
    #[serde(skip)]
    road_of_id: HashMap<String, usize>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Intersection {
    pub(super) id: String,
    pub(super) point: Point,
    #[serde(default)]
    pub(super) road_links: Vec<RoadLink>,
    #[serde(default)]
    pub(super) traffic_light: Option<TrafficLight>,
    /// A place where vehicles come from and go to, never signalised.
    #[serde(default)]
    pub(super) r#virtual: bool,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct RoadLink {
    #[serde(default, rename = "type")]
    pub(super) turn: Turn,
    pub(super) start_road: String,
    pub(super) end_road: String,
    pub(super) lane_links: Vec<LaneLink>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Deserialize)]
pub(super) enum Turn {
    #[serde(rename = "turn_right")]
    Right,
    #[default]
    #[serde(rename = "go_straight")]
    Straight,
    #[serde(rename = "turn_left")]
    Left,
    #[serde(rename = "turn_u", alias = "turn_around", alias = "u_turn")]
    Around,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct LaneLink {
    pub(super) start_lane_index: i64,
    pub(super) end_lane_index: i64,
}

#[derive(Debug, Deserialize)]
pub(super) struct TrafficLight {
    #[serde(default)]
    pub(super) lightphases: Vec<LightPhase>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct LightPhase {
    pub(super) time: f64,
    pub(super) available_road_links: Vec<i64>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Road {
    pub(super) id: String,
    pub(super) points: Vec<Point>,
    /// From the innermost outwards.
    pub(super) lanes: Vec<Lane>,
    pub(super) start_intersection: String,
    pub(super) end_intersection: String,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Lane {
    #[serde(default)]
    pub(super) width: Option<f64>,
    pub(super) max_speed: f64,
}

impl RoadNet {
    /// Reads and checks a file.
    pub(super) fn read(path: &Path) -> Result<Self, ImportError> {
        Self::parse(input::open(path, MAX_BYTES)?, path)
    }

    /// Reads and checks a text; `path` is how errors call it.
    pub(super) fn parse(text: impl Read, path: &Path) -> Result<Self, ImportError> {
        let mut net: Self =
            serde_json::from_reader(text).map_err(|error| ImportError::json(path, "roadnet", &error))?;
        net.index().and_then(|()| net.check()).map_err(|what| ImportError::content(path, what))?;
        Ok(net)
    }

    pub(super) fn road(&self, id: &str) -> Option<(usize, &Road)> {
        self.road_of_id.get(id).map(|&index| (index, &self.roads[index]))
    }

    fn index(&mut self) -> Result<(), String> {
        for (index, intersection) in self.intersections.iter().enumerate() {
            check_id("intersection", &intersection.id)?;
            if self.intersection_of_id.insert(intersection.id.clone(), index).is_some() {
                return Err(format!("there are two intersections {:?}", intersection.id));
            }
        }
        for (index, road) in self.roads.iter().enumerate() {
            check_id("road", &road.id)?;
            if self.road_of_id.insert(road.id.clone(), index).is_some() {
                return Err(format!("there are two roads {:?}", road.id));
            }
        }
        Ok(())
    }

    fn check(&self) -> Result<(), String> {
        if self.roads.is_empty() {
            return Err("it has no roads".to_owned());
        }
        for intersection in &self.intersections {
            if !is_place(intersection.point) {
                return Err(format!("intersection {:?} is at no place on earth", intersection.id));
            }
        }
        self.roads.iter().try_for_each(|road| self.check_road(road))?;
        self.intersections.iter().try_for_each(|intersection| self.check_intersection(intersection))
    }

    fn check_road(&self, road: &Road) -> Result<(), String> {
        let id = &road.id;
        for end in [&road.start_intersection, &road.end_intersection] {
            if !self.intersection_of_id.contains_key(end) {
                return Err(format!("road {id:?} ends at intersection {end:?}, which is missing"));
            }
        }
        if road.start_intersection == road.end_intersection {
            return Err(format!("road {id:?} starts and ends at {:?}", road.start_intersection));
        }
        if road.points.len() < 2 || !road.points.iter().copied().all(is_place) {
            return Err(format!("road {id:?} needs at least two points, all of them places on earth"));
        }
        if road.lanes.is_empty() || road.lanes.len() > MAX_LANES {
            return Err(format!("road {id:?} has {} lanes but must have 1 to {MAX_LANES}", road.lanes.len()));
        }
        // Faster than any car, and slower than would ever arrive.
        match road.lanes.iter().find(|lane| !(0.1..=200.0).contains(&lane.max_speed)) {
            Some(lane) => Err(format!(
                "road {id:?} has a lane with maxSpeed {} m/s, which cannot be driven",
                lane.max_speed
            )),
            None => Ok(()),
        }
    }

    fn check_intersection(&self, intersection: &Intersection) -> Result<(), String> {
        let id = &intersection.id;
        for (number, link) in intersection.road_links.iter().enumerate() {
            let missing = |road: &str| {
                format!("roadLink {number} of intersection {id:?} names road {road:?}, which is missing")
            };
            let (_, start) = self.road(&link.start_road).ok_or_else(|| missing(&link.start_road))?;
            let (_, end) = self.road(&link.end_road).ok_or_else(|| missing(&link.end_road))?;
            if start.end_intersection != *id || end.start_intersection != *id {
                return Err(format!(
                    "roadLink {number} of intersection {id:?} goes from road {:?} to road {:?}, which do not meet there",
                    start.id, end.id
                ));
            }
            for lane_link in &link.lane_links {
                for (road, lane) in [(start, lane_link.start_lane_index), (end, lane_link.end_lane_index)] {
                    if usize::try_from(lane).map_or(true, |lane| lane >= road.lanes.len()) {
                        return Err(format!(
                            "roadLink {number} of intersection {id:?} names lane {lane} of road {:?}, which has {} lanes",
                            road.id,
                            road.lanes.len()
                        ));
                    }
                }
            }
        }
        let phases = intersection.traffic_light.iter().flat_map(|light| &light.lightphases);
        if phases.clone().count() > MAX_PHASES {
            return Err(format!("intersection {id:?} has more than {MAX_PHASES} phases"));
        }
        for (number, phase) in phases.enumerate() {
            if !(0.0..=86_400.0).contains(&phase.time) {
                return Err(format!(
                    "phase {number} of intersection {id:?} lasts {} s, which cannot be",
                    phase.time
                ));
            }
            let count = intersection.road_links.len();
            let unknown = |link: &&i64| usize::try_from(**link).map_or(true, |link| link >= count);
            if let Some(link) = phase.available_road_links.iter().find(unknown) {
                return Err(format!(
                    "phase {number} of intersection {id:?} names roadLink {link}, but there are {count} roadLinks"
                ));
            }
        }
        Ok(())
    }

    /// Pairs of roads, by index, between which some lane leads.
    pub(super) fn linked_roads(&self) -> HashSet<(usize, usize)> {
        let links = self.intersections.iter().flat_map(|intersection| &intersection.road_links);
        links
            .filter(|link| !link.lane_links.is_empty())
            .filter_map(|link| Some((self.road(&link.start_road)?.0, self.road(&link.end_road)?.0)))
            .collect()
    }
}

/// Refuses what SUMO would not take as an id, or would take for something else.
fn check_id(kind: &str, id: &str) -> Result<(), String> {
    let odd = |letter: char| letter.is_control() || " \t|\\'\";,<>&!".contains(letter);
    if id.is_empty() || id.starts_with(':') || id.contains(odd) {
        return Err(format!("the {kind} id {id:?} is one that SUMO does not accept; rename it"));
    }
    Ok(())
}

fn is_place(point: Point) -> bool {
    point.x.abs() <= 1e8 && point.y.abs() <= 1e8
}
