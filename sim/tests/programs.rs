//! SUMO's own signal programs: really SUMO's, on every map, the same again for the same seed.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

use cross_config::EnvConfig;
use cross_sim::SimError;
use cross_sim::controller::RuleBased;
use cross_sim::env::{Env, EnvOptions, SecondView, Signals, SumoProgram};
use cross_sim::evaluate::{EvalReport, Setting, evaluate_seeds};
use cross_sim::metrics::Metric;
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use std::ops::ControlFlow;
use std::path::Path;
use std::process::Command;

const REACTIVE: [SumoProgram; 2] = [SumoProgram::Actuated, SumoProgram::DelayBased];

fn home() -> SumoHome {
    SumoHome::locate(None).expect("set-up installed SUMO")
}

fn config(seconds: u32) -> EnvConfig {
    // Decisions close enough to see every green of 5 s.
    EnvConfig { episode_seconds: seconds, decision_seconds: 4, ..EnvConfig::default() }
}

fn env(scenario: &Scenario, program: SumoProgram, seconds: u32) -> Env {
    let options = EnvOptions { signals: Signals::Program(program), ..EnvOptions::new(config(seconds)) };
    Env::new(&home(), scenario, options).unwrap()
}

/// Steps to the end of the episode and returns the phases seen at the decisions.
fn phases(env: &mut Env) -> Vec<Vec<u8>> {
    env.reset(1).unwrap();
    let mut seen = vec![env.observation().phases.clone()];
    // Actions that no agent has: they are not looked at.
    while !env.step(&[255]).unwrap().done {
        seen.push(env.observation().phases.clone());
    }
    env.finish().unwrap();
    seen
}

/// Every decision asks SUMO which program each agent runs, and fails if it is not ours.
fn runs_on_every_map(program: SumoProgram) {
    let maps = [
        "grid4x4",
        "arterial4x4",
        "cologne1",
        "cologne3",
        "cologne8",
        "ingolstadt1",
        "ingolstadt7",
        "ingolstadt21",
        "grid5x5",
    ];
    for map in maps {
        let scenario = Scenario::load(map).unwrap_or_else(|error| panic!("{error}"));
        let seen = phases(&mut env(&scenario, program, 80));
        assert!(seen.windows(2).any(|pair| pair[0] != pair[1]), "{map}: no light changed in 80 s");
    }
}

#[test]
fn actuated_runs_on_every_map() {
    runs_on_every_map(SumoProgram::Actuated);
}

#[test]
fn delay_based_runs_on_every_map() {
    runs_on_every_map(SumoProgram::DelayBased);
}

fn report(scenario: &Scenario, policy: RuleBased, seeds: &[u32], seconds: u32) -> EvalReport {
    let (home, env) = (home(), config(seconds));
    let make = || Ok(policy.controller(scenario.reference.max_pressure));
    let setting = Setting::new(&home, scenario, &env);
    evaluate_seeds(&setting, policy.name(), &make, seeds, 2, &|_| ControlFlow::Continue(())).unwrap()
}

/// Every attribute of this name in a file of trips.
fn total(trips: &Path, attribute: &str) -> (usize, f64) {
    let text = std::fs::read_to_string(trips).unwrap();
    let opening = format!(" {attribute}=\"");
    let parts = text.split(&opening).skip(1);
    let values: Vec<f64> = parts.map(|part| part[..part.find('"').unwrap()].parse().unwrap()).collect();
    (values.len(), values.iter().sum())
}

#[test]
fn the_nets_own_program_is_what_sumo_does_without_us() {
    const SECONDS: u32 = 600;
    let scenario = Scenario::load("cologne3").unwrap();
    let ours = report(&scenario, RuleBased::OwnProgram, &[5], SECONDS);

    let folder = tempfile::tempdir().unwrap();
    let trips = folder.path().join("trips.xml");
    let home = home();
    let output = Command::new(home.binary("sumo"))
        .env("SUMO_HOME", home.path())
        .arg("--net-file")
        .arg(&scenario.net)
        .arg("--route-files")
        .arg(&scenario.routes[0])
        .args(["--begin", &scenario.begin.to_string(), "--end", &(scenario.begin + SECONDS).to_string()])
        .args(["--seed", "5", "--time-to-teleport", "-1", "--no-step-log", "--xml-validation", "never"])
        .args(["--default.departspeed", "0", "--default.departlane", "first", "--no-warnings"])
        .args(["--tripinfo-output.write-unfinished", "--tripinfo-output"])
        .arg(&trips)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (vehicles, waiting) = total(&trips, "waitingTime");
    let (_, stops) = total(&trips, "waitingCount");
    let entered = ours.vehicles.finished + ours.vehicles.unfinished;
    assert_eq!(entered, vehicles as f64);
    assert!(waiting > 1000.0, "somebody waited");
    assert!((ours.get(Metric::TripDelay).mean * entered - waiting).abs() < 1e-6 * waiting);
    assert!((ours.get(Metric::Stops).mean * entered - stops).abs() < 1e-6 * stops);
}

#[test]
fn the_same_seed_gives_the_same_episode_and_each_program_another() {
    let scenario = Scenario::load("cologne3").unwrap();
    let policies = [RuleBased::OwnProgram, RuleBased::Actuated, RuleBased::DelayBased];
    let reports = policies.map(|policy| {
        let first = report(&scenario, policy, &[1, 2], 400);
        assert_eq!(first, report(&scenario, policy, &[2, 1], 400), "{policy}");
        assert_eq!((first.policy.as_str(), first.controller.as_str()), (policy.name(), policy.name()));
        assert_ne!(first.per_seed[0].get(Metric::Speed), first.per_seed[1].get(Metric::Speed));
        first
    });
    let delay = |report: &EvalReport| report.get(Metric::TripDelay).mean;
    let [own, actuated, delay_based] = reports.each_ref().map(delay);
    assert!(
        own != actuated && actuated != delay_based && own != delay_based,
        "{own} {actuated} {delay_based}"
    );
}

#[test]
fn an_actuated_program_serves_traffic_and_not_the_clock() {
    let scenario = Scenario::load("grid4x4").unwrap();
    let delay = |policy| report(&scenario, policy, &[1], 900).get(Metric::TripDelay).mean;
    let (own, actuated) = (delay(RuleBased::OwnProgram), delay(RuleBased::Actuated));
    assert!(actuated < 0.9 * own, "actuated {actuated} s, own {own} s");
}

#[test]
fn watching_each_second_changes_nothing_and_greens_stay_within_their_range() {
    let scenario = Scenario::load("cologne1").unwrap();
    for program in REACTIVE {
        // A decision each second sees every change; this net gives its greens 5 to 50 s, and has yellows of 5 s.
        let config = EnvConfig { decision_seconds: 1, yellow_seconds: 0, ..config(300) };
        let options = EnvOptions { signals: Signals::Program(program), ..EnvOptions::new(config) };
        let mut env = Env::new(&home(), &scenario, options).unwrap();
        let seconds: Vec<u8> = phases(&mut env).iter().map(|phases| phases[0]).collect();
        let mut lasted = vec![1];
        for pair in seconds.windows(2) {
            match (pair[0] == pair[1], lasted.last_mut()) {
                (true, Some(last)) => *last += 1,
                _ => lasted.push(1),
            }
        }
        // The first and the last are cut off.
        let whole = &lasted[1..lasted.len() - 1];
        assert!(whole.len() >= 4, "{program:?}: {lasted:?}");
        assert!(whole.iter().all(|seconds| (10..=55).contains(seconds)), "{program:?}: {lasted:?}");
        assert!(
            whole.iter().any(|seconds| *seconds != whole[0]),
            "{program:?} keeps to no clock: {lasted:?}"
        );

        env.reset(1).unwrap();
        let mut watched = vec![env.observation().phases[0]];
        while !env.step_observed(&[], &mut |_: &SecondView<'_>| {}).unwrap().done {
            watched.push(env.observation().phases[0]);
        }
        assert_eq!(watched, seconds, "{program:?}");
    }
}

#[test]
fn a_plan_that_switches_programs_is_refused_by_the_light() {
    let map = Scenario::load("cologne1").unwrap();
    let light = "GS_cluster_357187_359543";
    let folder = tempfile::tempdir().unwrap();
    let plan = format!(
        "<additional><tlLogic id=\"{light}\" type=\"static\" programID=\"night\" offset=\"0\">\
         <phase duration=\"30\" state=\"GGGGGGGGGGGGGGGGGGGG\"/></tlLogic>\
         <WAUT id=\"plan\" refTime=\"0\" startProg=\"night\"><wautSwitch time=\"{}\" to=\"night\"/></WAUT>\
         <wautJunction wautID=\"plan\" junctionID=\"{light}\"/></additional>",
        map.begin + 30
    );
    let additional = folder.path().join("plan.add.xml");
    std::fs::write(&additional, plan).unwrap();
    let scenario = Scenario { additional: vec![additional], ..map };
    let run = |program| {
        let mut env = env(&scenario, program, 60);
        env.reset(1)?;
        while !env.step(&[])?.done {}
        Ok::<_, SimError>(env.steps())
    };
    for program in REACTIVE {
        let error = run(program).unwrap_err();
        assert!(matches!(error, SimError::ProgramNotRunning { .. }), "{error:?}");
        let text = error.to_string();
        assert!(text.contains(light) && text.contains("night"), "{text}");
        assert!(!error.is_simulator_failure(), "another SUMO would do the same");
    }
    // The net's own program is whatever SUMO runs.
    assert_eq!(run(SumoProgram::Own).unwrap(), 15);
}
