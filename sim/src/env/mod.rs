//! The environment: one SUMO process, decisions in, observations and rewards out.
//!
//! ```text
//!   actions ──> SignalTiming ──[Show | Run]──> Simulation (SUMO) ──vehicles──> LaneTable ──> observation, rewards
//!                                                                                       └──> SecondObserver, if one watches
//! ```
//! Between decisions SUMO runs several seconds in one command: to the end of yellow where a phase changes, then to the
//! next decision. All that it needs for that, and the question who is there then, goes out at once, and whoever has something
//! else to do meanwhile [does](Env::begin_step). Only an episode that is [observed](Env::step_observed) is simulated second by
//! second; what happens in it is the same.
//!
//! With [`Signals::Program`] SUMO sets the lights itself: a step passes the interval of a decision and looks on. The phase
//! of an agent is then the green that its light shows or, in between, the one that it showed at an earlier decision.

mod arguments;
mod observer;
mod options;
mod programs;
mod signals;
mod simulation;
mod under_way;
mod vehicles;

pub use observer::{SecondObserver, SecondView};
pub use options::EnvOptions;
pub use signals::{Signals, SumoProgram};
pub use under_way::StepUnderWay;

use crate::error::SimError;
use crate::lanes::LaneTable;
use crate::layout::{self, NetworkLayout};
use crate::observe;
use crate::scenario::Scenario;
use crate::signal::{Command, SignalTiming};
use crate::trajectory::Observation;
use cross_traci::{ErrorKind, SumoHome, TraciError};
use programs::ProgramFile;
use simulation::{Second, Simulation};
use std::sync::Arc;
use std::time::{Duration, Instant};
use vehicles::Look;

/// Where an environment's time went, over all its episodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Timings {
    /// Waiting for SUMO to start and to simulate.
    pub sumo: Duration,
    /// Setting signals, and turning SUMO's reports into counts.
    pub traci: Duration,
}

/// What a step led to; the observation is [`Env::observation`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<'a> {
    /// Reward of each agent `[agents]`: minus the vehicles stopped on its incoming lanes and behind them, those beyond the reward's range
    /// weighted.
    pub rewards: &'a [f32],
    /// Whether the episode is over. It was cut off by time then, it has no end of its own.
    pub done: bool,
}

/// A scenario under control. It owns at most one SUMO process, which ends with it.
#[derive(Debug)]
pub struct Env {
    home: SumoHome,
    scenario: Scenario,
    options: EnvOptions,
    layout: Arc<NetworkLayout>,
    signals: SignalTiming,
    /// What SUMO is told about signal programs, where it is told something.
    programs: Option<ProgramFile>,
    lanes: LaneTable,
    observation: Observation,
    rewards: Vec<f32>,
    simulation: Option<Simulation>,
    time: f64,
    steps: u32,
    timings: Timings,
    replaced: Option<ErrorKind>,
}

impl Env {
    /// Prepares a scenario; SUMO starts at [`reset`](Self::reset).
    ///
    /// # Errors
    /// [`SimError::Net`] or [`SimError::Layout`] for a net that cannot be controlled, [`SimError::ProgramPhase`] or
    /// [`SimError::ProgramFile`] if a program of SUMO's cannot be written for it.
    pub fn new(home: &SumoHome, scenario: &Scenario, options: EnvOptions) -> Result<Self, SimError> {
        let (net, layout) = layout::read(scenario, &options.config)?;
        let config = &options.config;
        let programs = ProgramFile::write(options.signals, &net, &layout)?;
        let mut env = Self {
            home: home.clone(),
            scenario: scenario.clone(),
            signals: SignalTiming::new(&layout, config.decision_seconds, config.yellow_seconds),
            programs,
            lanes: LaneTable::new(&layout, f64::from(config.reward_range_metres)),
            observation: Observation::default(),
            rewards: vec![0.0; layout.agents()],
            simulation: None,
            time: f64::from(scenario.begin),
            steps: 0,
            timings: Timings::default(),
            replaced: None,
            layout,
            options,
        };
        env.look();
        Ok(env)
    }

    /// The agents.
    #[must_use]
    pub fn layout(&self) -> &Arc<NetworkLayout> {
        &self.layout
    }

    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The options.
    #[must_use]
    pub fn options(&self) -> &EnvOptions {
        &self.options
    }

    /// Starts an episode: every agent shows its phase 0, or what its program begins with, and no vehicle is there yet. A
    /// SUMO that is still running is used again, and ends what it was at; [`finish`](Self::finish) completes its output
    /// files before this episode writes them anew.
    ///
    /// # Errors
    /// [`SimError::Traci`] if SUMO does not start or refuses the network's signals, [`SimError::ProgramNotRunning`] if it
    /// does not run the program it was given. The environment can be reset again.
    pub fn reset(&mut self, seed: u32) -> Result<(), SimError> {
        let running = self.simulation.take();
        self.steps = 0;
        self.time = f64::from(self.scenario.begin);
        self.lanes.clear();
        let begun = Instant::now();
        let started = self.start(running, seed);
        self.timings.sumo += begun.elapsed();
        self.simulation = Some(started?);
        self.look();
        Ok(())
    }

    /// Has a SUMO at the beginning of an episode, the `running` one if it can be.
    fn start(&mut self, running: Option<Simulation>, seed: u32) -> Result<Simulation, SimError> {
        let programs = self.programs.as_ref().map(ProgramFile::path);
        let (scenario, options, programs) = (&self.scenario, &self.options, programs.as_deref());
        let again = match running {
            None => None,
            Some(running) => running.restart(scenario, options, programs, seed).unwrap_or_else(|error| {
                // It may have been killed since; what was asked for is a beginning, which another SUMO gives too.
                tracing::warn!(scenario = %scenario.name, "starting another SUMO: {error}");
                self.replaced = Some(error.kind());
                None
            }),
        };
        let mut simulation = match again {
            Some(simulation) => simulation,
            None => Simulation::start(&self.home, scenario, options, programs, seed)?,
        };
        let commands = self.signals.reset();
        match self.options.signals {
            Signals::Driven => {
                simulation.show(commands.filter_map(|command| shown(&self.layout, command)))?;
                simulation.settle()?;
            }
            Signals::Program(program) => {
                drop(commands);
                programs::follow(program, &mut simulation, &self.layout, &mut self.signals)?;
            }
        }
        Ok(simulation)
    }

    /// What the agents see now.
    #[must_use]
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// Vehicles on the lanes now.
    #[must_use]
    pub fn lanes(&self) -> &LaneTable {
        &self.lanes
    }

    /// Simulated time, seconds; begins at the scenario's `begin`.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Decisions made in this episode.
    #[must_use]
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Process id of the running SUMO.
    #[must_use]
    pub fn sumo_pid(&self) -> Option<u32> {
        self.simulation.as_ref().map(Simulation::pid)
    }

    /// Where the time went.
    #[must_use]
    pub fn timings(&self) -> Timings {
        self.timings
    }

    /// What was wrong with the SUMO that the last [`reset`](Self::reset) found and had to replace, if it did; tells it once.
    pub fn take_replaced(&mut self) -> Option<ErrorKind> {
        self.replaced.take()
    }

    /// Takes one action, a phase index, for each agent, and simulates to the next decision. Under a
    /// [program](Signals::Program) of SUMO's the actions say nothing, and are not looked at.
    ///
    /// # Errors
    /// [`SimError::Action`] for actions that do not exist, [`SimError::NotRunning`] before a reset,
    /// [`SimError::EpisodeOver`] after the last step: nothing has changed then. [`SimError::Traci`] if SUMO failed,
    /// [`SimError::ProgramNotRunning`] if it left its program; the episode is lost then, SUMO has ended, and the environment
    /// can be reset.
    pub fn step(&mut self, actions: &[u8]) -> Result<Step<'_>, SimError> {
        self.begin_step(actions)?.complete()
    }

    /// As [`step`](Self::step), but returns when SUMO has been told, so that there is time for something else while it
    /// simulates.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn begin_step(&mut self, actions: &[u8]) -> Result<StepUnderWay<'_>, SimError> {
        let mut simulation = self.take_simulation()?;
        let begun = Instant::now();
        let driven = self.options.signals == Signals::Driven;
        let ordered = self
            .order(&mut simulation, actions, &mut |simulation, _, seconds| simulation.run(seconds))
            // Under a program of SUMO's it is asked what that shows before it is asked who is there.
            .and_then(|()| if driven { Ok(simulation.begin()?) } else { Ok(simulation.flush()?) });
        self.timings.traci += begun.elapsed();
        match ordered {
            Ok(()) => Ok(StepUnderWay { env: self, simulation }),
            Err(error) => {
                self.put_back(simulation, &error);
                Err(error)
            }
        }
    }

    /// As [`step`](Self::step), second by second, each shown to the observer.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn step_observed(
        &mut self,
        actions: &[u8],
        observer: &mut dyn SecondObserver,
    ) -> Result<Step<'_>, SimError> {
        let mut simulation = self.take_simulation()?;
        let begun = Instant::now();
        // What the agents see and are rewarded for is of the last second.
        let mut left = self.options.config.decision_seconds;
        let mut watch = |simulation: &mut Simulation, lanes: &mut LaneTable, seconds| {
            for _ in 0..seconds {
                left = left.saturating_sub(1);
                let look = if left == 0 { Look::Positions } else { Look::Lanes };
                if let Some(second) = simulation.watch(look, lanes)? {
                    observer.second(&view(second, lanes));
                }
            }
            Ok(())
        };
        let outcome = self.order(&mut simulation, actions, &mut watch).and_then(|()| {
            if let Some(second) = simulation.watched(&mut self.lanes)? {
                observer.second(&view(second, &self.lanes));
            }
            self.follow(&mut simulation)
        });
        self.conclude(begun, simulation, outcome)
    }

    /// The running simulation, if a step can be made with it. It has to be put back.
    fn take_simulation(&mut self) -> Result<Simulation, SimError> {
        let limit = self.options.config.steps_per_episode();
        if self.simulation.is_some() && self.steps >= limit {
            return Err(SimError::EpisodeOver { steps: limit });
        }
        self.simulation.take().ok_or(SimError::NotRunning)
    }

    /// Keeps the simulation if the actions were at fault, before which nothing has happened; after any other error it is in
    /// no state that the episode could go on from.
    fn put_back(&mut self, simulation: Simulation, error: &SimError) {
        if matches!(error, SimError::Action(_)) {
            self.simulation = Some(simulation);
        }
    }

    /// Has SUMO show what the actions lead to; `pass` is for the seconds that go by in between.
    fn order(
        &mut self,
        simulation: &mut Simulation,
        actions: &[u8],
        pass: &mut dyn FnMut(&mut Simulation, &mut LaneTable, u32) -> Result<(), TraciError>,
    ) -> Result<(), SimError> {
        let mut states = Vec::new();
        let (decided, passed) = match self.options.signals {
            Signals::Driven => (Some(self.signals.decide(actions)?), None),
            Signals::Program(_) => {
                (None, Some(Command::Run { seconds: self.options.config.decision_seconds }))
            }
        };
        for command in decided.into_iter().flatten().chain(passed) {
            let Command::Run { seconds } = command else {
                states.extend(shown(&self.layout, command));
                continue;
            };
            simulation.show(states.drain(..))?;
            pass(simulation, &mut self.lanes, seconds)?;
        }
        Ok(())
    }

    /// Sees what SUMO's own program shows, if one runs.
    fn follow(&mut self, simulation: &mut Simulation) -> Result<(), SimError> {
        match self.options.signals {
            Signals::Driven => Ok(()),
            Signals::Program(program) => {
                programs::follow(program, simulation, &self.layout, &mut self.signals)
            }
        }
    }

    /// Ends a step whose work began at `begun` and has this outcome.
    fn conclude(
        &mut self,
        begun: Instant,
        mut simulation: Simulation,
        outcome: Result<(), SimError>,
    ) -> Result<Step<'_>, SimError> {
        let stepping = simulation.take_stepping();
        if let Err(error) = outcome {
            self.put_back(simulation, &error);
            return Err(error);
        }
        self.time = simulation.time();
        self.simulation = Some(simulation);
        self.steps += 1;
        self.look();
        self.timings.sumo += stepping;
        self.timings.traci += begun.elapsed().saturating_sub(stepping);
        Ok(Step { rewards: &self.rewards, done: self.steps >= self.options.config.steps_per_episode() })
    }

    /// Brings observation and rewards up to the lane counts.
    fn look(&mut self) {
        observe::observe(&self.lanes, self.options.config.detection, &mut self.observation.counts);
        self.observation.phases.clear();
        self.observation.phases.extend_from_slice(self.signals.phases());
        observe::rewards(&self.lanes, self.options.config.reward_beyond, &mut self.rewards);
    }

    /// Ends SUMO in order, so that its output files are complete; nothing to do if none is running. The environment can
    /// be reset for another episode.
    ///
    /// # Errors
    /// [`SimError::Traci`] if SUMO does not end well; it has ended all the same.
    pub fn finish(&mut self) -> Result<(), SimError> {
        if let Some(simulation) = self.simulation.take() {
            let report = timed(&mut self.timings.sumo, || simulation.close())?;
            for line in report.last_lines {
                tracing::debug!(scenario = %self.scenario.name, line, "SUMO said");
            }
        }
        Ok(())
    }

    /// [`finish`](Self::finish)es and gives the environment up.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn close(mut self) -> Result<(), SimError> {
        self.finish()
    }
}

fn shown<'a>(layout: &'a NetworkLayout, command: Command<'a>) -> Option<simulation::Shown<'a>> {
    match command {
        Command::Show { agent, state } => Some((&layout.intersections[agent].id, state)),
        Command::Run { .. } => None,
    }
}

fn view(second: Second, lanes: &LaneTable) -> SecondView<'_> {
    let Second { time, traffic, events } = second;
    SecondView {
        time,
        lanes,
        running: traffic.running,
        mean_speed: traffic.mean_speed,
        arrived: events.arrived,
        departed: events.departed,
        teleports: events.teleports,
        waiting_to_enter: events.waiting_to_enter,
    }
}

fn timed<T>(total: &mut Duration, work: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = work();
    *total += begun.elapsed();
    result
}
