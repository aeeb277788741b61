//! `cross eval`: one policy on one scenario.

mod csv;
mod help;

use crate::evaluate::{Task, default_workers, evaluate_all, seeds};
use crate::failure::{Failure, OrBadInput, Outcome};
use crate::output;
use crate::output_file::OutputFile;
use crate::policy::PolicySpec;
use crate::sumo::SumoOption;
use crate::train::progress::EpisodeProgress;
use clap::Args;
use cross_config::{Config, EnvConfig};
use cross_sim::controller::RuleBased;
use cross_sim::evaluate::{EvalReport, table};
use cross_sim::layout::load_layout;
use cross_sim::preset::Preset;
use cross_sim::scenario::Scenario;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Evaluates a policy on a scenario and reports the metrics of the papers
///
/// Every seed is an episode of its own. The protocol (decision interval, yellow, teleports, seeds, SUMO's version and options,
/// hashes of net and demand) is part of the result: figures compare only where it is the same.
#[derive(Debug, Args)]
#[command(after_help = help::short(), after_long_help = help::long())]
pub(crate) struct Eval {
    /// Name of the scenario, or path of a directory with a scenario.toml
    #[arg(long, value_name = "NAME")]
    scenario: String,
    /// Rule or program by name, or a checkpoint: its directory, a run directory, a model.safetensors, or the URL of one
    #[arg(long, value_name = "POLICY")]
    policy: String,
    /// Draw each phase of a checkpoint by its probability, as in training, instead of taking the most probable one
    ///
    /// The draws depend on SUMO's seed, so that an episode repeats itself.
    #[arg(long)]
    sampled: bool,
    /// SUMO seeds 1 to N
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Episodes at a time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    workers: Option<u16>,
    /// Interval, yellow and teleports of a benchmark: paper, resco or unicorn [default: those of configuration and scenario]
    ///
    /// Without a configuration these are the paper's. A checkpoint is refused where interval or yellow are not those that it
    /// was trained with: it would be measured at something that it never learned.
    #[arg(long, value_name = "NAME")]
    protocol: Option<Preset>,
    /// Configuration whose [env] section a rule-based policy is evaluated in; a checkpoint brings its own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    sumo: SumoOption,
    /// Print the report as one JSON document
    #[arg(long)]
    json: bool,
    /// Write every figure of every seed to a CSV file, and those over all seeds
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the report to a file for `cross report`, with what it draws: curves, trips, queues by intersection
    #[arg(long, value_name = "FILE.json")]
    out: Option<PathBuf>,
}

impl Eval {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let policy = PolicySpec::parse(&self.policy)?;
        let policy = if self.sampled { policy.sampled()? } else { policy };
        let mut env = self.env(&policy)?;
        let mut scenario = Scenario::load(&self.scenario).or_bad_input()?;
        if let Some(preset) = self.protocol {
            preset.apply(&mut scenario, &mut env).or_bad_input()?;
            self.check_trained_for(&policy, preset, &env)?;
        }
        load_layout(&scenario, &env).or_bad_input()?;
        // Before the episodes, which take minutes and would be lost.
        let (csv, out) = (prepared(self.csv.as_deref())?, prepared(self.out.as_deref())?);
        if let (Some(csv), Some(out)) = (&csv, &out)
            && csv.path() == out.path()
        {
            return Err(Failure::input(format!(
                "--csv and --out both name {}; give two files",
                csv.path().display()
            )));
        }
        let home = self.sumo.locate()?;
        let workers = self.workers.map_or_else(default_workers, usize::from);
        let task = Task { scenario: &scenario, env: &env, policy: &policy, details: out.is_some() };
        let progress = EpisodeProgress::new(true, self.seeds as usize);
        let reports = evaluate_all(&home, &[task], &seeds(self.seeds), workers, &|episodes| {
            progress.show(episodes);
            ControlFlow::Continue(())
        });
        progress.finish();
        let Some(mut report) = reports?.pop() else {
            return Err(Failure::failed("no episode was evaluated"));
        };
        if let Some(preset) = self.protocol {
            report.protocol.preset = preset.name().to_owned();
        }
        self.deliver(report, csv.as_ref(), out.as_ref())
    }

    /// Writes the files, then the result that is printed, which has no details.
    fn deliver(
        &self,
        mut report: EvalReport,
        csv: Option<&OutputFile>,
        out: Option<&OutputFile>,
    ) -> Outcome<ExitCode> {
        if let Some(file) = out {
            file.write(format!("{}\n", report.to_json()).as_bytes())?;
        }
        report.details = None;
        if let Some(file) = csv {
            file.write(&csv::table(&report)?)?;
        }
        if self.json {
            output::json(&report)?;
        } else {
            output::text(&table(&[report]))?;
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
            (None, Some(file)) => Config::env_from_file(file).or_bad_input(),
            (None, None) => Ok(EnvConfig::default()),
        }
    }

    /// A policy learned what a decision does for its interval and yellow; at others its figures would tell neither how good
    /// it is nor how good the method is.
    fn check_trained_for(&self, policy: &PolicySpec, preset: Preset, env: &EnvConfig) -> Outcome<()> {
        let Some(own) = policy.env() else { return Ok(()) };
        if (own.decision_seconds, own.yellow_seconds) == (env.decision_seconds, env.yellow_seconds) {
            return Ok(());
        }
        Err(Failure::input(format!(
            "{} was trained for a decision every {} s with {} s of yellow, and the protocol {} has {} s with {} s on {}; train \
             with env.decision_seconds = {} and env.yellow_seconds = {}, or leave out --protocol",
            self.policy,
            own.decision_seconds,
            own.yellow_seconds,
            preset.name(),
            env.decision_seconds,
            env.yellow_seconds,
            self.scenario,
            env.decision_seconds,
            env.yellow_seconds,
        )))
    }
}

fn prepared(path: Option<&Path>) -> Outcome<Option<OutputFile>> {
    path.map(OutputFile::prepare).transpose()
}
