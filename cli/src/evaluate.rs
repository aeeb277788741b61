//! Several policies on several scenarios, all cores busy until the last episode.

use crate::policy::PolicySpec;
use cross_config::EnvConfig;
use cross_sim::controller::ControllerError;
use cross_sim::evaluate::{EvalReport, EvaluateError, Setting, evaluate_seeds};
use cross_sim::scenario::Scenario;
use cross_traci::sumo::SumoHome;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// A policy on a scenario.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Task<'a> {
    pub(crate) scenario: &'a Scenario,
    pub(crate) env: &'a EnvConfig,
    pub(crate) policy: &'a PolicySpec,
    /// Whether the report shall have what `cross report` draws.
    pub(crate) details: bool,
}

/// How far an evaluation is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Episodes {
    pub(crate) finished: usize,
    pub(crate) all: usize,
}

/// Evaluates every task with the same seeds and returns a report for each, in their order.
///
/// Episodes, not tasks, are handed to the workers: a task with three seeds would leave one of two cores idle in between.
/// `progress` is called after every decision, from all workers, and may end the evaluation.
pub(crate) fn evaluate_all(
    home: &SumoHome,
    tasks: &[Task<'_>],
    seeds: &[u32],
    workers: usize,
    progress: &(dyn Fn(Episodes) -> ControlFlow<()> + Sync),
) -> Result<Vec<EvalReport>, EvaluateError> {
    let jobs: Vec<_> =
        (0..tasks.len()).flat_map(|task| seeds.iter().map(move |&seed| (task, seed))).collect();
    let next = AtomicUsize::new(0);
    let finished = AtomicUsize::new(0);
    let results = Mutex::new(Ok(Vec::with_capacity(jobs.len())));
    let lock = || results.lock().unwrap_or_else(PoisonError::into_inner);
    std::thread::scope(|scope| {
        for number in 0..workers.clamp(1, jobs.len().max(1)) {
            let work = || {
                while let Some(&(task, seed)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let step = |_| {
                        if lock().is_err() {
                            return ControlFlow::Break(());
                        }
                        progress(Episodes { finished: finished.load(Ordering::Relaxed), all: jobs.len() })
                    };
                    let report = tasks.get(task).map(|task| episode(home, task, seed, &step));
                    finished.fetch_add(1, Ordering::Relaxed);
                    match (&mut *lock(), report) {
                        (Ok(reports), Some(Ok(report))) => reports.push((task, report)),
                        // The first error is the cause, the others only follow from it.
                        (results @ Ok(_), Some(Err(error))) => *results = Err(error),
                        _ => return,
                    }
                }
            };
            let builder = std::thread::Builder::new().name(format!("evaluate-{number}"));
            if let Err(source) = builder.spawn_scoped(scope, work) {
                // The workers that are there do all of it, if there is any.
                if number == 0 {
                    *lock() = Err(EvaluateError::Thread { source });
                }
                break;
            }
        }
    });
    let reports = results.into_inner().unwrap_or_else(PoisonError::into_inner)?;
    Ok(merge(tasks.len(), reports))
}

fn episode(
    home: &SumoHome,
    task: &Task<'_>,
    seed: u32,
    step: &(dyn Fn(cross_sim::evaluate::SeedProgress) -> ControlFlow<()> + Sync),
) -> Result<EvalReport, EvaluateError> {
    let setting = Setting { details: task.details, ..Setting::new(home, task.scenario, task.env) };
    let make =
        || task.policy.controller(task.scenario).map_err(|error| ControllerError::from(error.to_string()));
    evaluate_seeds(&setting, task.policy.name(), &make, &[seed], 1, step)
}

/// Joins the reports of single episodes to one for each task.
fn merge(tasks: usize, reports: Vec<(usize, EvalReport)>) -> Vec<EvalReport> {
    let mut of_task: Vec<Vec<EvalReport>> = vec![Vec::new(); tasks];
    for (task, report) in reports {
        if let Some(of_task) = of_task.get_mut(task) {
            of_task.push(report);
        }
    }
    of_task.into_iter().filter_map(EvalReport::join).collect()
}

/// Seeds 1 to `count`.
pub(crate) fn seeds(count: u32) -> Vec<u32> {
    (1..=count).collect()
}

/// One episode for each core at a time.
pub(crate) fn default_workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
