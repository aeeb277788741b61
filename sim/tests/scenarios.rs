//! The scenarios that come with the project, read from the real maps.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cross_config::EnvConfig;
use cross_sim::layout::{NetworkLayout, load_layout};
use cross_sim::net::Net;
use cross_sim::scenario::{self, Scenario};

const RESCO: [&str; 8] = [
    "arterial4x4",
    "cologne1",
    "cologne3",
    "cologne8",
    "grid4x4",
    "ingolstadt1",
    "ingolstadt21",
    "ingolstadt7",
];

fn layout(name: &str) -> NetworkLayout {
    let scenario = Scenario::load(name).unwrap();
    (*load_layout(&scenario, &EnvConfig::default()).unwrap()).clone()
}

#[test]
fn every_map_is_listed() {
    let names: Vec<_> = scenario::list().into_iter().map(|entry| entry.name).collect();
    for expected in RESCO {
        assert!(names.iter().any(|name| name == expected), "{expected} is not among {names:?}");
    }
}

#[test]
fn grid4x4_has_36_movements_and_8_phases_everywhere() {
    let layout = layout("grid4x4");
    assert_eq!(layout.agents(), 16);
    for intersection in &layout.intersections {
        assert_eq!(intersection.movements.len(), 36);
        assert_eq!(intersection.phases.len(), 8);
        assert_eq!((intersection.incoming.len(), intersection.outgoing.len()), (12, 12));
        assert_eq!((intersection.roads_in.len(), intersection.roads_out.len()), (4, 4));
        for road in intersection.roads_in.iter().chain(&intersection.roads_out) {
            assert_eq!((road.lanes, road.movements), (3, 9), "{}", road.id);
        }
    }
    // Columns are 300 m apart from west to east, rows from south to north.
    let first = &layout.intersections[0];
    assert_eq!((first.id.as_str(), first.position), ("A0", (300.0, 300.0)));
    // The first phase lets north and south go straight and right: link indices 0-5 and 18-23.
    let green: Vec<_> = (0..36).filter(|&link| first.phases[0].green[link] > 0.0).collect();
    assert_eq!(green, [0, 1, 2, 3, 4, 5, 18, 19, 20, 21, 22, 23]);
}

#[test]
fn arterial4x4_has_12_movements_and_5_phases_with_permissive_greens() {
    let layout = layout("arterial4x4");
    assert_eq!(layout.agents(), 16);
    for intersection in &layout.intersections {
        assert_eq!((intersection.movements.len(), intersection.phases.len()), (12, 5));
        assert_eq!(intersection.phases[0].state, "GGgsrrGGgsrr");
        let greens = [1.0, 1.0, 0.5, 0.0, 0.0, 0.0, 1.0, 1.0, 0.5, 0.0, 0.0, 0.0];
        assert_eq!(intersection.phases[0].green, greens);
    }
}

#[test]
fn city_maps_with_unlike_intersections_load() {
    let shapes = |name: &str| -> Vec<_> {
        let layout = layout(name);
        layout.intersections.iter().map(|at| (at.movements.len(), at.phases.len())).collect()
    };
    assert_eq!(shapes("cologne1"), [(20, 4)]);
    assert_eq!(shapes("cologne3"), [(11, 3), (18, 4), (20, 4)]);
    assert_eq!(shapes("cologne8").len(), 8);
    assert_eq!(shapes("ingolstadt1"), [(8, 3)]);
    assert_eq!(shapes("ingolstadt7").len(), 7);
    // One light here shares link indices between connections and has an all-red state; another leaves two indices unused.
    let ingolstadt21 = layout("ingolstadt21");
    assert_eq!(ingolstadt21.agents(), 21);
    let by_id = |id: &str| ingolstadt21.intersections.iter().find(|at| at.id == id).unwrap();
    let shared = by_id("243641585");
    assert_eq!((shared.movements.len(), shared.phases.len(), shared.phases[0].state.len()), (10, 3, 4));
    let gaps = by_id("cluster_1427494838_273472399");
    assert_eq!((gaps.movements.len(), gaps.phases[0].state.len()), (8, 10));
}

#[test]
fn no_light_of_these_maps_is_left_out() {
    for name in RESCO {
        let net = Net::read(&Scenario::load(name).unwrap().net).unwrap();
        assert_eq!(NetworkLayout::fixed_signals(&net), [], "{name}");
    }
}

#[test]
fn the_layout_hash_repeats_and_tells_maps_apart() {
    assert_eq!(layout("cologne3").hash(), layout("cologne3").hash());
    assert_ne!(layout("cologne3").hash(), layout("cologne1").hash());
}

#[test]
fn demand_is_counted_within_the_hour() {
    assert_eq!(Scenario::load("grid4x4").unwrap().vehicles().unwrap(), 1473);
    assert_eq!(Scenario::load("arterial4x4").unwrap().vehicles().unwrap(), 2484);
    // This map's file begins long before the hour that is simulated.
    let cologne3 = Scenario::load("cologne3").unwrap();
    assert_eq!((cologne3.begin, cologne3.end), (25_200, 28_800));
    assert!((2_000..4_000).contains(&cologne3.vehicles().unwrap()));
}
