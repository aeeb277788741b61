//! From CityFlow's network to SUMO's.

use super::report::Item;
use super::roadnet::{Intersection, RoadLink, RoadNet, Turn};
use crate::generate::plain::{Connection, Edge, Node, NodeKind, PlainNet, Program};
use std::collections::{BTreeSet, HashSet};
use std::f64::consts::{PI, TAU};

/// Width of all lanes, metres; CityFlow's own is only for drawing there, but here it would move stop lines.
const LANE_WIDTH: f64 = 3.2;
/// Yellow where CityFlow's program says nothing about it, seconds.
const YELLOW_SECONDS: u32 = 3;

/// The network, and what became of its parts.
pub(super) struct Converted {
    pub(super) net: PlainNet,
    pub(super) items: Vec<Item>,
}

pub(super) fn convert(roads: &RoadNet) -> Converted {
    let mut net = PlainNet { lane_width: LANE_WIDTH, ..PlainNet::default() };
    let mut signals = Item::new("signals");
    let mut phases = Item::new("phases");
    let mut turns = Item::new("turns");
    let mut lane_links = Item::new("lane links");
    for intersection in &roads.intersections {
        let links = ordered_links(roads, intersection);
        let read: usize = intersection.road_links.iter().map(|link| link.lane_links.len()).sum();
        turns.read += intersection.road_links.len() as u64;
        let usable = intersection.road_links.iter().filter(|link| !link.lane_links.is_empty()).count();
        turns.keep(
            usable as u64,
            intersection.road_links.len() as u64 - usable as u64,
            "without a lane link",
        );
        lane_links.read += read as u64;
        lane_links.keep(links.len() as u64, (read - links.len()) as u64, "given twice");

        let light =
            intersection.traffic_light.as_ref().filter(|_| !intersection.r#virtual && !links.is_empty());
        let given = light.map_or(0, |light| light.lightphases.len());
        let greens = light.map(|_| green_phases(intersection, &links)).unwrap_or_default();
        let distinct = greens.iter().map(|(_, state)| state).collect::<HashSet<_>>().len();
        let signalised = distinct >= 2;
        if given > 0 {
            signals.read += 1;
            phases.read += given as u64;
            if signalised {
                signals.keep(1, 0, "");
                let all_red = given - greens.len();
                phases.keep(
                    greens.len() as u64,
                    all_red as u64,
                    "that let nothing go beyond what always goes (yellow)",
                );
            } else {
                signals.keep(0, 1, "with fewer than two green phases, now without a signal");
                phases.keep(0, given as u64, "of intersections without a signal");
            }
        }
        if signalised {
            let yellow = yellow_seconds(intersection);
            net.programs.push(Program::with_yellows(intersection.id.clone(), &greens, yellow));
        }
        net.nodes.push(Node {
            id: intersection.id.clone(),
            at: (intersection.point.x, intersection.point.y),
            kind: if signalised { NodeKind::Signal } else { NodeKind::Priority },
        });
        net.connections.extend(links.iter().enumerate().map(|(index, link)| Connection {
            from: link.road_link.start_road.clone(),
            from_lane: link.from_lane,
            to: link.road_link.end_road.clone(),
            to_lane: link.to_lane,
            signal: signalised.then(|| (intersection.id.clone(), index)),
        }));
    }
    net.edges = edges(roads);
    let mut intersections = Item::new("intersections");
    intersections.read = roads.intersections.len() as u64;
    intersections.keep(intersections.read, 0, "");
    let mut roads_item = Item::new("roads");
    roads_item.read = roads.roads.len() as u64;
    roads_item.keep(roads_item.read, 0, "");
    Converted {
        net,
        items: vec![intersections, signals, phases, roads_item, lanes(roads), turns, lane_links],
    }
}

fn lanes(roads: &RoadNet) -> Item {
    let mut item = Item::new("lanes");
    let lanes = || roads.roads.iter().flat_map(|road| &road.lanes);
    item.read = lanes().count() as u64;
    item.keep(item.read, 0, "");
    let other = lanes().filter(|lane| lane.width.is_some_and(|width| width != LANE_WIDTH)).count();
    item.change(other as u64, &format!("in width, to {LANE_WIDTH} m"));
    item
}

fn edges(roads: &RoadNet) -> Vec<Edge> {
    let edge = |road: &super::roadnet::Road| Edge {
        id: road.id.clone(),
        from: road.start_intersection.clone(),
        to: road.end_intersection.clone(),
        priority: 1,
        // CityFlow counts lanes from the middle of the road, SUMO from its edge.
        lane_speeds: road.lanes.iter().rev().map(|lane| lane.max_speed).collect(),
        bends: road.points[1..road.points.len() - 1].iter().map(|point| (point.x, point.y)).collect(),
    };
    roads.roads.iter().map(edge).collect()
}

/// A lane link with what decides its place among the letters.
struct OrderedLink<'a> {
    road_link: &'a RoadLink,
    /// Index of the road link at its intersection.
    number: usize,
    /// Where it comes from, clockwise from north, radians.
    approach: f64,
    /// SUMO lane indices.
    from_lane: usize,
    to_lane: usize,
}

/// The lane links in the order of their letters: approaches clockwise from north, lanes from the outermost, then right
/// turns before straight on before left turns.
fn ordered_links<'a>(roads: &RoadNet, intersection: &'a Intersection) -> Vec<OrderedLink<'a>> {
    let mut links = Vec::new();
    let mut seen = HashSet::new();
    for (number, road_link) in intersection.road_links.iter().enumerate() {
        // Checked when it was read.
        let (Some((from, start)), Some((to, end))) =
            (roads.road(&road_link.start_road), roads.road(&road_link.end_road))
        else {
            continue;
        };
        let sumo_lane =
            |count: usize, lane: i64| (count - 1).saturating_sub(usize::try_from(lane).unwrap_or(0));
        for lane_link in &road_link.lane_links {
            let from_lane = sumo_lane(start.lanes.len(), lane_link.start_lane_index);
            let to_lane = sumo_lane(end.lanes.len(), lane_link.end_lane_index);
            if seen.insert((from, from_lane, to, to_lane)) {
                links.push(OrderedLink { road_link, number, approach: approach(start), from_lane, to_lane });
            }
        }
    }
    links.sort_by(|a, b| {
        let order =
            a.approach.total_cmp(&b.approach).then(a.road_link.start_road.cmp(&b.road_link.start_road));
        let order = order.then(a.from_lane.cmp(&b.from_lane)).then(a.road_link.turn.cmp(&b.road_link.turn));
        order.then(a.number.cmp(&b.number)).then(a.to_lane.cmp(&b.to_lane))
    });
    links
}

/// Where a road's traffic comes from when it arrives, clockwise from north, radians.
fn approach(road: &super::roadnet::Road) -> f64 {
    let [.., before, end] = road.points.as_slice() else { return 0.0 };
    // A road that is north but for a rounding error comes first, not last.
    ((before.x - end.x).atan2(before.y - end.y) + TAU + 1e-6) % TAU
}

/// Phases that let something go beyond what may always go: seconds and SUMO's state.
fn green_phases(intersection: &Intersection, links: &[OrderedLink<'_>]) -> Vec<(u32, String)> {
    let sets = phase_sets(intersection);
    let always = always(&sets);
    let choices = sets.iter().filter(|(_, available)| *available != always);
    choices
        .map(|(seconds, available)| {
            let state = links.iter().map(|link| letter(link, links, available)).collect();
            (*seconds, state)
        })
        .collect()
}

/// What each phase lets go.
fn phase_sets(intersection: &Intersection) -> Vec<(u32, BTreeSet<usize>)> {
    let phases = intersection.traffic_light.iter().flat_map(|light| &light.lightphases);
    phases
        .map(|phase| {
            let available = phase.available_road_links.iter().filter_map(|&link| usize::try_from(link).ok());
            // Between 0 and a day; a state that is never shown would be no phase.
            ((phase.time.round() as u32).max(1), available.collect())
        })
        .collect()
}

/// Road links that go in every phase, as right turns do in most files.
fn always(sets: &[(u32, BTreeSet<usize>)]) -> BTreeSet<usize> {
    let mut sets = sets.iter().map(|(_, available)| available);
    let first = sets.next().cloned().unwrap_or_default();
    sets.fold(first, |common, available| &common & available)
}

/// The duration of the phase in which nothing but what always goes may go.
fn yellow_seconds(intersection: &Intersection) -> u32 {
    let sets = phase_sets(intersection);
    let always = always(&sets);
    let yellow = sets.iter().find(|(_, available)| *available == always).map(|(seconds, _)| *seconds);
    yellow.unwrap_or(YELLOW_SECONDS).min(60)
}

/// `G`, or `g` for a left turn through traffic that may go straight on against it, or `r`.
fn letter(link: &OrderedLink<'_>, links: &[OrderedLink<'_>], available: &BTreeSet<usize>) -> char {
    if !available.contains(&link.number) {
        return 'r';
    }
    let against = |other: &OrderedLink<'_>| {
        let angle = (other.approach - link.approach).abs();
        other.road_link.turn == Turn::Straight
            && available.contains(&other.number)
            && (angle - PI).abs() < PI / 4.0
    };
    let yields = matches!(link.road_link.turn, Turn::Left | Turn::Around) && links.iter().any(against);
    if yields { 'g' } else { 'G' }
}
