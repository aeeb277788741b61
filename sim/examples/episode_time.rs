//! Wall time of one episode through the environment, beside where it went; for comparing with plain SUMO.
//!
//! Run with `cargo run --release -p cross-sim --example episode_time [SCENARIO [SEED]]`.

#![expect(clippy::print_stdout, reason = "an example prints its result")]

use cross_sim::env::{Env, EnvOptions, SecondView};
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use std::error::Error;
use std::fmt::Write;
use std::time::Instant;

/// A line for an episode stepped by decisions, and one for an episode watched each second.
pub(crate) fn times(scenario: &str, seed: u32) -> Result<String, Box<dyn Error>> {
    let scenario = Scenario::load(scenario)?;
    let mut env = Env::new(&SumoHome::locate(None)?, &scenario, EnvOptions::default())?;
    let mut lines = String::new();
    for (how, observed) in [("by decision", false), ("by second", true)] {
        let (begun, before) = (Instant::now(), env.timings());
        env.reset(seed)?;
        let started = begun.elapsed();
        let phases: Vec<usize> = env.layout().intersections.iter().map(|at| at.phases.len()).collect();
        for step in 0.. {
            // The next phase at every decision.
            let actions: Vec<u8> = phases.iter().map(|phases| (step % phases) as u8).collect();
            let done = if observed {
                env.step_observed(&actions, &mut |_: &SecondView<'_>| {})?.done
            } else {
                env.step(&actions)?.done
            };
            if done {
                break;
            }
        }
        let after = env.timings();
        writeln!(
            lines,
            "{how}: {:.2?} (start {started:.2?}, sumo {:.2?}, traci {:.2?})",
            begun.elapsed(),
            after.sumo - before.sumo,
            after.traci - before.traci
        )?;
    }
    Ok(lines)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let scenario = arguments.next().unwrap_or_else(|| "grid4x4".to_owned());
    let seed = arguments.next().unwrap_or_else(|| "1".to_owned()).parse()?;
    print!("{}", times(&scenario, seed)?);
    Ok(())
}
