//! Our side: an episode through all that an actor does with it, but for sending.

use crate::command_line;
use crate::cost::{Cost, measured};
use crate::error::BenchError;
use cross_actor::recorder::{EpisodeHeader, Recorder};
use cross_model::{ActMode, Policy};
use cross_proto::v1;
use cross_sim::controller::{Controller, ControllerView};
use cross_sim::env::{Env, EnvOptions};
use cross_sim::metrics::{SecondMeter, TripTotals};
use cross_sim::scenario::Scenario;
use cross_sim::trajectory::FragmentEnd;
use cross_traci::SumoHome;
use prost::Message;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::ffi::OsString;
use std::path::Path;

/// Who chooses, and what is done besides.
pub(super) enum Driver<'a> {
    /// A rule.
    Rule(&'a mut dyn Controller),
    /// A rule, with the metrics of every second and of every vehicle.
    Measured(&'a mut dyn Controller),
    /// A policy, whose steps are recorded and encoded in fragments of so many steps.
    Policy(&'a mut Policy, u32),
}

/// An episode that was driven.
#[derive(Debug)]
pub(super) struct Driven {
    pub(super) cost: Cost,
    /// `[steps][agents]`.
    pub(super) actions: Vec<Vec<u8>>,
    /// SUMO's arguments.
    pub(super) arguments: Vec<OsString>,
    /// Bytes of the encoded fragments, if there are any.
    pub(super) encoded: Option<usize>,
}

/// Drives one episode, from SUMO's start to its end; `trips` is where SUMO records the vehicles.
pub(super) fn drive(
    home: &SumoHome,
    scenario: &Scenario,
    config: &cross_config::EnvConfig,
    seed: u32,
    trips: &Path,
    driver: Driver<'_>,
) -> Result<Driven, BenchError> {
    let options = EnvOptions { tripinfo: Some(trips.to_owned()), ..EnvOptions::new(config.clone()) };
    // Reading the net is done once in an actor's life.
    let mut env = Env::new(home, scenario, options)?;
    let ((actions, arguments, encoded), cost) = measured(|| {
        env.reset(seed)?;
        let arguments = env.sumo_pid().map_or_else(|| Ok(Vec::new()), command_line::of_process)?;
        let (actions, encoded) = match driver {
            Driver::Rule(rule) => (by_rule(&mut env, rule, seed, None)?, None),
            Driver::Measured(rule) => {
                let mut meter = SecondMeter::default();
                let actions = by_rule(&mut env, rule, seed, Some(&mut meter))?;
                env.finish()?;
                let totals = TripTotals::read(trips)?;
                std::hint::black_box((meter.queue_length(), meter.speed(), totals.trip_time()));
                (actions, None)
            }
            Driver::Policy(policy, steps) => {
                let mut bytes = 0;
                let mut encode = |fragment: v1::Fragment| bytes += fragment.encode_to_vec().len();
                (by_policy(&mut env, policy, steps, seed, &mut encode)?, Some(bytes))
            }
        };
        env.finish()?;
        Ok((actions, arguments, encoded))
    })?;
    Ok(Driven { cost, actions, arguments, encoded })
}

/// An episode of the choices of a rule: `[steps][agents]`.
pub(crate) fn by_rule(
    env: &mut Env,
    rule: &mut dyn Controller,
    seed: u32,
    mut meter: Option<&mut SecondMeter>,
) -> Result<Vec<Vec<u8>>, BenchError> {
    let layout = env.layout().clone();
    let failed = |source| BenchError::Controller { source };
    rule.reset(&layout, u64::from(seed)).map_err(failed)?;
    let mut chosen = Vec::new();
    loop {
        let mut actions = env.observation().phases.clone();
        let view = ControllerView {
            layout: &layout,
            observation: env.observation(),
            lanes: env.lanes(),
            step: env.steps(),
            time: env.time(),
        };
        rule.act(&view, &mut actions).map_err(failed)?;
        let done = match &mut meter {
            Some(meter) => env.step_observed(&actions, *meter)?.done,
            None => env.step(&actions)?.done,
        };
        chosen.push(actions);
        if done {
            return Ok(chosen);
        }
    }
}

/// An episode that a policy steers, sampling; `finished` gets its fragments as they go over the wire. Returns the actions,
/// `[steps][agents]`.
pub(crate) fn by_policy(
    env: &mut Env,
    policy: &mut Policy,
    fragment_steps: u32,
    seed: u32,
    finished: &mut dyn FnMut(v1::Fragment),
) -> Result<Vec<Vec<u8>>, BenchError> {
    let header = EpisodeHeader {
        actor: "bench".to_owned(),
        session_epoch: 1,
        episode: 1,
        scenario: env.scenario().name.clone(),
        layout_hash: env.layout().hash(),
    };
    let mut recorder = Recorder::new(header, fragment_steps);
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(seed));
    policy.begin_episode(&env.layout().clone())?;
    recorder.begin_fragment(policy.version(), policy.recurrent_state());
    let mut chosen = Vec::new();
    loop {
        let decision = policy.act(env.observation(), ActMode::Sample(&mut rng))?;
        let step = env.begin_step(&decision.actions)?;
        recorder.decide(step.before(), &decision);
        policy.catch_up();
        let step = step.complete()?;
        let done = step.done;
        recorder.reward(step.rewards);
        chosen.push(decision.actions);
        if done || recorder.is_full() {
            let end = if done { FragmentEnd::Truncated } else { FragmentEnd::Continues };
            let fragment = recorder.finish_fragment(env.observation(), end);
            finished(v1::Fragment::from(&fragment));
            recorder.begin_fragment(policy.version(), policy.recurrent_state());
        }
        if done {
            return Ok(chosen);
        }
    }
}
