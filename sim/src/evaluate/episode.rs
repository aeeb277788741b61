//! One episode, measured.

use super::details::{SeedDetails, Trips};
use super::recorder::{DetailMeter, Recorder};
use super::{EvaluateError, Setting};
use crate::controller::{Controller, ControllerView};
use crate::env::{Env, EnvOptions};
use crate::metrics::{EpisodeMetrics, Fate, Trip, TripTotals, read_trips};
use std::ops::ControlFlow;

/// How often an episode is begun before SUMO's failures are the result. SUMO repeats itself exactly, so that a failure
/// of its own would come again; what does not is a SUMO that was killed from outside.
const ATTEMPTS: u32 = 3;

/// Gives every vehicle SUMO's emissions device, which adds its carbon dioxide and fuel to the trip output and leaves the
/// traffic as it is.
const EMISSIONS: [&str; 2] = ["--device.emissions.probability", "1"];

/// How far an episode is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Decisions that are made.
    pub step: u32,
    /// Decisions of the episode.
    pub steps: u32,
}

/// What one episode gave.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Its metrics.
    pub metrics: EpisodeMetrics,
    /// What a report page draws of it, if [`Setting::details`] asked for it.
    pub details: Option<SeedDetails>,
}

/// Runs one episode under a controller and measures it.
///
/// `sumo_seed` also seeds the controller, so that the same seed gives the same episode. `progress` is called after each
/// decision and may end the episode. If SUMO dies, the episode begins anew, twice at most.
///
/// # Errors
/// [`EvaluateError`]: SUMO or the controller failed, or `progress` asked to stop.
pub fn evaluate(
    setting: &Setting<'_>,
    controller: &mut dyn Controller,
    sumo_seed: u32,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Episode, EvaluateError> {
    let mut attempt = 1;
    loop {
        match run(setting, controller, sumo_seed, progress) {
            Err(EvaluateError::Sim(error)) if error.is_simulator_failure() && attempt < ATTEMPTS => {
                tracing::warn!(
                    scenario = setting.scenario.name,
                    seed = sumo_seed,
                    attempt,
                    %error,
                    "beginning the episode anew"
                );
                attempt += 1;
            }
            result => return result,
        }
    }
}

fn run(
    setting: &Setting<'_>,
    controller: &mut dyn Controller,
    sumo_seed: u32,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Episode, EvaluateError> {
    // It goes, with SUMO's file in it, when the episode is over, however that happens.
    let folder = tempfile::Builder::new()
        .prefix("cross-eval-")
        .tempdir()
        .map_err(|source| EvaluateError::Folder { source })?;
    let trips = folder.path().join("tripinfo.xml");
    let options = EnvOptions {
        signals: controller.signals(),
        timeout: setting.timeout,
        tripinfo: Some(trips.clone()),
        extra_args: EMISSIONS.map(str::to_owned).to_vec(),
        ..EnvOptions::new(setting.env.clone())
    };
    let mut env = Env::new(setting.home, setting.scenario, options)?;
    env.reset(sumo_seed)?;
    let layout = env.layout().clone();
    let reset = controller.reset(&layout, u64::from(sumo_seed));
    reset.map_err(EvaluateError::controller(controller.name()))?;

    let steps = setting.env.steps_per_episode();
    let details = setting.details.then(|| DetailMeter::new(&layout));
    let mut recorder = Recorder { details, ..Recorder::default() };
    let mut total_reward = 0.0;
    let mut actions = vec![0; layout.agents()];
    for step in 0..steps {
        actions.copy_from_slice(&env.observation().phases);
        let view = ControllerView {
            layout: &layout,
            observation: env.observation(),
            lanes: env.lanes(),
            step,
            time: env.time(),
        };
        let acted = controller.act(&view, &mut actions);
        acted.map_err(EvaluateError::controller(controller.name()))?;
        let outcome = env.step_observed(&actions, &mut recorder)?;
        total_reward += outcome.rewards.iter().map(|&reward| f64::from(reward)).sum::<f64>();
        if progress(Progress { step: step + 1, steps }).is_break() {
            return Err(EvaluateError::Stopped);
        }
    }
    // SUMO writes of the vehicles that are still there when it ends.
    env.finish()?;
    let mut totals = TripTotals::default();
    let mut each = Trips::default();
    read_trips(&trips, &mut |trip| {
        totals.add(trip);
        if setting.details {
            add(&mut each, trip);
        }
    })?;
    let episode_return = total_reward / layout.agents().max(1) as f64;
    let details = recorder.details.map(|meter| {
        let (series, intersections) = meter.finish(&layout);
        SeedDetails { seed: sumo_seed, series, trips: each, intersections }
    });
    let metrics = EpisodeMetrics::new(sumo_seed, &recorder.metrics, &totals, episode_return);
    Ok(Episode { metrics, details })
}

fn add(trips: &mut Trips, trip: &Trip) {
    let times = match trip.fate() {
        Fate::Finished => &mut trips.finished,
        Fate::Unfinished => &mut trips.unfinished,
        Fate::NeverInserted => return trips.never_inserted.push(trip.depart_delay),
        Fate::NotDue => return,
    };
    times.trip_time.push(trip.duration);
    times.trip_delay.push(trip.waiting_time);
}
