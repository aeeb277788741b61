//! Nets that SUMO's own tools make, with signals unlike those of the benchmark maps, controlled in a running SUMO.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cross_config::EnvConfig;
use cross_sim::env::{Env, EnvOptions, SecondView, Signals, SumoProgram};
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

/// Two crossings, A and B, 60 m apart on an east-west street, with sidewalks and crosswalks.
const NODES: &str = r#"<nodes>
  <node id="W" x="-200" y="0"/><node id="E" x="260" y="0"/>
  <node id="AN" x="0" y="200"/><node id="AS" x="0" y="-200"/>
  <node id="BN" x="60" y="200"/><node id="BS" x="60" y="-200"/>
  <node id="A" x="0" y="0" type="traffic_light"/><node id="B" x="60" y="0" type="traffic_light"/>
</nodes>"#;

fn edges() -> String {
    let mut text = String::from("<edges>\n");
    for (a, b) in [("W", "A"), ("A", "B"), ("B", "E"), ("AN", "A"), ("AS", "A"), ("BN", "B"), ("BS", "B")] {
        for (from, to) in [(a, b), (b, a)] {
            writeln!(
                text,
                "<edge id=\"{from}{to}\" from=\"{from}\" to=\"{to}\" numLanes=\"2\" speed=\"13.9\" sidewalkWidth=\"2\"/>"
            )
            .unwrap();
        }
    }
    text + "</edges>"
}

const ROUTES: &str = r#"<routes>
  <flow id="east" begin="0" end="600" period="6" from="WA" to="BE"/>
  <flow id="west" begin="0" end="600" period="6" from="EB" to="AW"/>
  <flow id="south" begin="0" end="600" period="8" from="ANA" to="AAS"/>
  <flow id="left" begin="0" end="600" period="12" from="BSB" to="AW"/>
</routes>"#;

const DEFINITION: &str = "net = \"town.net.xml\"\nroutes = [\"town.rou.xml\"]\nend = 600\n";

/// Builds the net with these further options; `change` edits its text.
fn scenario(folder: &Path, options: &[&str], change: impl FnOnce(String) -> String) -> Scenario {
    std::fs::write(folder.join("town.nod.xml"), NODES).unwrap();
    std::fs::write(folder.join("town.edg.xml"), edges()).unwrap();
    std::fs::write(folder.join("town.rou.xml"), ROUTES).unwrap();
    std::fs::write(folder.join("scenario.toml"), DEFINITION).unwrap();
    let net = folder.join("town.net.xml");
    let home = SumoHome::locate(None).unwrap();
    let output = Command::new(home.binary("netconvert"))
        .env("SUMO_HOME", home.path())
        .current_dir(folder)
        .args(["-n", "town.nod.xml", "-e", "town.edg.xml", "-o", "town.net.xml", "--crossings.guess"])
        .args(["--no-turnarounds", "--xml-validation", "never"])
        .args(options)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(&net).unwrap();
    std::fs::write(&net, change(text)).unwrap();
    Scenario::from_directory(folder).unwrap()
}

fn env(scenario: &Scenario) -> Env {
    env_with(scenario, Signals::Driven)
}

fn env_with(scenario: &Scenario, signals: Signals) -> Env {
    let config = EnvConfig { episode_seconds: 300, ..EnvConfig::default() };
    let options = EnvOptions { signals, ..EnvOptions::new(config) };
    Env::new(&SumoHome::locate(None).unwrap(), scenario, options).unwrap()
}

/// Cycles through all phases and returns how many vehicles arrived.
fn cycle(env: &mut Env) -> u32 {
    env.reset(1).unwrap();
    let phases: Vec<usize> = env.layout().intersections.iter().map(|at| at.phases.len()).collect();
    let mut arrived = 0;
    for step in 0.. {
        let actions: Vec<u8> = phases.iter().map(|phases| (step / 3 % phases) as u8).collect();
        let mut count = |view: &SecondView<'_>| arrived += view.arrived;
        if env.step_observed(&actions, &mut count).unwrap().done {
            break;
        }
    }
    arrived
}

#[test]
fn crosswalks_have_letters_but_no_movements() {
    let folder = tempfile::tempdir().unwrap();
    let mut env = env(&scenario(folder.path(), &[], |net| net));
    let layout = env.layout().clone();
    assert_eq!(layout.agents(), 2);
    for at in &layout.intersections {
        assert!(at.phases[0].state.len() > at.movements.len());
        assert!(at.incoming.iter().all(|lane| !lane.id.starts_with(':')));
    }
    assert!(cycle(&mut env) > 20);
}

#[test]
fn one_light_over_both_crossings_is_one_agent() {
    let folder = tempfile::tempdir().unwrap();
    let options =
        ["--tls.join", "--tls.join-dist", "100", "--walkingareas", "false", "--tls.allred.time", "2"];
    let mut env = env(&scenario(folder.path(), &options, |net| net));
    let layout = env.layout().clone();
    assert_eq!(layout.agents(), 1);
    let at = &layout.intersections[0];
    // Half way between them; netconvert moves the origin to the south-west corner.
    assert_eq!(at.position, (230.0, 200.0));
    assert_eq!(at.roads_in.len(), 8);
    assert!(cycle(&mut env) > 20);
}

#[test]
fn actuated_programs_and_ones_without_yellow_are_controlled_alike() {
    let folder = tempfile::tempdir().unwrap();
    let only_greens = |net: String| -> String {
        // Keep the phases that hold no yellow: the greens follow each other directly.
        net.lines()
            .filter(|line| !(line.contains("<phase") && line.contains('y')))
            .fold(String::new(), |text, line| text + line + "\n")
    };
    let mut env = env(&scenario(folder.path(), &["--tls.default-type", "actuated"], only_greens));
    assert!(env.layout().intersections.iter().all(|at| at.phases.len() >= 2));
    assert!(cycle(&mut env) > 20);
}

#[test]
fn sumos_own_programs_run_on_all_of_them() {
    let whole = |net: String| net;
    let without_yellow = |net: String| -> String {
        net.lines()
            .filter(|line| !(line.contains("<phase") && line.contains('y')))
            .collect::<Vec<_>>()
            .join("\n")
    };
    let joined =
        ["--tls.join", "--tls.join-dist", "100", "--walkingareas", "false", "--tls.allred.time", "2"];
    type Change = fn(String) -> String;
    let nets: [(&[&str], Change); 4] =
        [(&[], whole), (&joined, whole), (&[], without_yellow), (&["--tls.default-type", "actuated"], whole)];
    for (options, change) in nets {
        let folder = tempfile::tempdir().unwrap();
        let scenario = scenario(folder.path(), options, change);
        for program in [SumoProgram::Own, SumoProgram::Actuated, SumoProgram::DelayBased] {
            let arrived = cycle(&mut env_with(&scenario, Signals::Program(program)));
            assert!(arrived > 20, "{options:?} {program:?}: {arrived} arrived");
        }
    }
}
