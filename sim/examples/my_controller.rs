//! A controller of one's own beside the built-in ones.
//!
//! Run with `cargo run --release -p cross-sim --example my_controller [SCENARIO [SECONDS]]`.
//!
//! "Longest first": green to the phase that serves the lane with the longest queue, and no change of phase, with its
//! three seconds of yellow, while nobody else waits longer.

#![expect(clippy::print_stdout, reason = "an example prints its result")]

use cross_config::EnvConfig;
use cross_sim::controller::{Controller, ControllerError, ControllerView, RuleBased};
use cross_sim::evaluate::{Setting, evaluate_seeds, table};
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use std::ops::ControlFlow;

struct LongestFirst;

impl Controller for LongestFirst {
    fn name(&self) -> &str {
        "longest-first"
    }

    fn act(&mut self, view: &ControllerView<'_>, actions: &mut [u8]) -> Result<(), ControllerError> {
        for (agent, intersection) in view.layout.intersections.iter().enumerate() {
            let longest_queue = |phase: u8| {
                let links = intersection.phases[usize::from(phase)].green.iter().zip(&intersection.movements);
                let queues = links
                    .filter(|(green, _)| **green > 0.0)
                    .map(|(_, link)| view.lanes.incoming(agent, link.incoming).stopped);
                queues.max().unwrap_or(0)
            };
            // Before the call each action is the current phase.
            let mut best = actions[agent];
            for phase in 0..intersection.phases.len() as u8 {
                if longest_queue(phase) > longest_queue(best) {
                    best = phase;
                }
            }
            actions[agent] = best;
        }
        Ok(())
    }
}

/// A table of the controller beside two rules, over two seeds.
pub(crate) fn compare(scenario: &str, seconds: u32) -> Result<String, Box<dyn std::error::Error>> {
    let home = SumoHome::locate(None)?;
    let scenario = Scenario::load(scenario)?;
    let env = EnvConfig { episode_seconds: seconds, ..EnvConfig::default() };
    let setting = Setting::new(&home, &scenario, &env);
    let reference = scenario.reference.max_pressure;
    let (seeds, workers) = ([1, 2], 2);
    let go_on = |_| ControlFlow::Continue(());

    let mine =
        evaluate_seeds(&setting, "longest-first", &|| Ok(Box::new(LongestFirst)), &seeds, workers, &go_on)?;
    let mut reports = vec![mine];
    for policy in [RuleBased::FixedTime, RuleBased::MaxPressureStopped] {
        let make = || Ok(policy.controller(reference));
        reports.push(evaluate_seeds(&setting, policy.name(), &make, &seeds, workers, &go_on)?);
    }
    Ok(table(&reports))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let scenario = arguments.next().unwrap_or_else(|| "grid4x4".to_owned());
    let seconds = arguments.next().unwrap_or_else(|| "3600".to_owned()).parse()?;
    print!("{}", compare(&scenario, seconds)?);
    Ok(())
}
