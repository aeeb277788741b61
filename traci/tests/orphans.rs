//! No SUMO is left behind, whatever its owner dies of.
//!
//! The owner is this very test program, started again as another process with [`hold_sumo`] as its only test.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers may fail as its body may")]
#![cfg(target_os = "linux")]

mod common;

use common::{eventually, runs, signal, start};
use cross_traci::{Domain, Sumo};
use rustix::process::Signal;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const ROLE: &str = "CROSS_TRACI_TEST_ROLE";
const MARK: &str = "CROSS_TRACI_TEST_MARK";

/// Not a test of its own: what the owner process does.
#[test]
#[ignore = "the helper process of the other tests"]
#[expect(clippy::disallowed_methods, reason = "an owner that skips its destructors is what is tested")]
fn hold_sumo() {
    let Ok(role) = std::env::var(ROLE) else { return };
    let mut sumo = start();
    // Off the captured output of the test harness, which would keep it.
    eprintln!("SUMO {}", sumo.pid());
    match role.as_str() {
        "panic" => panic!("on purpose"),
        "exit" => std::process::exit(3),
        "abort" => std::process::abort(),
        // Simulating without an end: SUMO is busy and reads no socket when its owner dies.
        "busy" => drop(sumo.client().simulation_step(1e7)),
        _ => loop {
            std::thread::park();
        },
    }
}

struct Owner {
    process: Child,
    sumo: u32,
}

fn helper(role: &str, mark: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--ignored", "--exact", "hold_sumo", "--nocapture"]).env(ROLE, role).env(MARK, mark);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn owner(role: &str) -> Owner {
    let mut process = helper(role, "").spawn().unwrap();
    let sumo = started(&mut process);
    Owner { process, sumo }
}

/// Waits until the helper has started SUMO, whose process id it returns.
fn started(process: &mut Child) -> u32 {
    let lines = BufReader::new(process.stderr.take().unwrap()).lines();
    let sumo = lines.map_while(Result::ok).find_map(|line| line.strip_prefix("SUMO ")?.parse().ok());
    let Some(sumo) = sumo else {
        process.kill().unwrap();
        panic!("the helper did not start SUMO: {:?}", process.wait());
    };
    sumo
}

#[test]
fn killing_the_owner_ends_its_sumo() {
    for (role, with) in [("idle", Signal::KILL), ("idle", Signal::TERM), ("busy", Signal::KILL)] {
        let mut owner = owner(role);
        assert!(runs(owner.sumo));
        signal(owner.process.id(), with);
        owner.process.wait().unwrap();
        assert!(eventually(|| !runs(owner.sumo)), "{role} owner ended by {with:?}");
    }
}

#[test]
fn an_owner_that_ends_by_itself_takes_its_sumo_along() {
    for role in ["panic", "exit", "abort"] {
        let mut owner = owner(role);
        assert!(!owner.process.wait().unwrap().success());
        assert!(eventually(|| !runs(owner.sumo)), "{role}");
    }
}

/// Every running process that was started with this mark in its environment: owner, SUMO, and whatever is between.
fn marked(mark: &str) -> Vec<u32> {
    let entry = format!("{MARK}={mark}\0");
    let pids =
        std::fs::read_dir("/proc").unwrap().flatten().filter_map(|e| e.file_name().to_str()?.parse().ok());
    pids.filter(|&pid: &u32| {
        let environment = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        environment.windows(entry.len()).any(|window| window == entry.as_bytes()) && runs(pid)
    })
    .collect()
}

/// What a process was started with, `NAME=VALUE` each.
fn environment(pid: u32) -> Vec<String> {
    let bytes = std::fs::read(format!("/proc/{pid}/environ")).unwrap();
    bytes.split(|byte| *byte == 0).map(|entry| String::from_utf8_lossy(entry).into_owned()).collect()
}

#[test]
fn sumo_does_not_inherit_its_owner_s_secrets() {
    let mut process = helper("idle", "kept").env("SOME_TOKEN", "must-not-be-seen").spawn().unwrap();
    let owner = process.id();
    let sumo = started(&mut process);
    assert!(environment(owner).contains(&"SOME_TOKEN=must-not-be-seen".to_owned()));
    let inherited = environment(sumo);
    assert!(inherited.contains(&format!("{MARK}=kept")), "{inherited:?}");
    assert!(!inherited.iter().any(|entry| entry.contains("must-not-be-seen")), "{inherited:?}");
    process.kill().unwrap();
    process.wait().unwrap();
}

#[test]
fn an_owner_killed_at_any_moment_of_the_start_leaves_nothing() {
    for millis in [1, 2, 4, 8, 16, 32, 64, 128] {
        let mark = format!("{}-{millis}", std::process::id());
        let mut process = helper("idle", &mark).spawn().unwrap();
        // Only chooses the moment; whatever the owner is doing by then, the claim is the same.
        std::thread::sleep(Duration::from_millis(millis));
        process.kill().unwrap();
        process.wait().unwrap();
        assert!(eventually(|| marked(&mark).is_empty()), "killed after {millis} ms: {:?}", marked(&mark));
    }
}

#[test]
fn dropping_kills_and_reaps_even_in_a_panic() {
    let sumo = start();
    let pid = sumo.pid();
    assert!(sumo.is_running());
    drop(sumo);
    // Reaped, not only killed: not even a zombie is left.
    assert!(!std::path::Path::new(&format!("/proc/{pid}")).exists());

    let (send, receive) = std::sync::mpsc::channel();
    let outcome = std::thread::spawn(move || {
        let sumo = start();
        send.send(sumo.pid()).unwrap();
        panic!("on purpose, with SUMO {}", sumo.pid());
    })
    .join();
    assert!(outcome.is_err());
    let pid = receive.recv().unwrap();
    assert!(!std::path::Path::new(&format!("/proc/{pid}")).exists());
}

#[test]
fn sumo_outlives_the_thread_that_started_it() {
    let mut sumo = std::thread::spawn(start).join().unwrap();
    sumo.client().simulation_step(10.0).unwrap();
    assert!(sumo.is_running());
    assert_eq!(sumo.client().time().unwrap(), 10.0);
}

#[test]
fn several_sumos_at_once_have_ports_and_clocks_of_their_own() {
    let starters: Vec<_> = (0..4).map(|_| std::thread::spawn(start)).collect();
    let mut sumos: Vec<Sumo> = starters.into_iter().map(|starter| starter.join().unwrap()).collect();
    let mut ports: Vec<u16> = sumos.iter().map(Sumo::port).collect();
    ports.sort_unstable();
    ports.dedup();
    assert_eq!(ports.len(), sumos.len());
    for (index, sumo) in sumos.iter_mut().enumerate() {
        sumo.client().simulation_step(10.0 * (index + 1) as f64).unwrap();
    }
    for (index, sumo) in sumos.iter_mut().enumerate() {
        assert_eq!(sumo.client().time().unwrap(), 10.0 * (index + 1) as f64);
        assert_eq!(sumo.client().ids(Domain::TrafficLight).unwrap().len(), 16);
    }
}

#[test]
fn ctrl_c_reaches_the_owner_and_not_sumo() {
    let sumo = start();
    let pid = rustix::process::Pid::from_raw(sumo.pid().cast_signed()).unwrap();
    let group = rustix::process::getpgid(Some(pid)).unwrap();
    assert_ne!(group, rustix::process::getpgrp());
}
