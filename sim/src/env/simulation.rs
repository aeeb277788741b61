//! One running SUMO: shows signal states, lets time pass, reads the vehicles.
//!
//! What is shown and the seconds that pass go out together with the question at their end, and SUMO works through them
//! without waiting for us. A decision is two round trips: how the network goes on and who is there then, and where each
//! is.
//!
//! While every second is watched, a second is one round trip, because where the vehicles of a second were is asked along
//! with the next second, and counted while SUMO simulates that:
//!
//! ```text
//!   us     [where: s-1 | show | step s | who: s] ───────────────> count s-1            [where: s | step s+1 | who: s+1] ──>
//!   SUMO                                answers "where", ── simulates s ── answers "who" ──>
//! ```

use super::EnvOptions;
use super::arguments::arguments;
use super::vehicles::{Look, Traffic, Vehicles, saturating, unreadable};
use crate::lanes::LaneTable;
use crate::scenario::Scenario;
use cross_traci::constants::{Domain, simulation, traffic_light};
use cross_traci::{ExitReport, Replies, Sumo, SumoCommand, SumoHome, TraciError};
use std::path::Path;
use std::time::Duration;

/// What is read of the simulation at each watched second, behind the ids of the vehicles.
const EVENTS: [u8; 4] = [
    simulation::ARRIVED_NUMBER,
    simulation::DEPARTED_NUMBER,
    simulation::TELEPORT_STARTING_NUMBER,
    simulation::PENDING_VEHICLES,
];

/// Simulations that one process loads after its first. No leak was found (docs/performance.md); this bounds one that a
/// network might have.
const MOST_LOADS: u32 = 200;

/// A traffic light and the state it is to show.
pub(super) type Shown<'a> = (&'a str, &'a str);

#[derive(Debug)]
pub(super) struct Simulation {
    sumo: Sumo,
    vehicles: Vehicles,
    time: f64,
    loads: u32,
    /// SUMO was asked who is there, the answer not being there yet.
    asked_who: bool,
    /// The watched second whose vehicles SUMO was asked for, and how closely, the answer not being there yet.
    asked: Option<(f64, Events, Look)>,
    /// Time spent waiting for SUMO to simulate, as far as it was told.
    stepping: Duration,
}

/// What happened in the last second.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Events {
    pub(super) arrived: u32,
    pub(super) departed: u32,
    pub(super) teleports: u32,
    pub(super) waiting_to_enter: u32,
}

/// A second that was watched.
#[derive(Debug, Clone, Copy)]
pub(super) struct Second {
    /// Simulated time at its end, seconds.
    pub(super) time: f64,
    pub(super) traffic: Traffic,
    pub(super) events: Events,
}

impl Simulation {
    /// Starts SUMO at the scenario's begin, with a file of signal programs if there is one.
    pub(super) fn start(
        home: &SumoHome,
        scenario: &Scenario,
        options: &EnvOptions,
        programs: Option<&Path>,
        seed: u32,
    ) -> Result<Self, TraciError> {
        let command = SumoCommand::new().args(arguments(scenario, options, programs, seed));
        let sumo = Sumo::start(home, &command, options.timeout)?;
        Ok(Self {
            sumo,
            vehicles: Vehicles::default(),
            time: f64::from(scenario.begin),
            loads: 0,
            asked_who: false,
            asked: None,
            stepping: Duration::ZERO,
        })
    }

    /// Begins anew in the same process, which is quicker than a new one: only files are read. `None` if this process has
    /// done so often enough, or cannot be told the arguments.
    pub(super) fn restart(
        mut self,
        scenario: &Scenario,
        options: &EnvOptions,
        programs: Option<&Path>,
        seed: u32,
    ) -> Result<Option<Self>, TraciError> {
        let arguments = arguments(scenario, options, programs, seed);
        let arguments: Option<Vec<&str>> = arguments.iter().map(|argument| argument.to_str()).collect();
        let Some(arguments) = arguments.filter(|_| self.loads < MOST_LOADS) else { return Ok(None) };
        self.sumo.client().load(&arguments)?;
        self.time = f64::from(scenario.begin);
        self.loads += 1;
        (self.asked_who, self.asked) = (false, None);
        Ok(Some(self))
    }

    /// Simulated time, seconds.
    pub(super) fn time(&self) -> f64 {
        self.time
    }

    pub(super) fn pid(&self) -> u32 {
        self.sumo.pid()
    }

    /// Time spent waiting for SUMO to simulate since this was asked last.
    pub(super) fn take_stepping(&mut self) -> Duration {
        let stepping = self.sumo.client().statistics().stepping;
        stepping.saturating_sub(std::mem::replace(&mut self.stepping, stepping))
    }

    /// Has states shown on several lights before the next seconds pass.
    pub(super) fn show<'a>(&mut self, states: impl IntoIterator<Item = Shown<'a>>) -> Result<(), TraciError> {
        let mut batch = self.sumo.client().batch();
        for (light, state) in states {
            batch.set_traffic_light_state(light, state);
        }
        batch.post()
    }

    /// Waits until SUMO has done all that it was told.
    pub(super) fn settle(&mut self) -> Result<(), TraciError> {
        let client = self.sumo.client();
        while client.waiting() > 0 {
            client.take()?;
        }
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

    /// Has seconds pass, in one command.
    pub(super) fn run(&mut self, seconds: u32) -> Result<(), TraciError> {
        self.time += f64::from(seconds);
        self.sumo.client().post_step(self.time)
    }

    /// Has SUMO begin with all that it was told, and say who is there then. Nothing else may be asked before
    /// [`count`](Self::count).
    pub(super) fn begin(&mut self) -> Result<(), TraciError> {
        let client = self.sumo.client();
        let mut batch = client.batch();
        Vehicles::ask_who(&mut batch);
        batch.post()?;
        self.asked_who = true;
        self.flush()
    }

    /// Has SUMO begin with all that it was told.
    pub(super) fn flush(&mut self) -> Result<(), TraciError> {
        self.sumo.client().flush()
    }

    /// Counts the vehicles of this moment into a table, which is emptied first.
    pub(super) fn count(&mut self, lanes: &mut LaneTable) -> Result<Traffic, TraciError> {
        if !self.asked_who {
            self.begin()?;
        }
        self.asked_who = false;
        let client = self.sumo.client();
        // What was shown, and the steps.
        while client.waiting() > 1 {
            client.take()?;
        }
        self.vehicles.are(client.take()?.value(0)?.strings().map_err(unreadable)?);
        self.vehicles.ask(client, Look::Positions)?;
        self.vehicles.count(Look::Positions, client.take()?, lanes)
    }

    /// Has one watched second pass, and gives the one before it if it was not given yet, its vehicles counted into a table.
    pub(super) fn watch(&mut self, look: Look, lanes: &mut LaneTable) -> Result<Option<Second>, TraciError> {
        self.run(1)?;
        let client = self.sumo.client();
        let mut batch = client.batch();
        Vehicles::ask_who(&mut batch);
        for event in EVENTS {
            batch.get(Domain::Simulation, event, "");
        }
        batch.post()?;
        let before = self.watched(lanes)?;
        let client = self.sumo.client();
        // What was shown, and the step.
        while client.waiting() > 1 {
            client.take()?;
        }
        let replies = client.take()?;
        let events = events(replies)?;
        self.vehicles.are(replies.value(0)?.strings().map_err(unreadable)?);
        self.vehicles.ask(client, look)?;
        client.flush()?;
        self.asked = Some((self.time, events, look));
        Ok(before)
    }

    /// The last second that was [watched](Self::watch) if it was not given yet, its vehicles counted into a table.
    pub(super) fn watched(&mut self, lanes: &mut LaneTable) -> Result<Option<Second>, TraciError> {
        let Some((time, events, look)) = self.asked.take() else { return Ok(None) };
        let client = self.sumo.client();
        // Nothing was asked where nobody was.
        let traffic = if self.vehicles.len() == 0 {
            lanes.clear();
            Traffic::default()
        } else {
            self.vehicles.count(look, client.take()?, lanes)?
        };
        Ok(Some(Second { time, traffic, events }))
    }

    /// Ends SUMO in order, so that its output files are complete.
    pub(super) fn close(self) -> Result<ExitReport, TraciError> {
        self.sumo.close()
    }
}

/// Reads [`EVENTS`].
fn events(replies: Replies<'_>) -> Result<Events, TraciError> {
    let number = |index| replies.int(index).map(|count| u32::try_from(count).unwrap_or(0));
    let waiting = replies.value(4)?.strings().map_err(unreadable)?;
    Ok(Events {
        arrived: number(1)?,
        departed: number(2)?,
        teleports: number(3)?,
        waiting_to_enter: saturating(waiting.len()),
    })
}
