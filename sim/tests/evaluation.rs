//! Evaluation on real SUMO: metrics beside SUMO's own outputs, repetition, failures.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

use cross_config::EnvConfig;
use cross_sim::controller::{Controller, ControllerError, ControllerView, FixedTime, RuleBased};
use cross_sim::env::{Env, EnvOptions};
use cross_sim::evaluate::{EvalReport, EvaluateError, Setting, evaluate, evaluate_seeds, strongest, table};
use cross_sim::metrics::{Metric, SecondMeter, TripTotals};
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use std::collections::HashSet;
use std::ops::ControlFlow;
use std::path::Path;
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

/// Value of an attribute in a line of XML, without the parser under test.
fn attribute<'l>(line: &'l str, name: &str) -> Option<&'l str> {
    let from = line.find(&format!(" {name}=\""))? + name.len() + 3;
    Some(&line[from..from + line[from..].find('"')?])
}

fn number(line: &str, name: &str) -> f64 {
    attribute(line, name).unwrap_or_else(|| panic!("no {name} in {line}")).parse().unwrap()
}

fn lines(path: &Path, element: &str) -> Vec<String> {
    let open = format!("<{element} ");
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().filter(|line| line.trim_start().starts_with(&open)).map(str::to_owned).collect()
}

fn close(ours: f64, theirs: f64, tolerance: f64, what: &str) {
    assert!((ours - theirs).abs() <= tolerance, "{what}: ours {ours}, SUMO's {theirs}");
}

/// Runs an episode by hand, with all of SUMO's own records.
fn recorded(ground: &Ground, folder: &Path) -> (SecondMeter, TripTotals) {
    let file = |name: &str| folder.join(name).display().to_string();
    let options = EnvOptions {
        tripinfo: Some(folder.join("trips.xml")),
        extra_args: [
            ["--summary-output", &file("summary.xml")],
            ["--fcd-output", &file("fcd.xml")],
            ["--statistic-output", &file("statistics.xml")],
            ["--precision", "9"],
        ]
        .concat()
        .into_iter()
        .map(str::to_owned)
        .collect(),
        ..EnvOptions::new(ground.env.clone())
    };
    let mut env = Env::new(&ground.home, &ground.scenario, options).unwrap();
    env.reset(5).unwrap();
    let layout = env.layout().clone();
    let mut meter = SecondMeter::default();
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
        env.step_observed(&actions, &mut meter).unwrap();
    }
    env.finish().unwrap();
    (meter, TripTotals::read(&folder.join("trips.xml")).unwrap())
}

#[test]
fn metrics_agree_with_sumos_own_outputs() {
    for name in ["grid4x4", "arterial4x4"] {
        let ground = Ground::new(name);
        let folder = tempfile::tempdir().unwrap();
        let (meter, trips) = recorded(&ground, folder.path());
        let begin = f64::from(ground.scenario.begin);

        // Queue: halting vehicles on lanes that a signal controls, from the position record of every vehicle.
        let net = std::fs::read_to_string(&ground.scenario.net).unwrap();
        let signalised: HashSet<String> = net
            .lines()
            .filter(|line| line.contains("<connection ") && line.contains(" tl=\""))
            .map(|line| {
                format!("{}_{}", attribute(line, "from").unwrap(), attribute(line, "fromLane").unwrap())
            })
            .collect();
        let mut halting = 0;
        let (mut seconds, mut time) = (0, 0.0);
        for line in std::fs::read_to_string(folder.path().join("fcd.xml")).unwrap().lines() {
            if line.contains("<timestep ") {
                time = number(line, "time");
                seconds += u32::from(time >= begin && time < begin + f64::from(SECONDS));
            } else if line.contains("<vehicle ") && time < begin + f64::from(SECONDS) {
                let lane = attribute(line, "lane").unwrap();
                halting += u32::from(signalised.contains(lane) && number(line, "speed") < 0.1);
            }
        }
        assert_eq!(seconds, SECONDS, "{name}: SUMO recorded every second");
        assert!(halting > 1000, "{name}: {halting} halts are too few to tell anything");
        let queue = f64::from(halting) / f64::from(SECONDS) / signalised.len() as f64;
        close(meter.queue_length().mean, queue, 1e-9, "queue length");

        // Speed, arrivals, departures: from the summary of every second.
        let summary = lines(&folder.path().join("summary.xml"), "step");
        let summary = &summary[..SECONDS as usize];
        // SUMO writes -1 for the mean speed of no vehicles.
        let speeds = summary.iter().map(|line| number(line, "meanSpeed").max(0.0));
        close(meter.speed().mean, speeds.sum::<f64>() / f64::from(SECONDS), 1e-6, "speed");
        let last = summary.last().unwrap();
        close(meter.arrived() as f64, number(last, "arrived"), 0.0, "arrived");
        close(meter.departed() as f64, number(last, "inserted"), 0.0, "departed");
        let rate = number(last, "arrived") / f64::from(SECONDS);
        close(meter.trip_completion_rate().mean, rate, 1e-9, "trip completion rate");

        // Vehicles: from SUMO's own totals, which count finished and unfinished trips, as ours do.
        close(trips.finished() as f64, number(last, "arrived"), 0.0, "finished");
        close(trips.unfinished() as f64, number(last, "running"), 0.0, "unfinished");
        // SUMO's last attempt to insert is at the beginning of the last second; who is due within that second counts as
        // never inserted, too, but not as waiting yet.
        let due_too_late = lines(&folder.path().join("trips.xml"), "tripinfo")
            .iter()
            .filter(|line| number(line, "depart") < 0.0)
            .filter(|line| number(line, "departDelay") > 0.0 && number(line, "departDelay") < 1.0)
            .count();
        let waiting = number(last, "waiting") + due_too_late as f64;
        close(trips.never_inserted() as f64, waiting, 0.0, "never inserted");
        let totals = &lines(&folder.path().join("statistics.xml"), "vehicleTripStatistics")[0];
        close((trips.finished() + trips.unfinished()) as f64, number(totals, "count"), 0.0, "trips");
        let total = number(totals, "totalTravelTime");
        close(trips.trip_time().mean, total / number(totals, "count"), 1e-6, "trip time");
        // These two SUMO gives only as means, cut to the milliseconds of its clock, as are the values they are taken of.
        close(trips.trip_delay().mean, number(totals, "waitingTime"), 2e-3, "trip delay");
        close(trips.time_loss().mean, number(totals, "timeLoss"), 2e-3, "time loss");
        assert!(trips.trip_delay().mean > 1.0, "{name}: somebody waited");
        assert!(trips.trip_duration().mean > 0.0);
    }
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
