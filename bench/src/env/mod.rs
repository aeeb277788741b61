//! `cross bench env`: episodes through the actor's whole path beside bare SUMO replaying the very same signal plan, and what
//! a decision of the policy costs.
//!
//! ```text
//!   ours: Env + controller or policy ── actions ──> Plan ── static programs ──> sumo alone
//!                └── trips ─────────────────────── must be equal ───────────────── trips
//! ```
//! Both write SUMO's record of trips, by which they are compared; a pair with other traffic is an error, not a ratio.

mod bare;
pub(crate) mod drive;
mod inference;
mod plan;

use crate::cost::{self, Cost};
use crate::error::BenchError;
use crate::folder::folder;
use crate::progress::Progress;
use crate::report::{Report, Row};
use cross_config::{Config, EnvConfig};
use cross_model::{Policy, Trainer};
use cross_sim::controller::RuleBased;
use cross_sim::layout::load_layout;
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use drive::{Driven, Driver, drive};
use plan::Plan;

/// Steps of a fragment that a policy's episode is recorded in.
const FRAGMENT_STEPS: u32 = 60;
const BARE: &str = "sumo alone, same signal plan";

/// What to measure.
#[derive(Debug)]
pub struct Options {
    /// SUMO to run.
    pub home: SumoHome,
    /// Networks, one after another.
    pub scenarios: Vec<Scenario>,
    /// Weights that choose, as a snapshot; without them, fresh ones.
    pub weights: Option<Vec<u8>>,
    /// SUMO's seed.
    pub seed: u32,
    /// Repetitions of each pair.
    pub repeats: u32,
}

/// Measures.
///
/// # Errors
/// [`BenchError`] if SUMO fails, or if the replay's traffic is not the same.
pub fn run(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    cross_model::set_single_threaded();
    let mut rows = Vec::new();
    inference::run(options.weights.as_deref(), progress, &mut rows)?;
    for scenario in &options.scenarios {
        episodes(scenario, options, progress, &mut rows)?;
    }
    Ok(Report::new("env", rows))
}

/// How an episode is driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Rule,
    Policy,
    Metrics,
}

impl Way {
    const ALL: [Self; 3] = [Self::Rule, Self::Policy, Self::Metrics];

    fn name(self) -> &'static str {
        match self {
            Self::Rule => "Max-Pressure",
            Self::Policy => "CROSS policy",
            Self::Metrics => "Max-Pressure with metrics every second",
        }
    }
}

fn episodes(
    scenario: &Scenario,
    options: &Options,
    progress: Progress<'_>,
    rows: &mut Vec<Row>,
) -> Result<(), BenchError> {
    let fresh;
    let weights = match &options.weights {
        Some(weights) => weights,
        None => {
            fresh = snapshot(&Config::default())?;
            &fresh
        }
    };
    let mut policy = Policy::from_snapshot(weights)?;
    let mut rule = RuleBased::MaxPressure.controller(scenario.reference.max_pressure);
    let mut costs: [Vec<(Cost, Cost)>; 3] = Default::default();
    for repeat in 1..=options.repeats {
        for (way, costs) in Way::ALL.into_iter().zip(&mut costs) {
            let (env, driver) = match way {
                Way::Rule => (EnvConfig::default(), Driver::Rule(&mut *rule)),
                Way::Metrics => (EnvConfig::default(), Driver::Measured(&mut *rule)),
                Way::Policy => (policy.env().clone(), Driver::Policy(&mut policy, FRAGMENT_STEPS)),
            };
            let Pair { ours, bare, vehicles, wire } = pair(scenario, &env, options, driver)?;
            let wire =
                wire.map_or_else(String::new, |bytes| format!("; {bytes:.1} bytes a decision to send"));
            progress(&format!(
                "{}, {}, {repeat} of {}: {:.2} s, sumo alone {:.2} s, ratio {:.3} (CPU {:.3}, outside SUMO {:.2} s); {vehicles} vehicles, all alike{wire}",
                scenario.name,
                way.name(),
                options.repeats,
                ours.wall,
                bare.wall,
                ours.wall / bare.wall,
                ours.cpu / bare.cpu,
                ours.own_cpu,
            ));
            costs.push((ours, bare));
        }
    }
    for (way, costs) in Way::ALL.into_iter().zip(&costs) {
        cost::compare(&format!("{}, {}", scenario.name, way.name()), BARE, costs, rows);
    }
    Ok(())
}

/// An episode of ours beside its replay.
struct Pair {
    ours: Cost,
    bare: Cost,
    /// Vehicles whose trips are the same.
    vehicles: usize,
    /// Bytes for each intersection and decision, where they were encoded.
    wire: Option<f64>,
}

/// An episode of ours and its replay; both must have moved the same vehicles in the same way.
fn pair(
    scenario: &Scenario,
    env: &EnvConfig,
    options: &Options,
    driver: Driver<'_>,
) -> Result<Pair, BenchError> {
    let folder = folder()?;
    let (own_trips, bare_trips) = (folder.path().join("ours.xml"), folder.path().join("bare.xml"));
    let Driven { cost: ours, actions, arguments, encoded } =
        drive(&options.home, scenario, env, options.seed, &own_trips, driver)?;
    let layout = load_layout(scenario, env)?;
    let plan = Plan::new(&layout, env, scenario.begin, &actions).map_err(cross_sim::SimError::from)?;
    let end = scenario.begin + env.steps_per_episode() * env.decision_seconds;
    let bare = bare::replay(&options.home, &arguments, &plan, end, folder.path(), &bare_trips)?;
    let vehicles = bare::same_trips(&own_trips, &bare_trips)?;
    let decisions = actions.iter().map(Vec::len).sum::<usize>().max(1);
    Ok(Pair { ours, bare, vehicles, wire: encoded.map(|bytes| bytes as f64 / decisions as f64) })
}

/// A snapshot of fresh weights.
pub(crate) fn snapshot(config: &Config) -> Result<Vec<u8>, BenchError> {
    Ok(Trainer::new(config, Vec::new())?.snapshot()?)
}
