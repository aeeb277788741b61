//! `cross bench train`: a minute of a real training, and whose CPU time it was.
//!
//! ```text
//!   cross train (learner, actors, their SUMOs) ── warm, after its first updates ──> threads' CPU time, twice
//! ```
//! The kernel counts every thread of every process; nothing is sampled, and nothing of the training is changed.

mod parts;

use crate::error::BenchError;
use crate::progress::Progress;
use crate::report::{Better, Report, Row};
use cross_support::child::{Exit, Process, sibling};
use parts::{Part, Ticks};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Updates before the clock starts: buffers have their size then, and all actors are at work.
const WARM_UP: usize = 3;
/// More than any benchmark makes.
const UPDATES: &str = "1000000";
/// What has to be done while the clock runs, for anything to be measured.
const LEAST_UPDATES: usize = 1;
/// Between two looks whether the training still runs.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Longest time until the first updates are made.
const START: Duration = Duration::from_secs(900);
/// Longest time for the drain at the end.
const DRAIN: Duration = Duration::from_secs(180);

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

/// Trains and looks.
///
/// # Errors
/// [`BenchError::Training`] if the training ends or makes no updates, [`BenchError::Child`] if it does not start.
pub fn run(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    let folder = tempfile::Builder::new()
        .prefix("cross-bench-")
        .tempdir()
        .map_err(|source| BenchError::Folder { source })?;
    let run = folder.path().join("run");
    let mut training =
        Process::start(&sibling("cross")?, &arguments(options, &run), &folder.path().join("log"))?;
    let log = run.join(cross_learner::metrics_log::FILE);
    let enough = |updates: usize| updates >= WARM_UP;
    let begun = Instant::now();
    while !enough(updates(&log).len()) {
        look(&mut training, begun.elapsed() < START)?;
    }
    progress(&format!(
        "warm after {:.0} s; looking for {} s",
        begun.elapsed().as_secs_f64(),
        options.time.as_secs()
    ));

    let (before, ticks, clock) = (updates(&log), Ticks::below(training.pid()), Instant::now());
    while clock.elapsed() < options.time {
        look(&mut training, true)?;
    }
    let (used, wall) = (Ticks::below(training.pid()).since(&ticks), clock.elapsed().as_secs_f64());
    let after = updates(&log);
    if after.len() < before.len() + LEAST_UPDATES {
        return Err(BenchError::Training {
            problem: "it made no update in that time; look for longer".to_owned(),
        });
    }
    stop(&mut training)?;

    let second = rustix::param::clock_ticks_per_second() as f64;
    let used = used.map(|ticks| ticks as f64 / second);
    let decisions = after.last().copied().unwrap_or(0) - before.last().copied().unwrap_or(0);
    progress(&format!(
        "{} updates, {:.0} decisions a second",
        after.len() - before.len(),
        decisions as f64 / wall
    ));
    Ok(Report::new("train", rows(&options.scenarios.join(" + "), used, wall)))
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
fn updates(log: &Path) -> Vec<u64> {
    // Not there before the first update; its last line may be half written.
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let line = |line: &str| serde_json::from_str::<cross_learner::metrics_log::Line>(line).ok();
    text.lines().filter_map(line).map(|line| line.decisions).collect()
}

/// Waits a little, unless the training has ended or `patient` no longer holds.
fn look(training: &mut Process, patient: bool) -> Result<(), BenchError> {
    let problem = match training.ended() {
        Some(exit) => format!("it {exit}, saying: {}", training.last_words().unwrap_or_default()),
        None if !patient => format!("it made no {WARM_UP} updates in {} s", START.as_secs()),
        None => {
            std::thread::sleep(LOOK_EVERY);
            return Ok(());
        }
    };
    Err(BenchError::Training { problem })
}

/// Has it drain; its run directory is of no use to anybody, but no process of it may be left.
fn stop(training: &mut Process) -> Result<(), BenchError> {
    training.terminate();
    let begun = Instant::now();
    loop {
        match training.ended() {
            Some(Exit::Code(0)) => return Ok(()),
            Some(exit) => {
                let said = training.last_words().unwrap_or_default();
                return Err(BenchError::Training {
                    problem: format!("told to stop, it {exit}, saying: {said}"),
                });
            }
            None if begun.elapsed() > DRAIN => {
                let problem = format!("it did not stop within {} s", DRAIN.as_secs());
                return Err(BenchError::Training { problem });
            }
            None => std::thread::sleep(LOOK_EVERY),
        }
    }
}

fn rows(case: &str, used: [f64; 5], wall: f64) -> Vec<Row> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as f64;
    let all: f64 = used.iter().sum();
    let percent = |part: f64, of: f64| 100.0 * part / of.max(f64::MIN_POSITIVE);
    let row = |what: &str, better, share: f64, against: (&str, f64)| {
        Row::new(format!("{case}, {what}"), "%", better, share, against)
    };
    let of_all = |part: f64| (percent(part, all), ("all CPU time of the training", 100.0));
    let mut rows: Vec<Row> = Part::ALL
        .into_iter()
        .zip(used)
        .map(|(part, used)| {
            let (share, against) = of_all(used);
            let better =
                if matches!(part, Part::Sumo | Part::Update) { Better::Higher } else { Better::Lower };
            row(part.name(), better, share, against)
        })
        .collect();
    let wanted =
        Part::ALL.into_iter().zip(used).filter(|(part, _)| matches!(part, Part::Sumo | Part::Update));
    let (share, against) = of_all(wanted.map(|(_, used)| used).sum());
    rows.push(row("SUMO and updates together", Better::Higher, share, against));
    let against = ("all time of the machine's cores", 100.0);
    rows.push(row("cores at work", Better::Higher, percent(all, cores * wall), against));
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
    fn updates_are_counted_without_a_line_that_is_half_there() {
        let folder = tempfile::tempdir().unwrap();
        assert!(updates(&folder.path().join("none")).is_empty());
        let log = folder.path().join("log");
        std::fs::write(&log, "{\"update\": 1").unwrap();
        assert!(updates(&log).is_empty());
    }
}
