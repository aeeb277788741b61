//! One running SUMO: shows signal states, lets time pass, reads the vehicles.
//!
//! SUMO evaluates a standing subscription after every simulated second, however many seconds one `simulationStep` command
//! covers; for all vehicles of a grid that makes an episode half as long again. So there is one only while every second
//! is watched. Otherwise all vehicles are subscribed to when they are wanted, which brings their values at once, and
//! unsubscribed in the same message.

use super::EnvOptions;
use super::arguments::arguments;
use crate::lanes::LaneTable;
use crate::scenario::Scenario;
use cross_traci::constants::{Domain, simulation, traffic_light, vehicle};
use cross_traci::{
    DecodeError, ExitReport, Object, Replies, Subscription, Sumo, SumoCommand, SumoHome, TraciError,
};
use std::path::Path;

/// Metres around the anchor junction within which vehicles are reported: no network reaches farther.
const EVERYWHERE: f64 = 1e7;
/// What is read of each vehicle.
const VEHICLE: [u8; 3] = [vehicle::LANE_ID, vehicle::LANE_POSITION, vehicle::SPEED];
/// What is read of the simulation while every second is watched; SUMO counts these over its last second only.
const EVENTS: [u8; 4] = [
    simulation::ARRIVED_NUMBER,
    simulation::DEPARTED_NUMBER,
    simulation::TELEPORT_STARTING_NUMBER,
    simulation::PENDING_VEHICLES,
];

/// A traffic light and the state it is to show.
pub(super) type Shown<'a> = (&'a str, &'a str);

#[derive(Debug)]
pub(super) struct Simulation {
    sumo: Sumo,
    /// Some junction, which the subscription to all vehicles is anchored at.
    anchor: String,
    time: f64,
    /// Whether vehicles and events are subscribed to for every second.
    watching: bool,
}

/// Vehicles in the network at one moment.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Traffic {
    pub(super) running: u32,
    pub(super) mean_speed: f64,
}

/// What happened in the last second.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Events {
    pub(super) arrived: u32,
    pub(super) departed: u32,
    pub(super) teleports: u32,
    pub(super) waiting_to_enter: u32,
}

impl Simulation {
    /// Starts SUMO at the scenario's begin, with a file of signal programs if there is one.
    pub(super) fn start(
        home: &SumoHome,
        scenario: &Scenario,
        options: &EnvOptions,
        programs: Option<&Path>,
        seed: u32,
        anchor: &str,
    ) -> Result<Self, TraciError> {
        let command = SumoCommand::new().args(arguments(scenario, options, programs, seed));
        let sumo = Sumo::start(home, &command, options.timeout)?;
        Ok(Self { sumo, anchor: anchor.to_owned(), time: f64::from(scenario.begin), watching: false })
    }

    /// Simulated time, seconds.
    pub(super) fn time(&self) -> f64 {
        self.time
    }

    pub(super) fn pid(&self) -> u32 {
        self.sumo.pid()
    }

    /// Shows states on several lights, in one message.
    pub(super) fn show<'a>(&mut self, states: impl IntoIterator<Item = Shown<'a>>) -> Result<(), TraciError> {
        let mut batch = self.sumo.client().batch();
        for (light, state) in states {
            batch.set_traffic_light_state(light, state);
        }
        batch.send()?;
        Ok(())
    }

    /// The program that each of these lights runs, each followed by the state that it shows.
    pub(super) fn programs_and_states<'l>(
        &mut self,
        lights: impl IntoIterator<Item = &'l str>,
    ) -> Result<Replies<'_>, TraciError> {
        let mut batch = self.sumo.client().batch();
        for light in lights {
            batch.get(Domain::TrafficLight, traffic_light::CURRENT_PROGRAM, light);
            batch.get(Domain::TrafficLight, traffic_light::RED_YELLOW_GREEN_STATE, light);
        }
        batch.send()
    }

    /// Lets seconds pass in one command.
    pub(super) fn run(&mut self, seconds: u32) -> Result<(), TraciError> {
        self.time += f64::from(seconds);
        self.sumo.client().simulation_step(self.time)?;
        Ok(())
    }

    /// Counts the vehicles of this moment into a table, which is emptied first.
    pub(super) fn count(&mut self, lanes: &mut LaneTable) -> Result<Traffic, TraciError> {
        let mut batch = self.sumo.client().batch();
        batch.subscribe_context(Domain::Junction, &self.anchor, EVERYWHERE, Domain::Vehicle, &VEHICLE);
        batch.subscribe_context(Domain::Junction, &self.anchor, EVERYWHERE, Domain::Vehicle, &[]);
        // The second command also ends a subscription that `watch` left standing.
        self.watching = false;
        count(lanes, batch.send()?.subscription(0)?)
    }

    /// Has every step from now on bring vehicles and events.
    pub(super) fn watch(&mut self) -> Result<(), TraciError> {
        if !self.watching {
            let mut batch = self.sumo.client().batch();
            batch.subscribe_context(Domain::Junction, &self.anchor, EVERYWHERE, Domain::Vehicle, &VEHICLE);
            batch.subscribe(Domain::Simulation, "", &EVENTS);
            batch.send()?;
            self.watching = true;
        }
        Ok(())
    }

    /// As [`count`](Self::count), from what a step of one second brought under [`watch`](Self::watch), and what happened
    /// in that second.
    pub(super) fn count_second(&mut self, lanes: &mut LaneTable) -> Result<(Traffic, Events), TraciError> {
        let results = self.sumo.client().subscriptions();
        let vehicles = results.find_context(Domain::Junction, &self.anchor, Domain::Vehicle);
        let simulation = results.find(Domain::Simulation, "");
        let missing = || unreadable(DecodeError::Type { expected: "a subscription", found: "none" });
        let traffic = count(lanes, vehicles.ok_or_else(missing)?)?;
        Ok((traffic, events(simulation.ok_or_else(missing)?).map_err(unreadable)?))
    }

    /// Ends SUMO in order, so that its output files are complete.
    pub(super) fn close(self) -> Result<ExitReport, TraciError> {
        self.sumo.close()
    }
}

fn count(lanes: &mut LaneTable, vehicles: Subscription<'_>) -> Result<Traffic, TraciError> {
    lanes.clear();
    let mut speeds = 0.0;
    for vehicle in vehicles.objects() {
        speeds += count_vehicle(lanes, vehicle).map_err(unreadable)?;
    }
    let running = vehicles.len();
    Ok(Traffic { running: saturating(running), mean_speed: speeds / running.max(1) as f64 })
}

/// Counts one vehicle and returns its speed.
fn count_vehicle(lanes: &mut LaneTable, vehicle: Object<'_>) -> Result<f64, DecodeError> {
    let (mut lane, mut position, mut speed) = ("", 0.0, 0.0);
    for (variable, value) in vehicle.values() {
        match variable {
            vehicle::LANE_ID => lane = value.str()?,
            vehicle::LANE_POSITION => position = value.double()?,
            vehicle::SPEED => speed = value.double()?,
            _ => {}
        }
    }
    lanes.add(lane, position, speed);
    Ok(speed)
}

fn events(simulation: Subscription<'_>) -> Result<Events, DecodeError> {
    let mut events = Events::default();
    for (variable, value) in simulation.objects().flat_map(|object| object.values()) {
        let number = || value.int().map(|count| u32::try_from(count).unwrap_or(0));
        match variable {
            simulation::ARRIVED_NUMBER => events.arrived = number()?,
            simulation::DEPARTED_NUMBER => events.departed = number()?,
            simulation::TELEPORT_STARTING_NUMBER => events.teleports = number()?,
            simulation::PENDING_VEHICLES => events.waiting_to_enter = saturating(value.strings()?.len()),
            _ => {}
        }
    }
    Ok(events)
}

fn unreadable(source: DecodeError) -> TraciError {
    let command = "reading the traffic".to_owned();
    TraciError::Protocol { command, source, evidence: Box::default() }
}

fn saturating(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
