//! Every metric on every scenario, beside a computation of its own from SUMO's outputs: positions and speeds of all
//! vehicles (fcd), summary, trip, lane, emission and statistic output.
//!
//! Agreement is to 1e-6 where both count the same; where SUMO counts something slightly else, the comment says what.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

mod outputs;

use cross_config::EnvConfig;
use cross_sim::controller::{Controller, ControllerError, ControllerView, RuleBased};
use cross_sim::env::{Env, EnvOptions};
use cross_sim::generate::NewScenario;
use cross_sim::import::cityflow;
use cross_sim::metrics::{EpisodeMetrics, Metric, SecondMeter, TripTotals};
use cross_sim::scenario::{self, Scenario};
use cross_traci::SumoHome;
use outputs::Outputs;
use outputs::comparison::Comparison;
use serde_json::json;
use std::collections::HashSet;
use std::io::Write as _;
use std::path::Path;

/// Long enough for queues and arrivals on the small maps; the measures are the same ones at any length.
const SECONDS: u32 = 300;

fn home() -> SumoHome {
    SumoHome::locate(None).expect("set-up installed SUMO")
}

/// Runs an episode of `seconds` with all of SUMO's records beside ours.
fn run(
    scenario: &Scenario,
    controller: &mut dyn Controller,
    seconds: u32,
    outputs: &Outputs,
) -> (EpisodeMetrics, Vec<String>) {
    let config = EnvConfig { episode_seconds: seconds, ..EnvConfig::default() };
    let options = EnvOptions {
        tripinfo: Some(outputs.path("trips.xml")),
        extra_args: outputs.options(),
        ..EnvOptions::new(config.clone())
    };
    let mut env = Env::new(&home(), scenario, options).unwrap();
    env.reset(5).unwrap();
    let layout = env.layout().clone();
    controller.reset(&layout, 5).unwrap();
    let mut meter = SecondMeter::default();
    let mut total_reward = 0.0;
    let mut actions = vec![0; layout.agents()];
    for step in 0..config.steps_per_episode() {
        actions.copy_from_slice(&env.observation().phases);
        let view = ControllerView {
            layout: &layout,
            observation: env.observation(),
            lanes: env.lanes(),
            step,
            time: env.time(),
        };
        controller.act(&view, &mut actions).unwrap();
        let outcome = env.step_observed(&actions, &mut meter).unwrap();
        total_reward += outcome.rewards.iter().map(|&reward| f64::from(reward)).sum::<f64>();
    }
    env.finish().unwrap();
    let trips = TripTotals::read(&outputs.path("trips.xml")).unwrap();
    let episode_return = total_reward / layout.agents() as f64;
    let agents = layout.intersections.iter().map(|agent| agent.id.clone()).collect();
    (EpisodeMetrics::new(5, &meter, &trips, episode_return), agents)
}

/// Compares everything on a scenario under Max-Pressure.
fn agree(scenario: &Scenario) -> EpisodeMetrics {
    agree_under(
        scenario,
        RuleBased::MaxPressure.controller(scenario.reference.max_pressure).as_mut(),
        SECONDS,
    )
}

fn agree_under(scenario: &Scenario, controller: &mut dyn Controller, seconds: u32) -> EpisodeMetrics {
    let folder = tempfile::tempdir().unwrap();
    let outputs = Outputs::new(folder.path());
    let (ours, agents) = run(scenario, controller, seconds, &outputs);
    Comparison { of: &scenario.name, ours: &ours }.all(scenario, &agents, seconds, &outputs);
    assert!(
        ours.get(Metric::Co2).mean > 0.0 && ours.get(Metric::QueueLength).mean > 0.0,
        "{}",
        scenario.name
    );
    ours
}

fn shipped(name: &str) {
    agree(&Scenario::load(name).expect("set-up fetched the maps"));
}

/// A test for each scenario that needs nothing but the set-up.
macro_rules! scenarios {
    ($($name:ident: $scenario:literal,)*) => {
        const SHIPPED: &[&str] = &[$($scenario),*];
        $(#[test] fn $name() { shipped($scenario); })*
    };
}

scenarios! {
    arterial4x4: "arterial4x4",
    cologne1: "cologne1",
    cologne3: "cologne3",
    cologne8: "cologne8",
    grid4x4: "grid4x4",
    grid5x5: "grid5x5",
    grid5x5_heavy: "grid5x5-heavy",
    grid5x5_light: "grid5x5-light",
    grid5x5_mid: "grid5x5-mid",
    ingolstadt1: "ingolstadt1",
    ingolstadt7: "ingolstadt7",
    ingolstadt21: "ingolstadt21",
    varied1: "varied1",
    varied2: "varied2",
    varied3: "varied3",
    varied4: "varied4",
    varied5: "varied5",
    varied6: "varied6",
}

/// Data sets that a user fetches; a checkout without them is as it should be.
const IMPORTED: [&str; 5] = ["hangzhou1", "hangzhou2", "jinan1", "jinan2", "jinan3"];

#[test]
fn imported_data_sets() {
    let there: HashSet<_> = scenario::list().into_iter().map(|entry| entry.name).collect();
    for name in IMPORTED {
        if there.contains(name) {
            agree(&Scenario::load(name).unwrap());
        } else {
            // Not by a macro that prints: what those write is shown of failed tests alone.
            let remedy = "`cross scenario import cityflow --help` tells how";
            let _ =
                writeln!(std::io::stderr(), "skipped the agreement of {name}: it is not imported; {remedy}");
        }
    }
}

#[test]
fn no_scenario_is_forgotten() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    for entry in std::fs::read_dir(folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let known = SHIPPED.iter().chain(&IMPORTED).any(|known| *known == name);
        assert!(known, "{name} needs a line in this file");
    }
}

/// A crossing of four one-lane roads in CityFlow's format, all movements straight on.
fn cityflow(folder: &Path) -> Scenario {
    let arms = [("w", -300, 0), ("s", 0, -200), ("e", 300, 0), ("n", 0, 200)];
    let mut intersections = Vec::new();
    let (mut roads, mut links, mut flows) = (Vec::new(), Vec::new(), Vec::new());
    for (index, (arm, x, y)) in arms.into_iter().enumerate() {
        let (outer, inner) = (json!({"x": x, "y": y}), json!({"x": 0, "y": 0}));
        intersections.push(
            json!({"id": arm, "point": outer, "width": 0, "roads": [], "roadLinks": [], "virtual": true,
            "trafficLight": {"roadLinkIndices": [], "lightphases": []}}),
        );
        let lanes = json!([{"width": 4, "maxSpeed": 11.111}]);
        let road = |id: String, points: [&serde_json::Value; 2], from: &str, to: &str| json!({"id": id, "points": points, "lanes": lanes, "startIntersection": from, "endIntersection": to});
        roads.push(road(format!("{arm}_in"), [&outer, &inner], arm, "J"));
        roads.push(road(format!("{arm}_out"), [&inner, &outer], "J", arm));
        let opposite = format!("{}_out", arms[(index + 2) % 4].0);
        links.push(json!({"type": "go_straight", "startRoad": format!("{arm}_in"), "endRoad": opposite, "direction": index,
            "laneLinks": [{"startLaneIndex": 0, "endLaneIndex": 0, "points": []}]}));
        flows.push(json!({"vehicle": {"length": 5.0}, "route": [format!("{arm}_in"), opposite], "interval": 4.0 + index as f64,
            "startTime": 0.0, "endTime": 200.0}));
    }
    let phases =
        json!([{"time": 30, "availableRoadLinks": [0, 2]}, {"time": 30, "availableRoadLinks": [1, 3]}]);
    intersections
        .push(json!({"id": "J", "point": {"x": 0, "y": 0}, "width": 15, "roads": [], "roadLinks": links,
        "trafficLight": {"roadLinkIndices": [0, 1, 2, 3], "lightphases": phases}, "virtual": false}));
    let (roadnet, flow) = (folder.join("roadnet.json"), folder.join("flow.json"));
    std::fs::write(&roadnet, json!({"intersections": intersections, "roads": roads}).to_string()).unwrap();
    std::fs::write(&flow, json!(flows).to_string()).unwrap();
    let new = NewScenario {
        name: "crossing".to_owned(),
        description: String::new(),
        source: String::new(),
        folder: folder.join("crossing"),
        replace: false,
        end: SECONDS,
        time_to_teleport: -1.0,
    };
    let imported = cityflow::import(&home(), &roadnet, &flow, &new).unwrap();
    Scenario::from_directory(&imported.folder).unwrap()
}

#[test]
fn a_crossing_imported_from_cityflow() {
    let folder = tempfile::tempdir().unwrap();
    agree(&cityflow(folder.path()));
}

/// Shows its first phase for ever.
struct Stuck;

impl Controller for Stuck {
    fn name(&self) -> &str {
        "stuck"
    }

    fn act(&mut self, _: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        actions.fill(0);
        Ok(())
    }
}

/// Whatever a good controller avoids: vehicles that teleport, that never enter, a network that stands.
#[test]
fn traffic_that_breaks_down() {
    let mut scenario = Scenario::load("grid5x5-heavy").unwrap();
    scenario.sumo.time_to_teleport = 60.0;
    let jammed = agree_under(&scenario, &mut Stuck, SECONDS);
    assert!(jammed.vehicles.teleports > 10, "{:?}", jammed.vehicles);
    assert!(jammed.vehicles.never_inserted > 0, "{:?}", jammed.vehicles);

    let folder = tempfile::tempdir().unwrap();
    let mut crossing = cityflow(folder.path());
    crossing.routes = vec![one_way(folder.path())];
    let standing = agree_under(&crossing, &mut Stuck, 600);
    assert!(standing.gridlock, "{:?}", standing.vehicles);
}

/// Vehicles that all face the light that never turns green.
fn one_way(folder: &Path) -> std::path::PathBuf {
    let path = folder.join("one-way.rou.xml");
    let routes = "<routes><flow id=\"f\" from=\"n_in\" to=\"s_out\" begin=\"0\" end=\"500\" period=\"5\"/>\
                  <flow id=\"g\" from=\"w_in\" to=\"e_out\" begin=\"0\" end=\"100\" period=\"10\"/></routes>";
    std::fs::write(&path, routes).unwrap();
    path
}
