//! One running SUMO: shows signal states, lets time pass, hands over what it reports.

use super::EnvOptions;
use super::arguments::arguments;
use crate::lanes::LaneTable;
use crate::scenario::Scenario;
use cross_traci::constants::{Domain, simulation, vehicle};
use cross_traci::{DecodeError, ExitReport, Object, Subscription, SubscriptionResults};
use cross_traci::{Sumo, SumoCommand, SumoHome, TraciError};

/// Metres around the anchor junction within which vehicles are reported: no network reaches farther.
const EVERYWHERE: f64 = 1e7;
/// What is read of each vehicle.
const VEHICLE: [u8; 3] = [vehicle::LANE_ID, vehicle::LANE_POSITION, vehicle::SPEED];
/// What is read of the simulation when every second is watched; SUMO counts events over its last second only.
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
    watches_events: bool,
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
    /// Starts SUMO at the scenario's begin and subscribes to all vehicles.
    pub(super) fn start(
        home: &SumoHome,
        scenario: &Scenario,
        options: &EnvOptions,
        seed: u32,
        anchor: &str,
    ) -> Result<Self, TraciError> {
        let command = SumoCommand::new().args(arguments(scenario, options, seed));
        let mut sumo = Sumo::start(home, &command, options.timeout)?;
        sumo.client().subscribe_context(Domain::Junction, anchor, EVERYWHERE, Domain::Vehicle, &VEHICLE)?;
        let time = f64::from(scenario.begin);
        Ok(Self { sumo, anchor: anchor.to_owned(), time, watches_events: false })
    }

    /// Simulated time, seconds.
    pub(super) fn time(&self) -> f64 {
        self.time
    }

    pub(super) fn pid(&self) -> u32 {
        self.sumo.pid()
    }

    /// Asks SUMO to report events from the next step on.
    pub(super) fn watch_events(&mut self) -> Result<(), TraciError> {
        if !self.watches_events {
            self.sumo.client().subscribe(Domain::Simulation, "", &EVENTS)?;
            self.watches_events = true;
        }
        Ok(())
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

    /// Lets seconds pass in one command.
    pub(super) fn run(&mut self, seconds: u32) -> Result<(), TraciError> {
        self.time += f64::from(seconds);
        self.sumo.client().simulation_step(self.time)?;
        Ok(())
    }

    /// Counts the vehicles that the last step reported into an emptied table.
    pub(super) fn count(&mut self, lanes: &mut LaneTable) -> Result<Traffic, TraciError> {
        let results = self.sumo.client().subscriptions();
        let vehicles = found(
            results.find_context(Domain::Junction, &self.anchor, Domain::Vehicle),
            "the subscription to all vehicles",
        )?;
        lanes.clear();
        let mut speeds = 0.0;
        for vehicle in vehicles.objects() {
            speeds += count_vehicle(lanes, vehicle).map_err(unreadable)?;
        }
        let running = vehicles.len();
        Ok(Traffic { running: saturating(running), mean_speed: speeds / running.max(1) as f64 })
    }

    /// What the last step, of one second, reported after [`watch_events`](Self::watch_events).
    pub(super) fn events(&mut self) -> Result<Events, TraciError> {
        read_events(self.sumo.client().subscriptions())
    }

    /// Ends SUMO in order, so that its output files are complete.
    pub(super) fn close(self) -> Result<ExitReport, TraciError> {
        self.sumo.close()
    }
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

fn read_events(results: SubscriptionResults<'_>) -> Result<Events, TraciError> {
    let simulation = found(results.find(Domain::Simulation, ""), "the subscription to the simulation")?;
    let mut events = Events::default();
    for object in simulation.objects() {
        for (variable, value) in object.values() {
            let number = || value.int().map(|count| u32::try_from(count).unwrap_or(0)).map_err(unreadable);
            match variable {
                simulation::ARRIVED_NUMBER => events.arrived = number()?,
                simulation::DEPARTED_NUMBER => events.departed = number()?,
                simulation::TELEPORT_STARTING_NUMBER => events.teleports = number()?,
                simulation::PENDING_VEHICLES => {
                    events.waiting_to_enter = saturating(value.strings().map_err(unreadable)?.len());
                }
                _ => {}
            }
        }
    }
    Ok(events)
}

fn found<'a>(
    subscription: Option<Subscription<'a>>,
    expected: &'static str,
) -> Result<Subscription<'a>, TraciError> {
    subscription.ok_or_else(|| unreadable(DecodeError::Type { expected, found: "nothing" }))
}

fn unreadable(source: DecodeError) -> TraciError {
    let command = "the simulation step".to_owned();
    TraciError::Protocol { command, source, evidence: Box::default() }
}

fn saturating(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
