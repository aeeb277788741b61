//! The program as a process: exit codes, signals, and SUMO's death.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

mod support;

use cross_proto::v1::{self, stream_fragments_response::Message as Answer};
use rustix::process::{Pid, Signal, kill_process, test_kill_process};
use std::process::{Command, Output, Stdio};
use support::{Scripted, World};
use tokio::process::Child;

const PROGRAM: &str = env!("CARGO_BIN_EXE_cross-actor");

fn run(arguments: &[&str]) -> Output {
    Command::new(PROGRAM).args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn last_line(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_owned()
}

#[test]
fn bad_input_is_one_sentence_and_exit_code_2() {
    for (arguments, part) in [
        (&["--learner", "nowhere"][..], "--learner"),
        (&["--learner", "http://127.0.0.1:1", "--actor-id", "a b"], "--actor-id"),
        (&["--learner", "http://127.0.0.1:1", "--sumo-home", "/nonexistent"], "/nonexistent"),
        (&["--learner", "http://127.0.0.1:1", "--config", "/nonexistent.toml"], "/nonexistent.toml"),
        (&["--learner", "http://127.0.0.1:1", "--metrics-listen", "0.0.0.0:0"], "--insecure"),
        (&["--learner", "http://127.0.0.1:1", "--log", "=,="], "--log"),
    ] {
        let output = run(arguments);
        let line = last_line(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
        assert!(line.starts_with("cross-actor: ") && line.contains(part), "{arguments:?}: {line}");
    }
    assert_eq!(run(&[]).status.code(), Some(2), "the learner must be named");
}

/// The program, joined to a scripted learner and in the middle of a long episode.
struct Running {
    learner: Scripted,
    conversation: support::Conversation,
    fragment: v1::Fragment,
    child: Child,
}

impl Running {
    async fn start() -> Self {
        let mut config = support::small_config();
        config.env.episode_seconds = 3600;
        config.ppo.round_steps = 360;
        // The simulator then waits for an acknowledgement, and nothing happens unless the test says so.
        config.actor.unacked_fragments = 1;
        let world = World::new(config);
        let mut learner = Scripted::of(&world).await;
        let child = tokio::process::Command::new(PROGRAM)
            .args(["--learner", &format!("http://{}", learner.address), "--actor-id", "one"])
            .stdin(Stdio::null())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let mut conversation = learner.ready(1).await;
        conversation.say(Answer::Assignment(world.assignment(3))).await;
        let fragment = conversation.fragment().await;
        Self { learner, conversation, fragment, child }
    }

    fn pid(&self) -> Pid {
        Pid::from_raw(self.child.id().unwrap() as i32).unwrap()
    }

    /// The actor's one child.
    fn sumo(&self) -> Pid {
        let tasks = format!("/proc/{}/task", self.child.id().unwrap());
        let children: Vec<i32> = std::fs::read_dir(tasks)
            .unwrap()
            .filter_map(|task| std::fs::read_to_string(task.unwrap().path().join("children")).ok())
            .flat_map(|list| list.split_whitespace().map(|pid| pid.parse().unwrap()).collect::<Vec<_>>())
            .collect();
        assert_eq!(children.len(), 1, "one SUMO");
        Pid::from_raw(children[0]).unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_killed_sumo_costs_its_episode_and_another_one_is_started() {
    let mut running = Running::start().await;
    let sumo = running.sumo();
    kill_process(sumo, Signal::KILL).unwrap();
    // The fragment before the kill is sound and stays; with room again, the simulator meets the dead SUMO.
    running.conversation.acknowledge(&running.fragment, v1::Outcome::Accepted).await;
    let reason = loop {
        match running.conversation.heard().await.unwrap() {
            v1::stream_fragments_request::Message::Fragment(fragment) => {
                running.conversation.acknowledge(&fragment, v1::Outcome::Accepted).await;
            }
            v1::stream_fragments_request::Message::EpisodeAborted(aborted) => break aborted.reason,
            other => panic!("unexpected {other:?}"),
        }
    };
    assert_eq!(reason, "SUMO_CRASHED");
    running.conversation.request().await;
    let again = v1::EpisodeAssignment { episode: 4, ..World::small().assignment(4) };
    running.conversation.say(Answer::Assignment(again)).await;
    let fragment = running.conversation.fragment().await;
    assert_eq!((fragment.episode, fragment.sequence), (4, 0));
    assert_ne!(running.sumo(), sumo);

    running.conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    let output = running.child.wait_with_output().await.unwrap();
    assert_eq!(output.status.code(), Some(0));
    let log = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(log.lines().filter(|line| line.contains("starting another SUMO")).count(), 1, "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_gives_the_episode_back_flushes_and_exits_with_0() {
    let mut running = Running::start().await;
    let sumo = running.sumo();
    kill_process(running.pid(), Signal::TERM).unwrap();
    running.conversation.acknowledge(&running.fragment, v1::Outcome::Accepted).await;
    let mut aborted = None;
    while let Some(message) = running.conversation.heard().await {
        match message {
            v1::stream_fragments_request::Message::Fragment(fragment) => {
                running.conversation.acknowledge(&fragment, v1::Outcome::Accepted).await;
            }
            v1::stream_fragments_request::Message::EpisodeAborted(said) => aborted = Some(said.reason),
            other => panic!("unexpected {other:?}"),
        }
    }
    assert_eq!(aborted.as_deref(), Some("SHUTDOWN"));
    drop(running.conversation);
    let output = running.child.wait_with_output().await.unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(test_kill_process(sumo).is_err(), "SUMO is gone with its owner");
    drop(running.learner);
}

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_ends_an_actor_whose_learner_withholds_acknowledgements() {
    let mut running = Running::start().await;
    let sumo = running.sumo();
    // The one fragment that may be in flight is, and stays, unacknowledged.
    kill_process(running.pid(), Signal::TERM).unwrap();
    let output = running.child.wait_with_output().await.unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let mut aborted = None;
    while let Some(message) = running.conversation.heard().await {
        if let v1::stream_fragments_request::Message::EpisodeAborted(said) = message {
            aborted = Some(said.reason);
        }
    }
    assert_eq!(aborted.as_deref(), Some("SHUTDOWN"), "the episode is given back all the same");
    assert!(test_kill_process(sumo).is_err(), "SUMO is gone with its owner");
}

#[test]
fn a_log_on_a_full_disk_does_not_change_how_the_program_ends() {
    for (arguments, code) in [
        (&["--learner", "http://127.0.0.1:1", "--sumo-home", "/nonexistent"][..], 2),
        // Logs its start and a failed attempt before the error.
        (&["--learner", "http://127.0.0.1:1", "--give-up-seconds", "1"], 1),
    ] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let status =
            Command::new(PROGRAM).args(arguments).stdin(Stdio::null()).stderr(full).status().unwrap();
        assert_eq!(status.code(), Some(code), "{arguments:?}");
    }
}
