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
use cross_sim::metrics::{EpisodeMetrics, MeanStd, Metric, SecondMeter, TripTotals};
use cross_sim::scenario::{self, Scenario};
use cross_traci::SumoHome;
use outputs::{EMITTED, Outputs, Trip, mean_std, number, signalised};
use serde_json::json;
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Long enough for queues and arrivals on the small maps; the measures are the same ones at any length.
const SECONDS: u32 = 300;
const EXACT: f64 = 1e-6;

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

/// What is compared, and how often it failed to agree.
struct Comparison<'c> {
    of: &'c str,
    ours: &'c EpisodeMetrics,
}

impl Comparison<'_> {
    fn close(&self, ours: f64, theirs: f64, tolerance: f64, what: &str) {
        // Six digits after the point of small figures, and of large ones as many as an f64 carries safely.
        let tolerance = tolerance * theirs.abs().max(1.0);
        assert!((ours - theirs).abs() <= tolerance, "{}, {what}: ours {ours}, SUMO's {theirs}", self.of);
    }

    fn exact(&self, metric: Metric, values: &[f64]) {
        let MeanStd { mean, std } = self.ours.get(metric);
        let (theirs, deviation) = mean_std(values);
        self.close(mean, theirs, EXACT, metric.key());
        self.close(std, deviation, EXACT, &format!("deviation of {}", metric.key()));
    }

    fn all(&self, scenario: &Scenario, agents: &[String], seconds: u32, outputs: &Outputs) {
        let begin = f64::from(scenario.begin);
        let end = begin + f64::from(seconds);
        let net = signalised(&std::fs::read_to_string(&scenario.net).unwrap());
        let trips = outputs.trips();
        self.seconds(&net, agents, (begin, end), outputs);
        self.trips(&trips);
        self.totals(&trips, seconds, outputs);
        // A vehicle that teleports is recorded each second, though it gives nothing off on its way.
        if self.ours.vehicles.teleports == 0 {
            self.emissions(&trips, end, outputs);
        }
        self.lane_data(&net, agents, &trips, seconds, outputs);
    }

    /// Queue, speed, completions and return from the records of every second.
    fn seconds(
        &self,
        net: &HashMap<String, HashMap<String, f64>>,
        agents: &[String],
        (begin, end): (f64, f64),
        outputs: &Outputs,
    ) {
        let lanes = lanes_of(net, agents);
        let seconds = outputs.seconds(begin, end);
        assert_eq!(seconds.len() as f64, end - begin, "{}: SUMO recorded every second", self.of);
        let queue: Vec<_> =
            seconds.iter().map(|second| second.halting(&lanes) as f64 / lanes.len() as f64).collect();
        self.exact(Metric::QueueLength, &queue);

        let config = EnvConfig::default();
        let metres = f64::from(config.reward_range_metres);
        let decisions = seconds
            .chunks_exact(config.decision_seconds as usize)
            .map(|interval| &interval[interval.len() - 1]);
        let stopped: usize = decisions
            .map(|second| agents.iter().map(|id| second.halting_near(&net[id], metres)).sum::<usize>())
            .sum();
        self.close(self.ours.episode_return, -(stopped as f64) / agents.len() as f64, EXACT, "return");

        let summary = outputs.lines("summary.xml", "step");
        let summary = &summary[..seconds.len()];
        // SUMO writes -1 for the mean speed of no vehicles.
        let speed: Vec<_> = summary.iter().map(|step| number(step, "meanSpeed").max(0.0)).collect();
        self.exact(Metric::Speed, &speed);
        let arrived: Vec<_> =
            std::iter::once(0.0).chain(summary.iter().map(|step| number(step, "arrived"))).collect();
        let rate = self.ours.get(Metric::TripCompletionRate);
        self.close(rate.mean, arrived[seconds.len()] / seconds.len() as f64, EXACT, "trip completion rate");
        let blocks: Vec<_> = arrived
            .chunks(10)
            .zip(arrived[10..].chunks(10))
            .map(|(from, to)| (to[0] - from[0]) / 10.0)
            .collect();
        assert_eq!(blocks.len(), seconds.len() / 10);
        self.close(rate.std, mean_std(&blocks).1, EXACT, "deviation of the trip completion rate");
        let last = summary.last().unwrap();
        self.close(self.ours.vehicles.teleports as f64, number(last, "teleports"), 0.0, "teleports");

        let tail = &summary[seconds.len().saturating_sub(300)..];
        let standstill = tail.iter().all(|step| number(step, "running") > 0.0)
            && number(last, "arrived") == arrived[seconds.len().saturating_sub(300)];
        assert_eq!(self.ours.gridlock, seconds.len() >= 600 && standstill, "{}: gridlock", self.of);
    }

    /// Whatever is measured of each vehicle, from the trip output.
    fn trips(&self, trips: &[Trip]) {
        let of = |which: &dyn Fn(&Trip) -> bool, value: &dyn Fn(&Trip) -> f64| -> Vec<f64> {
            trips.iter().filter(|trip| which(trip)).map(value).collect()
        };
        let all = |_: &Trip| true;
        let entered = |trip: &Trip| trip.depart >= 0.0;
        let finished = |trip: &Trip| entered(trip) && trip.arrival >= 0.0;
        self.exact(Metric::TripTime, &of(&entered, &|trip| trip.duration));
        self.exact(Metric::TripDelay, &of(&entered, &|trip| trip.waiting_time));
        self.exact(Metric::TimeLoss, &of(&entered, &|trip| trip.time_loss));
        self.exact(Metric::Stops, &of(&entered, &|trip| trip.stops));
        self.exact(Metric::Co2, &of(&entered, &|trip| trip.emitted[0] / 1000.0));
        self.exact(Metric::Fuel, &of(&entered, &|trip| trip.emitted[1] / 1000.0));
        self.exact(Metric::FinishedTripTime, &of(&finished, &|trip| trip.duration));
        let duration = |trip: &Trip| if entered(trip) { trip.duration } else { trip.depart_delay };
        self.exact(Metric::TripDuration, &of(&all, &duration));
        self.exact(Metric::DepartDelay, &of(&all, &|trip| trip.depart_delay));
        // A vehicle that never entered neither stood nor lost time inside.
        self.exact(Metric::WaitingTime, &of(&all, &|trip| trip.depart_delay + trip.waiting_time));
        self.exact(Metric::TotalDelay, &of(&all, &|trip| trip.depart_delay + trip.time_loss));
        self.close(self.ours.vehicles.finished as f64, of(&finished, &|_| 1.0).len() as f64, 0.0, "finished");
    }

    /// Vehicles and trips from SUMO's own totals.
    fn totals(&self, trips: &[Trip], seconds: u32, outputs: &Outputs) {
        let vehicles = self.ours.vehicles;
        let summary = outputs.lines("summary.xml", "step");
        let last = &summary[seconds as usize - 1];
        self.close(vehicles.finished as f64, number(last, "arrived"), 0.0, "finished");
        self.close(vehicles.unfinished as f64, number(last, "running"), 0.0, "unfinished");
        // SUMO's last attempt to insert is at the beginning of the last second; who is due within that second counts as
        // never inserted, too, but not as waiting yet.
        let due_too_late = trips.iter().filter(|trip| trip.depart < 0.0 && trip.depart_delay < 1.0).count();
        let waiting = number(last, "waiting") + due_too_late as f64;
        self.close(vehicles.never_inserted as f64, waiting, 0.0, "never inserted");

        let totals = &outputs.lines("statistics.xml", "vehicleTripStatistics")[0];
        let count = number(totals, "count");
        self.close((vehicles.finished + vehicles.unfinished) as f64, count, 0.0, "trips");
        let total = number(totals, "totalTravelTime");
        self.close(self.ours.get(Metric::TripTime).mean, total / count, EXACT, "trip time");
        // SUMO gives these as means alone, cut to the milliseconds of its clock, as are the values they are taken of.
        self.close(self.ours.get(Metric::TripDelay).mean, number(totals, "waitingTime"), 2e-3, "trip delay");
        self.close(self.ours.get(Metric::TimeLoss).mean, number(totals, "timeLoss"), 2e-3, "time loss");
    }

    /// CO2 and fuel from what each vehicle gave off each second.
    ///
    /// The record of seconds begins with the one in which a vehicle enters, which its trip does not count, and lacks the
    /// one in which it arrives. So unfinished vehicles agree exactly, finished ones up to one second's emissions.
    fn emissions(&self, trips: &[Trip], end: f64, outputs: &Outputs) {
        let emitted = outputs.emissions(end);
        for (kind, name) in EMITTED.iter().enumerate() {
            let largest = emitted
                .values()
                .flatten()
                .map(|values| values[kind])
                .fold(0.0, f64::max)
                .max(f64::MIN_POSITIVE);
            for trip in trips.iter().filter(|trip| trip.depart >= 0.0) {
                let seconds = emitted.get(&trip.id).map(Vec::as_slice).unwrap_or_default();
                let total: f64 = seconds.iter().skip(1).map(|values| values[kind]).sum();
                let rest = trip.emitted[kind] - total;
                if trip.arrival < 0.0 {
                    self.close(trip.emitted[kind], total, EXACT, &format!("{name} of {}", trip.id));
                } else {
                    let plausible = (-EXACT..=2.0 * largest).contains(&rest);
                    assert!(
                        plausible,
                        "{}: {name} of {} is {rest} off, a second is {largest}",
                        self.of, trip.id
                    );
                }
            }
        }
    }

    /// The queue from SUMO's lane data, the halting seconds on each lane.
    ///
    /// It lacks the second in which a vehicle is inserted, standing, which is added here. It counts a vehicle on a lane until
    /// its rear has left, we until its front has, so that those that stand across a stop line make it more; and it counts
    /// only a part of the second in which a vehicle comes to a lane, which makes it less. Hence a tolerance on either side.
    fn lane_data(
        &self,
        net: &HashMap<String, HashMap<String, f64>>,
        agents: &[String],
        trips: &[Trip],
        seconds: u32,
        outputs: &Outputs,
    ) {
        let lanes = lanes_of(net, agents);
        let on_lanes = |lane: &str| lanes.contains(lane);
        let halting: f64 = outputs
            .lines("lanes.xml", "lane")
            .iter()
            .filter(|lane| on_lanes(outputs::attribute(lane, "id").unwrap()))
            .map(|lane| outputs::attribute(lane, "waitingTime").map_or(0.0, |time| time.parse().unwrap()))
            .sum();
        let entered = trips
            .iter()
            .filter(|trip| trip.depart >= 0.0 && trip.depart_speed < 0.1 && on_lanes(&trip.depart_lane));
        let theirs = halting + entered.count() as f64;
        let ours = self.ours.get(Metric::QueueLength).mean * f64::from(seconds) * lanes.len() as f64;
        let (low, high) = (theirs * 0.93 - 1.0, theirs * 1.02 + 1.0);
        assert!((low..=high).contains(&ours), "{}: {ours} halting seconds, SUMO's lanes {theirs}", self.of);
    }
}

fn lanes_of(net: &HashMap<String, HashMap<String, f64>>, agents: &[String]) -> HashSet<String> {
    agents.iter().flat_map(|id| net[id].keys().cloned()).collect()
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
    ingolstadt1: "ingolstadt1",
    ingolstadt7: "ingolstadt7",
    ingolstadt21: "ingolstadt21",
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
            eprintln!("skipped: {name} is not imported; `cross scenario import cityflow --help` tells how");
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
