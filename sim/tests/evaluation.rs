//! Evaluation on real SUMO: repetition, details, failures. Metrics beside SUMO's own outputs are in `agreement.rs`.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

use cross_config::EnvConfig;
use cross_sim::controller::{Controller, ControllerError, ControllerView, FixedTime, RuleBased};
use cross_sim::env::{Env, EnvOptions};
use cross_sim::evaluate::{EvalReport, EvaluateError, Setting, evaluate, evaluate_seeds, strongest, table};
use cross_sim::metrics::{EpisodeMetrics, Metric, SecondMeter, TripTotals};
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use std::ops::ControlFlow;
use std::sync::Mutex;

/// Long enough for arrivals at the first stop lines, queues and finished trips, and for the gridlock rule to apply.
const SECONDS: u32 = 600;

struct Ground {
    home: SumoHome,
    scenario: Scenario,
    env: EnvConfig,
}

impl Ground {
    fn new(scenario: &str) -> Self {
        Self {
            home: SumoHome::locate(None).expect("set-up installed SUMO"),
            scenario: Scenario::load(scenario).expect("set-up fetched the maps"),
            env: EnvConfig { episode_seconds: SECONDS, ..EnvConfig::default() },
        }
    }

    fn setting(&self) -> Setting<'_> {
        Setting::new(&self.home, &self.scenario, &self.env)
    }

    fn report(&self, policy: RuleBased, seeds: &[u32], workers: usize) -> EvalReport {
        let make = || Ok(policy.controller(self.scenario.reference.max_pressure));
        evaluate_seeds(&self.setting(), policy.name(), &make, seeds, workers, &go_on).unwrap()
    }
}

fn go_on<T>(_: T) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

#[test]
fn an_evaluation_repeats_itself_whatever_the_number_of_workers() {
    let ground = Ground::new("grid4x4");
    let seeds = [3, 1, 2];
    for policy in [RuleBased::Random, RuleBased::MaxPressure] {
        let alone = ground.report(policy, &seeds, 1);
        let together = ground.report(policy, &seeds, 2);
        assert_eq!(alone.to_json(), together.to_json());
        assert_eq!(alone.seeds, [1, 2, 3]);
        let delays: Vec<_> =
            alone.per_seed.iter().map(|episode| episode.get(Metric::TripDelay).mean).collect();
        assert!(delays[0] != delays[1] && delays[1] != delays[2], "seeds differ: {delays:?}");
    }
}

/// Runs an episode by hand as an evaluation does, but without SUMO's emissions device and without records of details.
fn without_emissions(ground: &Ground, seed: u32) -> EpisodeMetrics {
    let folder = tempfile::tempdir().unwrap();
    let trips = folder.path().join("trips.xml");
    let options = EnvOptions { tripinfo: Some(trips.clone()), ..EnvOptions::new(ground.env.clone()) };
    let mut env = Env::new(&ground.home, &ground.scenario, options).unwrap();
    env.reset(seed).unwrap();
    let layout = env.layout().clone();
    let mut meter = SecondMeter::default();
    let mut total_reward = 0.0;
    let mut actions = vec![0; layout.agents()];
    for step in 0..ground.env.steps_per_episode() {
        let view = ControllerView {
            layout: &layout,
            observation: env.observation(),
            lanes: env.lanes(),
            step,
            time: env.time(),
        };
        FixedTime.act(&view, &mut actions).unwrap();
        let outcome = env.step_observed(&actions, &mut meter).unwrap();
        total_reward += outcome.rewards.iter().map(|&reward| f64::from(reward)).sum::<f64>();
    }
    env.finish().unwrap();
    let trips = TripTotals::read(&trips).unwrap();
    EpisodeMetrics::new(seed, &meter, &trips, total_reward / layout.agents() as f64)
}

#[test]
fn measuring_emissions_and_details_changes_nothing_in_the_traffic() {
    for name in ["grid4x4", "arterial4x4", "cologne1"] {
        let ground = Ground::new(name);
        let plain = without_emissions(&ground, 7);
        let setting = Setting { details: true, ..ground.setting() };
        let measured = evaluate(&setting, &mut FixedTime, 7, &mut go_on).unwrap().metrics;
        for metric in Metric::ALL {
            if matches!(metric, Metric::Co2 | Metric::Fuel) {
                assert_eq!(plain.get(metric).mean, 0.0, "{name}: nobody measured {}", metric.key());
                assert!(measured.get(metric).mean > 0.0, "{name}: {}", metric.key());
            } else {
                assert_eq!(plain.get(metric), measured.get(metric), "{name}: {}", metric.key());
            }
        }
        assert_eq!(plain.vehicles, measured.vehicles);
        assert_eq!(plain.episode_return, measured.episode_return);
        // A litre of petrol weighs 750 g and becomes 2.3 kg of carbon dioxide.
        let ratio = measured.get(Metric::Co2).mean / measured.get(Metric::Fuel).mean;
        assert!((2.9..3.3).contains(&ratio), "{name}: {ratio} g of CO2 per g of fuel");
    }
}

#[test]
fn details_are_those_of_the_metrics_and_small_enough_for_a_page() {
    let ground = Ground::new("grid4x4");
    let env = EnvConfig { episode_seconds: 3600, ..EnvConfig::default() };
    let setting = Setting { env: &env, details: true, ..ground.setting() };
    let make = || Ok(RuleBased::MaxPressure.controller(ground.scenario.reference.max_pressure));
    let report = evaluate_seeds(&setting, "max-pressure", &make, &[2, 1, 3], 2, &go_on).unwrap();
    let json = report.to_json();
    assert!(json.len() < 2_000_000, "{} bytes", json.len());
    assert_eq!(EvalReport::from_json(&json).unwrap(), report);

    let details = report.details.as_ref().unwrap();
    assert_eq!((details.network.edges.len(), details.network.signals.len()), (80, 16));
    assert!(details.network.edges.iter().all(|edge| edge.lanes == 3 && edge.shape.len() >= 2));
    assert_eq!(details.network.edges[0].shape, [[304.8, 313.6], [304.8, 586.4]]);
    assert_eq!(details.seeds.iter().map(|seed| seed.seed).collect::<Vec<_>>(), report.seeds);
    for (seed, metrics) in details.seeds.iter().zip(&report.per_seed) {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let close = |ours: f64, metric: Metric| {
            let theirs = metrics.get(metric).mean;
            assert!((ours - theirs).abs() < 1e-4, "{}: {ours} and {theirs}", metric.key());
        };
        close(mean(&seed.series.queue_length), Metric::QueueLength);
        close(mean(&seed.series.speed), Metric::Speed);
        assert_eq!(seed.series.arrived.len(), 360);
        assert_eq!(u64::from(seed.series.arrived.iter().sum::<u32>()), metrics.vehicles.finished);
        let trips = &seed.trips;
        close(mean(&[&trips.finished.trip_time[..], &trips.unfinished.trip_time].concat()), Metric::TripTime);
        close(
            mean(&[&trips.finished.trip_delay[..], &trips.unfinished.trip_delay].concat()),
            Metric::TripDelay,
        );
        close(mean(&trips.finished.trip_time), Metric::FinishedTripTime);
        assert_eq!(trips.never_inserted.len() as u64, metrics.vehicles.never_inserted);
        // All junctions are alike, so that the network's queue is the mean of theirs, and theirs that of their roads.
        let queues: Vec<_> = seed.intersections.iter().map(|at| at.queue_length).collect();
        close(mean(&queues), Metric::QueueLength);
        for (at, signal) in seed.intersections.iter().zip(&details.network.signals) {
            assert_eq!(at.id, signal.id);
            let roads: Vec<_> = at.roads.iter().map(|road| road.queue_length).collect();
            assert!((mean(&roads) - at.queue_length).abs() < 1e-3, "{at:?}");
            assert!(
                at.vehicles >= at.stopped && (at.stopped - 12.0 * at.queue_length).abs() < 1e-2,
                "{at:?}"
            );
            let drawn = |edge: &str| details.network.edges.iter().any(|drawn| drawn.id == edge);
            assert!(at.roads.iter().all(|road| drawn(&road.edge)), "{at:?}");
        }
    }
}

#[test]
fn controllers_rank_as_everybody_knows() {
    let ground = Ground::new("grid4x4");
    let seeds = [1];
    let fixed = ground.report(RuleBased::FixedTime, &seeds, 1);
    let variants = RuleBased::MAX_PRESSURE_VARIANTS.map(|policy| ground.report(policy, &seeds, 1));
    let best = strongest(&variants).unwrap();
    let delay = |report: &EvalReport| report.get(Metric::TripDelay).mean;
    assert!(delay(best) < delay(&fixed) / 1.5, "{} against {}", delay(best), delay(&fixed));
    assert!(best.episode_return > fixed.episode_return);
    // The scenario's own variant is one of the three, under another name.
    let own = ground.report(RuleBased::MaxPressure, &seeds, 1);
    assert_eq!((own.policy.as_str(), own.controller.as_str()), ("max-pressure", "max-pressure-all"));
    let same = variants.iter().find(|report| report.policy == own.controller).unwrap();
    assert_eq!(same.per_seed, own.per_seed);

    let text = table(&[fixed, best.clone()]);
    assert!(text.contains("fixed-time") && text.contains(&best.policy) && text.contains("grid4x4, seed 1"));
}

/// Fails at its third decision.
struct Breaks;

impl Controller for Breaks {
    fn name(&self) -> &str {
        "breaks"
    }

    fn act(&mut self, view: &ControllerView<'_>, _: &mut [u8]) -> Result<(), ControllerError> {
        if view.step == 2 { Err("no idea what to do".into()) } else { Ok(()) }
    }
}

#[test]
fn a_controllers_error_ends_the_evaluation_with_its_words() {
    let ground = Ground::new("grid4x4");
    let seen = Mutex::new(0);
    let progress = |progress: cross_sim::evaluate::SeedProgress| {
        let mut seen = seen.lock().unwrap();
        *seen = progress.step.max(*seen);
        ControlFlow::Continue(())
    };
    let make = || -> Result<Box<dyn Controller>, ControllerError> { Ok(Box::new(Breaks)) };
    let error = evaluate_seeds(&ground.setting(), "mine", &make, &[1, 2], 2, &progress).unwrap_err();
    assert!(matches!(error, EvaluateError::Controller { .. }), "{error:?}");
    assert_eq!(error.to_string(), "the policy breaks failed: no idea what to do");
    assert_eq!(*seen.lock().unwrap(), 2);

    let make = || -> Result<Box<dyn Controller>, ControllerError> { Err("no such checkpoint".into()) };
    let error = evaluate_seeds(&ground.setting(), "mine", &make, &[1], 1, &go_on).unwrap_err();
    assert_eq!(error.to_string(), "the policy mine failed: no such checkpoint");
}

/// Asks for a phase that does not exist.
struct Wild;

impl Controller for Wild {
    fn name(&self) -> &str {
        "wild"
    }

    fn act(&mut self, _: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        actions.fill(200);
        Ok(())
    }
}

#[test]
fn an_impossible_phase_is_refused() {
    let ground = Ground::new("grid4x4");
    let error = evaluate(&ground.setting(), &mut Wild, 1, &mut go_on).unwrap_err();
    assert!(matches!(error, EvaluateError::Sim(_)), "{error:?}");
    assert!(error.to_string().contains("200"), "{error}");
}

#[test]
fn the_progress_callback_can_stop_an_evaluation() {
    let ground = Ground::new("grid4x4");
    let mut steps = Vec::new();
    let stop_at_3 = &mut |progress: cross_sim::evaluate::Progress| {
        steps.push((progress.step, progress.steps));
        if progress.step == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let error = evaluate(&ground.setting(), &mut FixedTime, 1, stop_at_3).unwrap_err();
    assert!(matches!(error, EvaluateError::Stopped));
    assert_eq!(steps, [(1, 60), (2, 60), (3, 60)]);
}

/// A seed that no other test uses, by which the SUMO that is to die is found.
const SEED_TO_KILL: u32 = 987_654;

/// Kills its SUMO once, at the tenth decision.
struct Killer {
    killed: usize,
}

impl Controller for Killer {
    fn name(&self) -> &str {
        "killer"
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        if view.step == 10 && self.killed == 0 {
            for pid in own_children() {
                let arguments = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
                if arguments.contains(&format!("--seed\0{SEED_TO_KILL}\0")) {
                    std::process::Command::new("kill").args(["-KILL", &pid]).status()?;
                    self.killed += 1;
                }
            }
        }
        FixedTime.act(view, actions)
    }
}

/// Process ids of what this process started, from any of its threads.
fn own_children() -> Vec<String> {
    let threads = std::fs::read_dir("/proc/self/task").unwrap();
    // A thread that ends meanwhile has no children any more.
    let children = threads.flatten().filter_map(|t| std::fs::read_to_string(t.path().join("children")).ok());
    children.flat_map(|pids| pids.split_whitespace().map(str::to_owned).collect::<Vec<_>>()).collect()
}

#[test]
fn an_episode_begins_anew_when_its_sumo_dies() {
    let ground = Ground::new("grid4x4");
    let mut killer = Killer { killed: 0 };
    let disturbed = evaluate(&ground.setting(), &mut killer, SEED_TO_KILL, &mut go_on).unwrap();
    assert_eq!(killer.killed, 1);
    let undisturbed = evaluate(&ground.setting(), &mut FixedTime, SEED_TO_KILL, &mut go_on).unwrap();
    assert_eq!(disturbed, undisturbed);
}
