//! The end of a run: the final policy beside the rules, the result document, the picture.

use super::curves;
use super::preflight::Ready;
use super::progress::{EpisodeProgress, say};
use super::run_dir::{self, RunDir};
use super::watch::Watch;
use crate::evaluate::{Task, default_workers, evaluate_all, seeds};
use crate::failure::{Failure, Outcome};
use crate::policy::{PolicySpec, Weights};
use anyhow::Context;
use cross_config::Config;
use cross_sim::controller::RuleBased;
use cross_sim::evaluate::{EvalReport, EvaluateError, strongest, table};
use cross_sim::metrics::Metric;
use cross_support::files::{remove_any, replace_file};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What the trained policy is called in tables.
const TRAINED: &str = "cross";

/// `result.json`, and what `--json` prints.
#[derive(Debug, Serialize)]
pub(crate) struct Summary {
    run: PathBuf,
    run_id: Option<String>,
    /// Stopped on request before the end; the rest tells how far it came.
    pub(crate) interrupted: bool,
    scenarios: Vec<String>,
    seed: u64,
    pub(crate) updates: u64,
    updates_wanted: u64,
    /// Agent-decisions trained on.
    decisions: u64,
    episodes: u64,
    checkpoint: Option<Checkpoint>,
    curves: Option<PathBuf>,
    /// The final policy first, then Fixed-Time and every Max-Pressure variant, for each scenario.
    evaluation: Vec<EvalReport>,
    /// The Max-Pressure variant with the lowest trip delay, by scenario.
    strongest_max_pressure: BTreeMap<String, String>,
    /// Wall-clock time of this command, evaluation included.
    pub(crate) elapsed_seconds: f64,
}

#[derive(Debug, Serialize)]
struct Checkpoint {
    id: String,
    path: PathBuf,
}

impl Summary {
    /// How far training came, by the newest checkpoint.
    pub(crate) fn new(run: &RunDir, config: &Config, interrupted: bool) -> Self {
        let newest = run.newest_checkpoint();
        let metadata = newest.as_ref().map(|(_, metadata)| metadata);
        Self {
            run: run.path().to_owned(),
            run_id: metadata.map(|metadata| metadata.run_id.clone()),
            interrupted,
            scenarios: config.scenarios.clone(),
            seed: config.seed,
            updates: metadata.map_or(0, |metadata| metadata.updates),
            updates_wanted: config.updates,
            decisions: metadata.map_or(0, |metadata| metadata.decisions),
            episodes: metadata.map_or(0, |metadata| metadata.episodes),
            checkpoint: newest.map(|(path, metadata)| Checkpoint { id: metadata.id, path }),
            curves: None,
            evaluation: Vec::new(),
            strongest_max_pressure: BTreeMap::new(),
            elapsed_seconds: 0.0,
        }
    }

    /// Evaluates the final policy beside the rules: same scenarios, same seeds, same protocol.
    ///
    /// A stop in the middle leaves the evaluation out, and counts as an interruption: the training itself is complete.
    pub(crate) fn evaluate(
        &mut self,
        ready: &Ready,
        config: &Config,
        count: u32,
        watch: &Watch,
        visible: bool,
    ) -> Outcome<()> {
        let Some(checkpoint) = &self.checkpoint else {
            return Err(Failure::failed(format!(
                "the learner left no checkpoint in {}; see logs/learner.log there",
                self.run.display()
            )));
        };
        let weights = Weights::read(TRAINED, &checkpoint.path)?;
        let policies: Vec<_> = std::iter::once(PolicySpec::Learned(weights))
            .chain(std::iter::once(PolicySpec::Rule(RuleBased::FixedTime)))
            .chain(RuleBased::MAX_PRESSURE_VARIANTS.map(PolicySpec::Rule))
            .collect();
        let tasks: Vec<_> = ready
            .scenarios
            .iter()
            .flat_map(|scenario| {
                policies.iter().map(move |policy| Task { scenario, env: &config.env, policy, details: true })
            })
            .collect();
        let progress = EpisodeProgress::new(visible, tasks.len() * count as usize);
        let result = evaluate_all(&ready.sumo, &tasks, &seeds(count), default_workers(), &|episodes| {
            progress.show(episodes);
            if watch.wait(Duration::ZERO).1 > 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        progress.finish();
        match result {
            Ok(mut reports) => {
                store(&self.run.join(run_dir::EVALUATION), &reports)?;
                // They are for pictures and would make the result many times as long.
                reports.iter_mut().for_each(|report| report.details = None);
                self.strongest_max_pressure = strongest_variants(&reports);
                self.evaluation = reports;
                Ok(())
            }
            Err(EvaluateError::Stopped) => {
                self.leave_out_evaluation();
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Says that a stop came before the evaluation was done: an interruption, though the training itself is complete.
    pub(crate) fn leave_out_evaluation(&mut self) {
        say("the evaluation was stopped; the training is complete, and `cross eval` takes its checkpoint");
        self.interrupted = true;
    }

    /// Writes `result.json` and returns what it holds.
    pub(crate) fn write(&self, run: &RunDir) -> Outcome<serde_json::Value> {
        let document = serde_json::to_value(self)?;
        run_dir::write_atomically(&run.result(), format!("{document:#}\n").as_bytes())?;
        Ok(document)
    }

    /// The table, and where everything is.
    pub(crate) fn render(&self) -> String {
        let marked: Vec<_> = self
            .evaluation
            .iter()
            .cloned()
            .map(|mut report| {
                if self.strongest_max_pressure.get(&report.scenario) == Some(&report.policy) {
                    report.policy.push_str(" (strongest)");
                }
                report
            })
            .collect();
        let mut text = table(&marked);
        if !marked.is_empty() {
            text.push('\n');
        }
        for line in self.verdicts() {
            let _ = writeln!(text, "{line}");
        }
        let places = [
            ("checkpoint", self.checkpoint.as_ref().map(|checkpoint| &checkpoint.path)),
            ("learning curves", self.curves.as_ref()),
            ("result", (!self.evaluation.is_empty()).then(|| self.run.join("result.json")).as_ref()),
        ]
        .map(|(name, path)| path.map(|path| format!("{name}: {}", path.display())));
        for line in places.into_iter().flatten() {
            let _ = writeln!(text, "{line}");
        }
        text
    }

    /// The trained policy against the strongest rule, in words.
    fn verdicts(&self) -> Vec<String> {
        let delay = |scenario: &str, policy: &str| {
            let mut reports = self.evaluation.iter();
            let report = reports.find(|report| report.scenario == scenario && report.policy == policy)?;
            Some(report.get(Metric::TripDelay).mean)
        };
        let verdict = |(scenario, rule): (&String, &String)| {
            let (own, best) = (delay(scenario, TRAINED)?, delay(scenario, rule)?);
            let change = 100.0 * (own - best) / best;
            let direction = if change < 0.0 { "below" } else { "above" };
            change.is_finite().then(|| {
                format!(
                    "{scenario}: mean trip delay {own:.1} s, {:.0} % {direction} the strongest Max-Pressure ({rule}, {best:.1} s)",
                    change.abs()
                )
            })
        };
        self.strongest_max_pressure.iter().filter_map(verdict).collect()
    }
}

/// Writes each report with its details to a file of its own, where `cross report` finds it.
fn store(folder: &Path, reports: &[EvalReport]) -> Outcome<()> {
    let failed = || format!("cannot write the evaluation into {}", folder.display());
    // Those of an earlier end of the same run were of other weights.
    remove_any(folder).with_context(failed)?;
    std::fs::create_dir_all(folder).with_context(failed)?;
    for report in reports {
        let name = format!("{}-{}.json", report.scenario, report.policy).replace('/', "-");
        replace_file(&folder.join(name), report.to_json().as_bytes()).with_context(failed)?;
    }
    Ok(())
}

fn strongest_variants(reports: &[EvalReport]) -> BTreeMap<String, String> {
    let is_variant = |report: &&EvalReport| {
        RuleBased::MAX_PRESSURE_VARIANTS.iter().any(|rule| rule.name() == report.policy)
    };
    let scenarios = reports.iter().map(|report| &report.scenario);
    scenarios
        .filter_map(|scenario| {
            let variants = reports.iter().filter(is_variant).filter(|report| report.scenario == *scenario);
            Some((scenario.clone(), strongest(variants)?.policy.clone()))
        })
        .collect()
}

/// Draws the learning curves. A run that did not get to its first update has none; a picture that cannot be drawn is said
/// and costs nothing else.
pub(crate) fn draw_curves(run: &RunDir, summary: &mut Summary) {
    if summary.updates == 0 {
        return;
    }
    match curves::draw(&run.metrics(), &run.curves()) {
        Ok(()) => summary.curves = Some(run.curves()),
        Err(error) => say(&format!("{error:#}")),
    }
}
