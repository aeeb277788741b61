//! All TraCI clients see the same traffic, and none leaves a SUMO behind.

#![allow(missing_docs, clippy::unwrap_used, clippy::panic, reason = "a test says by failing what went wrong")]
#![cfg(target_os = "linux")]

use cross_bench::traci::job::Way;
use cross_bench::{Report, traci};
use cross_config::EnvConfig;
use cross_sim::generate::{Demand, GridOptions, NewScenario, generate_grid};
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use rustix::process::{Pid, Signal, kill_process};
use std::cell::RefCell;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Marks the helper process and, by inheritance, all that it starts.
const MARK: &str = "CROSS_BENCH_TEST_MARK";

fn home() -> SumoHome {
    SumoHome::locate(None).expect("run `make build` first: it fetches SUMO")
}

/// A town of four crossings, full of vehicles after a minute.
fn town(folder: &Path) -> Scenario {
    let demand = Demand::Uniform { vehicles_per_hour: 6000, duration: 3600 };
    let options = GridOptions { columns: 2, rows: 2, demand, ..GridOptions::default() };
    let new = NewScenario {
        name: "town".to_owned(),
        description: String::new(),
        source: String::new(),
        folder: folder.join("town"),
        replace: false,
        end: 3600,
        time_to_teleport: -1.0,
    };
    Scenario::from_directory(&generate_grid(&home(), &options, &new).unwrap()).unwrap()
}

fn measure(seconds: u32, progress: &dyn Fn(&str)) -> Report {
    let folder = tempfile::tempdir().unwrap();
    let options = traci::Options {
        home: home(),
        scenarios: vec![town(folder.path())],
        env: EnvConfig { episode_seconds: seconds, ..EnvConfig::default() },
        seed: 3,
        repeats: 1,
        python: None,
    };
    traci::run(&options, progress).unwrap()
}

#[test]
fn all_clients_see_the_same_vehicles_at_every_decision() {
    let said = RefCell::new(Vec::new());
    // What differs is an error of the measurement itself.
    let report = measure(60, &|line| said.borrow_mut().push(line.to_owned()));
    let said = said.into_inner();
    let left_out = |client: &str| {
        let reason = said.iter().find(|line| line.starts_with(&format!("{client} is left out: ")));
        if let Some(reason) = reason {
            println!("skipped: {reason}");
        }
        reason.is_some()
    };
    // Cargo builds it with this test, unless it is told to build this test alone.
    for (client, name) in [("traci-rs", "traci-rs"), ("Python's traci", "Python traci")] {
        if left_out(client) {
            continue;
        }
        for way in Way::ALL {
            let case = |unit: &str| format!("town, {name}, {}, {unit}", way.name());
            for unit in ["wall", "CPU"] {
                let row = report.rows.iter().find(|row| row.case == case(unit));
                let row = row.unwrap_or_else(|| panic!("no {} in {report:?}", case(unit)));
                assert!(row.ours > 0.0 && row.baseline > 0.0 && row.unit == "s", "{row:?}");
            }
            let begin = format!("town, {name}, {}, 1 of 1: ", way.name());
            let line = said.iter().find(|line| line.starts_with(&begin)).unwrap();
            let looks = line.rsplit("; ").next().unwrap().split(' ').next().unwrap();
            assert!(looks.parse::<u32>().unwrap() > 100, "an empty town proves nothing: {line}");
        }
    }
}

/// Not a test of its own: what the owner of the next test does.
#[test]
#[ignore = "the helper process of the other test"]
fn measure_for_long() {
    if std::env::var_os(MARK).is_some() {
        measure(1800, &|_| ());
    }
}

/// The names of all processes with this mark in their environment.
fn marked(mark: &str) -> Vec<String> {
    let entry = format!("{MARK}={mark}\0");
    let processes = std::fs::read_dir("/proc").unwrap().flatten().filter_map(|process| {
        // Of one that has ended the kernel gives no environment.
        let environment = std::fs::read(process.path().join("environ")).ok()?;
        let is_marked = environment.windows(entry.len()).any(|window| window == entry.as_bytes());
        let name = std::fs::read_to_string(process.path().join("comm")).ok()?;
        is_marked.then(|| name.trim().to_owned())
    });
    processes.collect()
}

fn eventually(mut condition: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    while !condition() {
        if begun.elapsed() > Duration::from_secs(60) {
            return false;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    true
}

#[test]
fn ctrl_c_leaves_neither_client_nor_sumo_behind() {
    let mark = std::process::id().to_string();
    // What an owner that is killed leaves on the disk goes with this folder.
    let folder = tempfile::tempdir().unwrap();
    let mut owner = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "measure_for_long"])
        .env(MARK, &mark)
        .env("TMPDIR", folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let is_client = |name: &String| name.starts_with("traci_rs") || name.starts_with("python");
    // In the middle of an episode of another client.
    let found = eventually(|| {
        let names = marked(&mark);
        let in_episode = names.iter().any(|name| name == "sumo") && names.iter().any(is_client);
        in_episode || owner.try_wait().unwrap().is_some()
    });
    assert!(found, "{:?}", marked(&mark));
    if owner.try_wait().unwrap().is_some_and(|status| status.success()) {
        println!("skipped: neither traci-rs nor Python's traci is here; the other test says why");
        return;
    }
    kill_process(Pid::from_child(&owner), Signal::INT).unwrap();
    assert!(!owner.wait().unwrap().success());
    assert!(eventually(|| marked(&mark).is_empty()), "{:?}", marked(&mark));
}
