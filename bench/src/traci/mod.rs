//! `cross bench traci`: episodes through our TraCI client, as an actor drives them, beside the same episodes through other
//! clients.
//!
//! ```text
//!   Max-Pressure, once ──> Plan ─┬─ actions ──> Env (ours) ───────────────────> counts ─┐
//!                                └─ Job ──> program of a client ──> vehicles ──> counts ─┴─ must be equal
//! ```
//! Everybody runs SUMO with the same command line and seed, sets the same signals at the same seconds, and has lane,
//! position and speed of every vehicle at each decision. Who saw other traffic than ours is an error, not a ratio.

mod clients;
pub mod job;
mod plan;
mod program;
mod seen;

use crate::cost::{self, Cost, measured};
use crate::error::BenchError;
use crate::progress::Progress;
use crate::report::{Report, Row};
use clients::Client;
use cross_config::EnvConfig;
use cross_sim::env::{Env, EnvOptions};
use cross_sim::lanes::LaneTable;
use cross_sim::scenario::Scenario;
use cross_traci::{SumoCommand, SumoHome};
use job::Way;
use plan::Plan;
use seen::Seen;
use std::path::PathBuf;

/// What to measure.
#[derive(Debug)]
pub struct Options {
    /// SUMO to run.
    pub home: SumoHome,
    /// Networks, one after another.
    pub scenarios: Vec<Scenario>,
    /// Decisions, signals, and the length of an episode.
    pub env: EnvConfig,
    /// SUMO's seed.
    pub seed: u32,
    /// Repetitions of each pair.
    pub repeats: u32,
    /// Python to use; without it, `python3`.
    pub python: Option<PathBuf>,
}

impl Way {
    /// From the slowest to the fastest.
    pub const ALL: [Self; 4] = [Self::Polling, Self::EverySecond, Self::EveryDecision, Self::Momentary];

    /// In a few words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Polling => "polling",
            Self::EverySecond => "subscription by the second",
            Self::EveryDecision => "subscription by the decision",
            Self::Momentary => "subscription for the moment",
        }
    }
}

/// Measures.
///
/// # Errors
/// [`BenchError`] if SUMO or a client fails, or if a client saw other traffic than ours. A client that is not here is left
/// out, which `progress` is told with the reason.
pub fn run(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    let mut clients = Vec::new();
    for (name, found) in [
        ("traci-rs", Client::traci_rs()),
        ("Python's traci", Client::python(options.python.as_deref(), &options.home)),
    ] {
        match found {
            Ok(client) => {
                progress(&format!("{name}: {}", client.title));
                clients.push(client);
            }
            Err(reason) => progress(&format!("{name} is left out: {reason}")),
        }
    }
    let mut rows = Vec::new();
    for scenario in &options.scenarios {
        compare(scenario, &clients, options, progress, &mut rows)?;
    }
    Ok(Report::new("traci", rows))
}

/// Ours and each way of each client by turns.
fn compare(
    scenario: &Scenario,
    clients: &[Client],
    options: &Options,
    progress: Progress<'_>,
    rows: &mut Vec<Row>,
) -> Result<(), BenchError> {
    let name = &scenario.name;
    // Reading the net is done once in an actor's life.
    let mut env = Env::new(&options.home, scenario, EnvOptions::new(options.env.clone()))?;
    let plan = Plan::drive(&mut env, options.seed)?;
    progress(&format!("{name}: {} decisions of Max-Pressure to follow", plan.actions.len()));
    let sumo = SumoCommand::new().args(&plan.arguments);
    let mut lanes = LaneTable::new(env.layout(), f64::from(options.env.reward_range_metres));
    let ways = clients.iter().flat_map(|client| Way::ALL.map(|way| (client, way)));
    let mut turns: Vec<_> = ways.map(|(client, way)| (client, way, Vec::new())).collect();
    for repeat in 1..=options.repeats {
        for (client, way, costs) in &mut turns {
            let (ours, seen) = own(&mut env, options.seed, &plan)?;
            let job = plan.job(*way);
            let (theirs, their_seen) = program::episode(client, &job, &options.home, &sumo, &mut lanes)?;
            seen.check(&their_seen, &client.title, env.layout())?;
            progress(&format!(
                "{name}, {}, {}, {repeat} of {}: {:.2} s, ours {:.2} s, ratio {:.2} (CPU {:.2}, outside SUMO {:.2} s, ours {:.2} s); {} looks at vehicles, all alike",
                client.name,
                way.name(),
                options.repeats,
                theirs.wall,
                ours.wall,
                theirs.wall / ours.wall,
                theirs.cpu / ours.cpu,
                theirs.own_cpu,
                ours.own_cpu,
                their_seen.vehicles.unwrap_or_default(),
            ));
            costs.push((ours, theirs));
        }
    }
    for (client, way, costs) in &turns {
        let case = format!("{name}, {}, {}", client.name, way.name());
        cost::compare(&case, &client.title, costs, rows);
    }
    Ok(())
}

/// Our side: the environment of an actor, which follows the plan.
fn own(env: &mut Env, seed: u32, plan: &Plan) -> Result<(Cost, Seen), BenchError> {
    let (seen, cost) = measured(|| {
        let mut seen = Seen::default();
        env.reset(seed)?;
        for actions in &plan.actions {
            env.step(actions)?;
            seen.note(env.lanes());
        }
        env.finish()?;
        Ok(seen)
    })?;
    Ok((cost, seen))
}
