//! Whole episodes, or parts of them, on real SUMO.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cross_config::{Detection, EnvConfig};
use cross_sim::SimError;
use cross_sim::env::{Env, EnvOptions, SecondView, Signals, SumoProgram};
use cross_sim::scenario::Scenario;
use cross_sim::signal::ActionError;
use cross_sim::trajectory::Observation;
use cross_traci::{ErrorKind, SumoHome};
use std::io::Read;
use std::time::Duration;

fn env_with(scenario: &str, change: impl FnOnce(&mut EnvOptions)) -> Env {
    let home = SumoHome::locate(None).unwrap();
    let mut options = EnvOptions::new(EnvConfig { episode_seconds: 400, ..EnvConfig::default() });
    change(&mut options);
    Env::new(&home, &Scenario::load(scenario).unwrap(), options).unwrap()
}

fn env(scenario: &str) -> Env {
    env_with(scenario, |_| {})
}

/// Different phases at different agents, some of which stay and some of which change.
fn actions(env: &Env, step: usize) -> Vec<u8> {
    let phases = env.layout().intersections.iter().map(|at| at.phases.len());
    phases.enumerate().map(|(agent, phases)| ((step / (1 + agent % 3) + agent) % phases) as u8).collect()
}

/// What an episode looks like from outside: observations, rewards and times at every decision.
#[derive(Debug, PartialEq, Default)]
struct Episode {
    observations: Vec<Observation>,
    rewards: Vec<Vec<f32>>,
    times: Vec<f64>,
}

fn episode(env: &mut Env, seed: u32, mut observer: Option<&mut dyn FnMut(&SecondView<'_>)>) -> Episode {
    env.reset(seed).unwrap();
    let mut episode = Episode { observations: vec![env.observation().clone()], ..Episode::default() };
    loop {
        let actions = actions(env, episode.times.len());
        let step = match &mut observer {
            None => env.step(&actions).unwrap(),
            Some(observer) => env.step_observed(&actions, observer).unwrap(),
        };
        let done = step.done;
        episode.rewards.push(step.rewards.to_vec());
        episode.observations.push(env.observation().clone());
        episode.times.push(env.time());
        if done {
            return episode;
        }
    }
}

#[test]
fn an_episode_has_its_length_and_shapes_and_fills_with_vehicles() {
    let mut env = env("grid4x4");
    let episode = episode(&mut env, 1, None);
    assert_eq!(episode.times.len(), 40);
    assert_eq!((episode.times[0], episode.times[39]), (10.0, 400.0));
    for observation in &episode.observations {
        assert_eq!(observation.counts.len(), 16 * 24 * 3);
        assert_eq!(observation.phases.len(), 16);
    }
    assert_eq!(episode.observations[0].phases, [0; 16]);
    assert!(episode.observations[0].counts.iter().all(|&count| count == 0));
    assert!(episode.observations[40].counts.iter().any(|&count| count > 0));
    assert!(episode.rewards.iter().flatten().all(|&reward| reward <= 0.0));
    assert!(episode.rewards[39].iter().any(|&reward| reward < 0.0));
}

#[test]
fn what_stands_beyond_the_rewards_range_costs_what_it_is_said_to_cost() {
    let rewards = |metres, beyond| {
        let mut env = env_with("arterial4x4", |options| {
            (options.config.reward_range_metres, options.config.reward_beyond) = (metres, beyond);
        });
        episode(&mut env, 3, None).rewards
    };
    let (near, half, all) = (rewards(50.0, 0.0), rewards(50.0, 0.5), rewards(50.0, 1.0));
    assert_ne!(near, all, "nobody stood beyond 50 m");
    assert_eq!(all, rewards(10_000.0, 0.0), "as if the range were the whole lane");
    let middle = |(near, all): (&Vec<f32>, &Vec<f32>)| -> Vec<f32> {
        near.iter().zip(all).map(|(near, all)| (near + all) / 2.0).collect()
    };
    assert_eq!(half, near.iter().zip(&all).map(middle).collect::<Vec<_>>());
}

#[test]
fn watching_every_second_changes_nothing() {
    let mut env = env("grid4x4");
    let apart = episode(&mut env, 5, None);
    let (mut seconds, mut arrived, mut departed, mut running) = (Vec::new(), 0, 0, 0);
    let mut watch = |view: &SecondView<'_>| {
        seconds.push(view.time);
        arrived += view.arrived;
        departed += view.departed;
        running = view.running;
        assert!((0.0..50.0).contains(&view.mean_speed), "{}", view.mean_speed);
        let on_lanes: u32 = view.lanes.signalised_incoming().map(|lane| u32::from(lane.total)).sum();
        assert!(on_lanes <= view.running);
    };
    let observed = episode(&mut env, 5, Some(&mut watch));
    assert_eq!(apart, observed);
    assert_eq!(seconds, (1..=400).map(f64::from).collect::<Vec<_>>());
    // Nobody is lost: who entered has arrived or is still there.
    assert!(departed > 50, "{departed}");
    assert_eq!(departed, arrived + running);
}

#[test]
fn a_second_that_is_watched_is_the_second_of_an_environment_that_decides_then() {
    let under_program = |decision_seconds| {
        let mut env = env_with("grid4x4", |options| {
            options.signals = Signals::Program(SumoProgram::Own);
            options.config.decision_seconds = decision_seconds;
            options.config.yellow_seconds = 0;
        });
        env.reset(5).unwrap();
        env
    };
    let (mut by_second, mut watched) = (under_program(1), under_program(10));
    let (mut stopped, mut in_parts) = (0, 0);
    for decision in 1..=40 {
        watched
            .step_observed(&[], &mut |view: &SecondView<'_>| {
                by_second.step(&[]).unwrap();
                assert_eq!(view.time, by_second.time());
                for (seen, there) in view.lanes.rows().zip(by_second.lanes().rows()) {
                    if view.time == f64::from(10 * decision) {
                        assert_eq!(seen, there);
                        in_parts += u32::from(seen.total_near);
                    } else {
                        assert_eq!((seen.stopped, seen.total), (there.stopped, there.total));
                        stopped += u32::from(seen.stopped);
                    }
                }
            })
            .unwrap();
    }
    assert!(stopped > 100 && in_parts > 100, "{stopped} stopped, {in_parts} near");
}

#[test]
fn watching_may_begin_and_end_within_an_episode() {
    let mut env = env("cologne1");
    let apart = episode(&mut env, 5, None);
    env.reset(5).unwrap();
    let mut seconds = 0;
    for (step, rewards) in apart.rewards.iter().enumerate() {
        let actions = actions(&env, step);
        let taken = if step / 3 % 2 == 1 {
            env.step_observed(&actions, &mut |_: &SecondView<'_>| seconds += 1).unwrap()
        } else {
            env.step(&actions).unwrap()
        };
        assert_eq!(taken.rewards, rewards);
        assert_eq!(env.observation(), &apart.observations[step + 1]);
    }
    assert_eq!(seconds, 190);
}

#[test]
fn a_step_may_be_begun_and_completed_later() {
    let mut env = env("cologne1");
    let apart = episode(&mut env, 5, None);
    env.reset(5).unwrap();
    for (step, rewards) in apart.rewards.iter().enumerate() {
        let actions = actions(&env, step);
        let under_way = env.begin_step(&actions).unwrap();
        assert_eq!(under_way.before(), &apart.observations[step]);
        if step % 10 == 0 {
            // Whether SUMO is still at it or has long been waiting makes no difference.
            std::thread::sleep(Duration::from_millis(30));
        }
        assert_eq!(under_way.complete().unwrap().rewards, rewards);
        assert_eq!((env.observation(), env.time()), (&apart.observations[step + 1], apart.times[step]));
    }
}

#[test]
fn a_step_that_is_not_completed_loses_the_episode_and_no_other() {
    let mut env = env("cologne1");
    let apart = episode(&mut env, 5, None);
    env.reset(6).unwrap();
    // An action that does not exist begins nothing.
    assert!(matches!(env.begin_step(&[99]), Err(SimError::Action(_))));
    let pid = env.sumo_pid().unwrap();
    drop(env.begin_step(&actions(&env, 0)).unwrap());
    assert!(matches!(env.step(&[0]), Err(SimError::NotRunning)));
    assert!(!std::path::Path::new(&format!("/proc/{pid}")).exists(), "SUMO {pid} is still there");
    assert_eq!(episode(&mut env, 5, None), apart);
}

#[test]
fn a_program_of_sumo_s_goes_on_between_begin_and_completion() {
    let mut env = env_with("cologne1", |options| options.signals = Signals::Program(SumoProgram::Actuated));
    let mut play = |begin: bool| {
        env.reset(5).unwrap();
        let mut seen = Vec::new();
        for _ in 0..20 {
            if begin {
                env.begin_step(&[]).unwrap().complete().unwrap();
            } else {
                env.step_observed(&[], &mut |_: &SecondView<'_>| {}).unwrap();
            }
            seen.push((env.observation().clone(), env.time()));
        }
        seen
    };
    assert_eq!(play(true), play(false));
}

#[test]
fn sumo_killed_under_way_is_told_and_another_begins() {
    let mut env = env("cologne1");
    let apart = episode(&mut env, 5, None);
    env.reset(6).unwrap();
    let pid = env.sumo_pid().unwrap().to_string();
    let actions = actions(&env, 0);
    let under_way = env.begin_step(&actions).unwrap();
    assert!(std::process::Command::new("kill").args(["-KILL", &pid]).status().unwrap().success());
    // It may have answered before.
    if let Ok(step) = under_way.complete() {
        assert!(!step.done);
        env.step(&actions).unwrap_err();
    }
    assert!(matches!(env.step(&actions), Err(SimError::NotRunning)));
    assert_eq!(episode(&mut env, 5, None), apart);
}

#[test]
fn the_seed_decides_the_episode() {
    let mut env = env("cologne3");
    let first = episode(&mut env, 11, None);
    let other = episode(&mut env, 12, None);
    let again = episode(&mut env, 11, None);
    assert_eq!(first, again);
    assert_ne!(first, other);
    assert_eq!(first.times[0], 25_210.0);
}

#[test]
fn all_detections_see_the_same_traffic() {
    let seen_by = |detection| {
        let mut env = env_with("cologne1", |options| options.config.detection = detection);
        episode(&mut env, 3, None)
    };
    let default = seen_by(Detection::Default);
    let (paper, fine) = (seen_by(Detection::Paper), seen_by(Detection::Fine));
    assert_eq!(default.rewards, paper.rewards);
    assert_eq!(default.rewards, fine.rewards);
    for (step, default) in default.observations.iter().enumerate() {
        let others = paper.observations[step].counts.chunks(2).zip(fine.observations[step].counts.chunks(6));
        for (default, (paper, fine)) in default.counts.chunks(3).zip(others) {
            assert!(paper[0] <= default[0]);
            assert!(paper[0] + paper[1] <= default.iter().sum());
            assert_eq!([fine[0], fine[2]], *paper, "within 50 m");
            assert_eq!(
                [fine[0] + fine[1], fine[2] + fine[3], fine[4] + fine[5]],
                *default,
                "stopped, moving within 100 m, moving beyond"
            );
        }
    }
    let most = |band: usize| {
        fine.observations.iter().flat_map(|seen| seen.counts.chunks(6)).map(|lane| lane[band]).max()
    };
    assert!((0..6).all(|band| most(band) > Some(0)), "every band is for something");
}

#[test]
fn every_map_runs() {
    for name in ["arterial4x4", "cologne8", "ingolstadt1", "ingolstadt7", "ingolstadt21"] {
        let mut env = env_with(name, |options| options.config.episode_seconds = 60);
        let episode = episode(&mut env, 1, None);
        assert_eq!(episode.times.len(), 6, "{name}");
    }
}

#[test]
fn lights_show_yellow_for_its_seconds_and_then_the_new_green() {
    // Without yellow nobody slows down for a change; with a long one everybody stands: the rewards must differ.
    let mut with = env_with("cologne1", |options| options.config.yellow_seconds = 9);
    let mut without = env_with("cologne1", |options| options.config.yellow_seconds = 0);
    assert_ne!(episode(&mut with, 1, None).rewards, episode(&mut without, 1, None).rewards);
}

#[test]
fn impossible_actions_are_errors_and_change_nothing() {
    let mut env = env("cologne1");
    assert!(matches!(env.step(&[0]), Err(SimError::NotRunning)));
    env.reset(1).unwrap();
    let none = env.step(&[]).unwrap_err();
    assert!(matches!(none, SimError::Action(ActionError::Length { given: 0, agents: 1 })), "{none}");
    let range = env.step(&[4]).unwrap_err();
    assert!(matches!(range, SimError::Action(ActionError::Range { action: 4, phases: 4, .. })), "{range}");
    assert!(!range.is_simulator_failure());
    assert_eq!((env.time(), env.steps()), (25_200.0, 0));
    assert!(!env.step(&[3]).unwrap().done);
}

#[test]
fn a_finished_episode_takes_no_further_step() {
    let mut env = env_with("cologne1", |options| options.config.episode_seconds = 20);
    episode(&mut env, 1, None);
    let error = env.step(&[0]).unwrap_err();
    assert!(matches!(error, SimError::EpisodeOver { steps: 2 }), "{error}");
    env.reset(2).unwrap();
    assert_eq!((env.time(), env.steps()), (25_200.0, 0));
    env.close().unwrap();
}

/// Whether a process of this id exists and is not merely waiting to be reaped.
#[cfg(target_os = "linux")]
fn is_alive(pid: u32) -> bool {
    std::fs::read_to_string(format!("/proc/{pid}/stat")).is_ok_and(|stat| !stat.contains(") Z "))
}

#[cfg(target_os = "linux")]
#[test]
fn a_killed_sumo_costs_the_episode_and_nothing_else() {
    let mut env = env("grid4x4");
    let undisturbed = episode(&mut env, 1, None);
    env.reset(1).unwrap();
    env.step(&[0; 16]).unwrap();
    let pid = env.sumo_pid().unwrap();
    assert!(std::process::Command::new("kill").args(["-KILL", &pid.to_string()]).status().unwrap().success());
    let error = env.step(&[1; 16]).unwrap_err();
    assert!(error.is_simulator_failure(), "{error}");
    assert_eq!(error.reason(), "crashed");
    assert!(error.to_string().contains("SIGKILL"), "{error}");
    assert_eq!(env.sumo_pid(), None);
    assert!(matches!(env.step(&[1; 16]), Err(SimError::NotRunning)));
    assert_eq!(episode(&mut env, 1, None), undisturbed);
}

#[test]
fn a_sumo_that_is_used_again_simulates_as_a_fresh_one() {
    let mut fresh = env("grid4x4");
    let wanted = episode(&mut fresh, 6, None);
    let mut env = env("grid4x4");
    episode(&mut env, 5, None);
    let pid = env.sumo_pid().unwrap();
    assert_eq!(episode(&mut env, 6, None), wanted);
    // Once more from the middle of an episode, and of a watched one.
    env.step_observed(&[1; 16], &mut |_: &SecondView<'_>| {}).unwrap_err();
    env.reset(9).unwrap();
    env.step_observed(&[1; 16], &mut |_: &SecondView<'_>| {}).unwrap();
    assert_eq!(episode(&mut env, 6, None), wanted);
    assert_eq!(env.sumo_pid(), Some(pid));
}

#[cfg(target_os = "linux")]
#[test]
fn a_sumo_killed_between_episodes_is_replaced_and_costs_nothing() {
    let mut env = env("cologne1");
    let wanted = episode(&mut env, 1, None);
    let first = env.sumo_pid().unwrap();
    assert!(
        std::process::Command::new("kill").args(["-KILL", &first.to_string()]).status().unwrap().success()
    );
    assert_eq!(episode(&mut env, 1, None), wanted);
    assert_ne!(env.sumo_pid(), Some(first));
    assert_eq!((env.take_replaced(), env.take_replaced()), (Some(ErrorKind::Crashed), None));
}

#[cfg(target_os = "linux")]
#[test]
fn no_sumo_outlives_its_environment_or_its_end() {
    let mut env = env("cologne1");
    env.reset(1).unwrap();
    let first = env.sumo_pid().unwrap();
    env.finish().unwrap();
    assert!(!is_alive(first));
    env.reset(2).unwrap();
    let second = env.sumo_pid().unwrap();
    assert!(is_alive(second));
    drop(env);
    assert!(!is_alive(second));
}

#[test]
fn trips_are_written_completely_when_the_episode_is_finished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trips.xml");
    let mut env = env_with("grid4x4", |options| options.tripinfo = Some(path.clone()));
    let mut departed = 0;
    episode(&mut env, 1, Some(&mut |view: &SecondView<'_>| departed += view.departed as usize));
    env.finish().unwrap();
    let mut text = String::new();
    std::fs::File::open(&path).unwrap().read_to_string(&mut text).unwrap();
    assert!(text.trim_end().ends_with("</tripinfos>"));
    // Whoever was due but found no room is recorded too, with a departure of -1.
    let undeparted = text.matches("depart=\"-1").count();
    assert_eq!(text.matches("<tripinfo ").count() - undeparted, departed);
    env.finish().unwrap();
}

#[test]
fn a_sumo_that_cannot_start_says_why() {
    let mut env = env_with("cologne1", |options| options.extra_args = vec!["--no-such-option".to_owned()]);
    let error = env.reset(1).unwrap_err();
    assert_eq!(error.reason(), "spawn");
    assert!(error.to_string().contains("no-such-option"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_sumo_that_hangs_is_given_up_at_its_deadline() {
    let mut env = env_with("cologne1", |options| options.timeout = Duration::from_secs(2));
    env.reset(1).unwrap();
    let pid = env.sumo_pid().unwrap();
    assert!(std::process::Command::new("kill").args(["-STOP", &pid.to_string()]).status().unwrap().success());
    let error = env.step(&[0]).unwrap_err();
    assert!(error.is_simulator_failure(), "{error}");
    assert_eq!(error.reason(), "timeout");
    assert!(!is_alive(pid));
}

#[test]
fn an_environment_can_be_given_to_a_thread() {
    fn is_send<T: Send>() {}
    is_send::<Env>();
}
