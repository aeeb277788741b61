//! `cross bench train`: a minute of a real training, and whose CPU time it was.
//!
//! ```text
//!   cross train (learner, actors, their SUMOs) ── warm, after its first updates ──> threads' CPU time, twice
//! ```
//! The kernel counts every thread of every process; nothing is sampled, and nothing of the training is changed.

mod parts;

use crate::cluster::{self, Server};
use crate::error::BenchError;
use crate::folder::folder;
use crate::progress::Progress;
use crate::report::{Better, Report, Row};
use cross_learner::metrics_log;
use cross_support::child::sibling;
use parts::{Part, Ticks};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Updates before the clock starts: buffers have their size then, and all actors are at work.
const WARM_UP: usize = 3;
/// More than any benchmark makes.
const UPDATES: &str = "1000000";
/// Between two looks whether the training still runs.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// Longest time until the first updates are made.
const START: Duration = Duration::from_secs(900);

/// What to train, and for how long to look.
#[derive(Debug)]
pub struct Options {
    /// SUMO to run.
    pub sumo_home: PathBuf,
    /// Networks by name or directory, trained on together.
    pub scenarios: Vec<String>,
    /// A configuration; the built-in one without it.
    pub config: Option<PathBuf>,
    /// Actors; as many as `cross train` starts without being told, if none.
    pub actors: Option<u16>,
    /// Length of the look.
    pub time: Duration,
}

/// Trains and looks. The training is stopped after that, and its run directory is gone: nobody wants it.
///
/// # Errors
/// [`BenchError::ServerEnded`] with its last words if the training ends, [`BenchError::Training`] if it makes no updates.
pub fn run(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    cluster::run(measure(options, progress))
}

async fn measure(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    let folder = folder()?;
    let run = folder.path().join("run");
    let log = run.join(metrics_log::FILE);
    let mut training = Server::start("the training", &sibling("cross")?, folder, &arguments(options, &run))?;
    let begun = Instant::now();
    while decisions(&log).len() < WARM_UP {
        if begun.elapsed() > START {
            let problem = format!("it made no {WARM_UP} updates in {} s", START.as_secs());
            return Err(BenchError::Training { problem });
        }
        look(&mut training).await?;
    }
    let (warm, seconds) = (begun.elapsed().as_secs_f64(), options.time.as_secs());
    progress(&format!("warm after {warm:.0} s; looking for {seconds} s"));

    let (before, ticks, clock) = (decisions(&log), Ticks::below(training.pid()), Instant::now());
    while clock.elapsed() < options.time {
        look(&mut training).await?;
    }
    let (used, wall) = (Ticks::below(training.pid()).since(&ticks), clock.elapsed().as_secs_f64());
    let after = decisions(&log);
    let (Some(first), Some(last)) = (before.last(), after.last().filter(|_| after.len() > before.len()))
    else {
        let problem = "it made no update in that time; look for longer".to_owned();
        return Err(BenchError::Training { problem });
    };
    let rate = (last - first) as f64 / wall;
    progress(&format!("{} updates, {rate:.0} decisions a second", after.len() - before.len()));
    // In order, so that no process of it writes into the folder that goes now.
    training.stop().await?;
    let second = rustix::param::clock_ticks_per_second() as f64;
    let case = options.scenarios.join(" + ");
    Ok(Report::new("train", rows(&case, used.map(|ticks| ticks as f64 / second), wall)))
}

fn arguments(options: &Options, run: &Path) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = vec!["train".into(), "--run".into(), run.into()];
    arguments.extend(["--updates", UPDATES, "--eval-seeds", "0", "--sumo-home"].map(OsString::from));
    arguments.push(options.sumo_home.clone().into());
    for scenario in &options.scenarios {
        arguments.extend(["--scenario".into(), scenario.into()]);
    }
    if let Some(config) = &options.config {
        arguments.extend(["--config".into(), config.into()]);
    }
    if let Some(actors) = options.actors {
        arguments.extend(["--actors".into(), actors.to_string().into()]);
    }
    arguments
}

/// Decisions trained on after each update so far.
fn decisions(log: &Path) -> Vec<u64> {
    // Not there before the first update; its last line may be half written.
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let line = |line: &str| serde_json::from_str::<metrics_log::Line>(line).ok();
    text.lines().filter_map(line).map(|line| line.decisions).collect()
}

/// Waits a little, and finds the training still there.
async fn look(training: &mut Server) -> Result<(), BenchError> {
    tokio::time::sleep(LOOK_EVERY).await;
    training.alive()
}

fn rows(case: &str, used: [f64; 5], wall: f64) -> Vec<Row> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as f64;
    let all: f64 = used.iter().sum();
    let percent = |what: &str, better, part: f64, (name, of): (&str, f64)| {
        let share = 100.0 * part / of.max(f64::MIN_POSITIVE);
        Row::new(format!("{case}, {what}"), "%", better, share, (name, 100.0))
    };
    let used_time = ("all CPU time of the training", all);
    let (mut rows, mut work) = (Vec::new(), 0.0);
    for (part, used) in Part::ALL.into_iter().zip(used) {
        let better = if part.is_work() { Better::Higher } else { Better::Lower };
        work += if part.is_work() { used } else { 0.0 };
        rows.push(percent(part.name(), better, used, used_time));
    }
    rows.push(percent("SUMO and updates together", Better::Higher, work, used_time));
    let every_core = ("all time of the machine's cores", cores * wall);
    rows.push(percent("cores at work", Better::Higher, all, every_core));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_what_was_used_and_add_up() {
        let rows = rows("net", [4.0, 4.0, 1.0, 0.5, 0.5], 10.0);
        let shares: Vec<f64> = rows.iter().map(|row| row.ours).collect();
        assert_eq!(shares[..6], [40.0, 40.0, 10.0, 5.0, 5.0, 80.0]);
        assert!(shares[6] > 0.0 && rows[5].case == "net, SUMO and updates together");
    }

    #[test]
    fn a_line_that_is_half_there_does_not_count() {
        let folder = tempfile::tempdir().unwrap();
        assert!(decisions(&folder.path().join("none")).is_empty());
        let log = folder.path().join("log");
        std::fs::write(&log, "{\"update\": 1").unwrap();
        assert!(decisions(&log).is_empty());
    }
}
