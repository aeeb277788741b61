//! The long forms of the fault suite: `make faults` and `make soak`.
#![allow(clippy::print_stdout, reason = "a program for a person at a terminal")]

use clap::{Args, Parser};
use cross_tests::faults::campaign::Campaign;
use cross_tests::faults::inject::Kind;
use cross_tests::faults::soak::{LEAST_MINUTES, MOST_GROWTH, Soak};
use cross_tests::faults::{tools, world};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// A week, nearly.
const MOST_MINUTES: f64 = 10_000.0;

/// Breaks a cluster of real processes over and over, or leaves one alone and watches its memory. Needs root.
#[derive(Debug, Parser)]
#[command(name = "faults")]
enum Command {
    /// Faults in a row over one training run
    Strike(Strike),
    /// A run that nothing disturbs
    Soak(SoakOptions),
    /// The kinds of faults
    Kinds,
}

#[derive(Debug, Args)]
struct Strike {
    /// How many faults
    #[arg(long, default_value_t = 200)]
    faults: usize,
    /// What is drawn depends on it alone
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Actors
    #[arg(long, default_value_t = 4)]
    actors: usize,
    /// Only this kind, by its name in `kinds`; may be repeated
    #[arg(long)]
    only: Vec<String>,
    /// Seconds within which throughput has to be back
    #[arg(long, default_value_t = 10.0)]
    limit: f64,
}

#[derive(Debug, Args)]
struct SoakOptions {
    /// How long, 7 at least: the first five do not count
    #[arg(long, default_value_t = 30.0)]
    minutes: f64,
    /// Actors
    #[arg(long, default_value_t = 4)]
    actors: usize,
    /// Configuration of the run, without `updates` [default: the fault suite's]
    #[arg(long)]
    config: Option<PathBuf>,
}

fn main() -> ExitCode {
    if let Some(problem) = tools::missing() {
        eprintln!("faults: {problem}");
        return ExitCode::from(2);
    }
    match Command::parse() {
        Command::Strike(options) => strike(&options),
        Command::Soak(options) => soak(&options),
        Command::Kinds => {
            for kind in Kind::ALL {
                println!("{:<18}{}", format!("{kind:?}"), kind.what());
            }
            ExitCode::SUCCESS
        }
    }
}

fn strike(options: &Strike) -> ExitCode {
    let named = |name: &String| Kind::ALL.into_iter().find(|kind| format!("{kind:?}") == *name);
    let only: Vec<Kind> = options.only.iter().filter_map(named).collect();
    if only.len() < options.only.len() || options.actors < 2 {
        eprintln!("faults: --only takes a name that `kinds` lists, --actors at least 2");
        return ExitCode::from(2);
    }
    let campaign = Campaign {
        seed: options.seed,
        faults: options.faults,
        actors: options.actors,
        longest: 1.0,
        checkpoint_updates: 5,
        only,
        warm_up: Duration::from_secs(15),
        rest: Duration::from_secs(1),
        patience: 1,
    };
    match campaign.run(|line| println!("{line}")) {
        Ok(report) => {
            println!("\n{report}");
            if report.longest().as_secs_f64() <= options.limit {
                return ExitCode::SUCCESS;
            }
            eprintln!("faults: throughput was not always back within {} s", options.limit);
        }
        Err(failed) => {
            let (broken, logs, report) = *failed;
            println!("\n{report}\n{logs}");
            eprintln!("faults: after {} faults of seed {}: {broken}", report.struck.len(), options.seed);
        }
    }
    ExitCode::FAILURE
}

fn soak(options: &SoakOptions) -> ExitCode {
    // A number that is none is refused too.
    if !(LEAST_MINUTES..=MOST_MINUTES).contains(&options.minutes) {
        eprintln!("faults: --minutes is from {LEAST_MINUTES} to {MOST_MINUTES}");
        return ExitCode::from(2);
    }
    let config = match &options.config {
        None => world::CONFIG.to_owned(),
        Some(path) => match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) => {
                eprintln!("faults: cannot read {}: {error}", path.display());
                return ExitCode::from(2);
            }
        },
    };
    let time = Duration::from_secs_f64(60.0 * options.minutes);
    match (Soak { actors: options.actors, time, config }).run(|line| println!("{line}")) {
        Ok(soaked) => {
            println!("\n{soaked}");
            if soaked.growth() < MOST_GROWTH {
                return ExitCode::SUCCESS;
            }
            eprintln!("faults: the learner grew by {MOST_GROWTH} % or more");
        }
        Err(failed) => eprintln!("{}\nfaults: {}", failed.1, failed.0),
    }
    ExitCode::FAILURE
}
