//! `cross eval`: one policy on one scenario.

use crate::evaluate::{Task, default_workers, evaluate_all, seeds};
use crate::failure::{Failure, OrBadInput, Outcome};
use crate::output;
use crate::policy::PolicySpec;
use crate::sumo::SumoOption;
use crate::train::progress::EpisodeProgress;
use clap::Args;
use cross_config::{Config, EnvConfig};
use cross_sim::controller::RuleBased;
use cross_sim::evaluate::table;
use cross_sim::layout::load_layout;
use cross_sim::scenario::Scenario;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;

/// Evaluates a policy on a scenario and reports the metrics of the papers
///
/// Every seed is an episode of its own. The protocol (decision interval, yellow, seeds, SUMO's version and options, hashes of
/// net and demand) is part of the result: figures compare only where it is the same.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross eval --scenario grid4x4 --policy fixed-time
  cross eval --scenario grid4x4 --policy max-pressure-stopped --seeds 5
  cross eval --scenario arterial4x4 --policy runs/20260131-235959             a run's newest checkpoint
  cross eval --scenario grid4x4 --policy runs/paper-3/checkpoints/000100 --json
  cross eval --scenario grid4x4 --policy policy.safetensors                   what `cross checkpoint export` wrote

Rule-based policies: fixed-time, greedy, random, max-pressure (as published for the scenario), max-pressure-stopped,
max-pressure-all, max-pressure-stopped-50m (explicit variants).")]
pub(crate) struct Eval {
    /// Name of the scenario, or path of a directory with a scenario.toml
    #[arg(long, value_name = "NAME")]
    scenario: String,
    /// Rule by name, or a checkpoint: its directory, a run directory, or a model.safetensors
    #[arg(long, value_name = "POLICY")]
    policy: String,
    /// SUMO seeds 1 to N
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    seeds: u32,
    /// Episodes at a time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    workers: Option<u16>,
    /// Configuration whose [env] section a rule-based policy is evaluated in; a checkpoint brings its own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    sumo: SumoOption,
    /// Print the report as one JSON document
    #[arg(long)]
    json: bool,
}

impl Eval {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let policy = PolicySpec::parse(&self.policy)?;
        let env = self.env(&policy)?;
        let scenario = Scenario::load(&self.scenario).or_bad_input()?;
        load_layout(&scenario, &env).or_bad_input()?;
        let home = self.sumo.locate()?;
        let workers = self.workers.map_or_else(default_workers, usize::from);
        let task = Task { scenario: &scenario, env: &env, policy: &policy };
        let progress = EpisodeProgress::new(true, self.seeds as usize);
        let reports = evaluate_all(&home, &[task], &seeds(self.seeds), workers, &|episodes| {
            progress.show(episodes);
            ControlFlow::Continue(())
        });
        progress.finish();
        let reports = reports?;
        match reports.first() {
            Some(report) if self.json => output::json(report)?,
            _ => output::text(&table(&reports))?,
        }
        Ok(ExitCode::SUCCESS)
    }

    fn env(&self, policy: &PolicySpec) -> Outcome<EnvConfig> {
        match (policy.env(), &self.config) {
            (Some(own), None) => Ok(own.clone()),
            (Some(_), Some(_)) => Err(Failure::input(format!(
                "{} brings the environment it was trained for; leave out --config, which is for {}",
                self.policy,
                RuleBased::names().join(", ")
            ))),
            (None, Some(file)) => Ok(Config::from_file(file).or_bad_input()?.env),
            (None, None) => Ok(EnvConfig::default()),
        }
    }
}
