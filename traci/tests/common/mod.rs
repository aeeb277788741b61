//! A real SUMO on a real network, for every integration test.

#![allow(dead_code, reason = "each test binary uses its own part")]

use cross_traci::{Sumo, SumoCommand, SumoHome};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Long enough for a busy machine; nothing waits this long unless it is broken.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// Where `make build` puts the maps.
pub(crate) fn deps() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../.deps").canonicalize().expect("run `make build` first")
}

pub(crate) fn home() -> SumoHome {
    SumoHome::locate(None).expect("run `make build` first")
}

/// Sixteen traffic lights and 1473 vehicles in an hour.
pub(crate) fn grid() -> SumoCommand {
    let map = deps().join("resco/grid4x4");
    SumoCommand::new()
        .option("-n", map.join("grid4x4.net.xml"))
        .option("-r", map.join("grid4x4_1.rou.xml"))
        .option("--seed", "7")
}

pub(crate) fn start() -> Sumo {
    Sumo::start(&home(), &grid(), PATIENCE).expect("SUMO starts")
}

/// Whether a process still does anything. A zombie does not: it only waits for its parent, which may be a container's
/// first process that reaps nobody.
pub(crate) fn runs(pid: u32) -> bool {
    let Ok(stat) = std::fs::read_to_string(format!("/proc/{pid}/stat")) else { return false };
    let state = stat.rsplit(')').next().and_then(|rest| rest.split_ascii_whitespace().next());
    !matches!(state, Some("Z" | "X") | None)
}

/// Waits until `condition` holds; false if it never does.
pub(crate) fn eventually(mut condition: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    while !condition() {
        if begun.elapsed() > PATIENCE {
            return false;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    true
}

pub(crate) fn signal(pid: u32, signal: rustix::process::Signal) {
    let pid = rustix::process::Pid::from_raw(pid.cast_signed()).expect("a process id");
    rustix::process::kill_process(pid, signal).expect("the process exists");
}
