//! Simulating what the store does not have yet, on all cores.

use super::plan::{Job, Plan};
use super::progress::Progress;
use super::store::Store;
use crate::failure::{Failure, Outcome};
use crate::routing::{EpisodeRouting, RoutingLog};
use crate::train::progress::say;
use crate::train::watch::Watch;
use cross_sim::controller::ControllerError;
use cross_sim::evaluate::{EvalReport, EvaluateError, SeedProgress, Setting, evaluate_seeds};
use cross_support::client::ClientSecurity;
use cross_traci::sumo::SumoHome;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// How it ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// Every episode of the plan is in the store.
    Complete,
    /// A signal came; so many episodes are still to do.
    Stopped { left: usize },
}

/// Simulates the episodes of the plan that the store does not have, at most `workers` at a time.
///
/// Each result is kept as soon as it is there. An episode that fails does not keep the others from being done; it is an error
/// at the end.
pub(crate) fn complete(plan: &Plan, store: &Store, home: &SumoHome, workers: usize) -> Outcome<End> {
    let jobs = plan.jobs();
    let all = jobs.len();
    let jobs: Vec<_> = jobs.into_iter().filter(|job| store.load(&plan.made(job)).is_none()).collect();
    if jobs.len() < all {
        say(&format!("{} of {all} episodes are in {} already", all - jobs.len(), store.folder().display()));
    }
    if jobs.is_empty() {
        return Ok(End::Complete);
    }
    // No learner is asked anything: only its signals are wanted.
    let watch = Watch::start(ClientSecurity::default())
        .map_err(|error| Failure::failed(format!("cannot listen for signals: {error}")))?;
    let work = Work {
        plan,
        store,
        home,
        progress: Progress::new(jobs.len(), jobs.iter().map(Job::weight).sum()),
        jobs,
        next: AtomicUsize::new(0),
        finished: AtomicUsize::new(0),
        stopped: AtomicBool::new(false),
        failures: Mutex::default(),
        watch,
    };
    std::thread::scope(|scope| {
        for number in 0..workers.clamp(1, work.jobs.len()) {
            let builder = std::thread::Builder::new().name(format!("baselines-{number}"));
            if let Err(error) = builder.spawn_scoped(scope, || work.work()) {
                // The workers that are there do all of it, if there is any.
                if number == 0 {
                    work.refuse(format!("cannot start a thread: {error}; end other programs"));
                }
                break;
            }
        }
    });
    work.progress.clear();
    let left = work.jobs.len() - work.finished.into_inner();
    if work.stopped.into_inner() {
        return Ok(End::Stopped { left });
    }
    let failures = work.failures.into_inner().unwrap_or_else(PoisonError::into_inner);
    match failures.as_slice() {
        [] => Ok(End::Complete),
        [only] => Err(Failure::failed(only)),
        [first, ..] => {
            Err(Failure::failed(format!("{} episodes failed, the first of them: {first}", failures.len())))
        }
    }
}

/// What the workers share.
struct Work<'w> {
    plan: &'w Plan,
    store: &'w Store,
    home: &'w SumoHome,
    jobs: Vec<Job<'w>>,
    progress: Progress,
    next: AtomicUsize,
    finished: AtomicUsize,
    stopped: AtomicBool,
    failures: Mutex<Vec<String>>,
    watch: Watch,
}

impl Work<'_> {
    fn work(&self) {
        loop {
            let number = self.next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = self.jobs.get(number).filter(|_| !self.stop_wanted()) else { return };
            let kept = self
                .episode(number, job)
                .map_err(Failure::from)
                .and_then(|(report, routing)| self.store.save(&self.plan.made(job), report, &routing));
            match kept {
                Ok(()) => {
                    self.finished.fetch_add(1, Ordering::Relaxed);
                }
                // A signal reaches SUMO as well, so that what fails now need not be its fault.
                Err(_) if self.stop_wanted() => return,
                Err(failure) => self.fail(job, &failure),
            }
            self.progress.finish(number, job.weight());
        }
    }

    fn episode(&self, number: usize, job: &Job<'_>) -> Result<(EvalReport, EpisodeRouting), EvaluateError> {
        let scenario = &job.subject.scenario;
        let setting =
            Setting { details: true, ..Setting::new(self.home, scenario, self.plan.env(job.policy)) };
        let log = RoutingLog::default();
        let make = || {
            let controller = job.policy.logged(scenario, Some(log.clone()));
            controller.map_err(|error| ControllerError::from(error.to_string()))
        };
        let step = |at: SeedProgress| {
            self.progress.step(number, job.weight() * f64::from(at.step) / f64::from(at.steps.max(1)));
            if self.stop_wanted() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let report = evaluate_seeds(&setting, job.policy.name(), &make, &[job.seed], 1, &step)?;
        Ok((report, log.shares()))
    }

    /// Whether somebody has asked to stop; the request itself is seen by one worker only.
    fn stop_wanted(&self) -> bool {
        if self.watch.wait(Duration::ZERO).1 > 0 {
            self.stopped.store(true, Ordering::Relaxed);
        }
        self.stopped.load(Ordering::Relaxed)
    }

    fn fail(&self, job: &Job<'_>, failure: &Failure) {
        let text =
            format!("{} on {}, seed {}: {failure}", job.policy.name(), job.subject.scenario.name, job.seed);
        say(&format!("failed: {text}"));
        self.refuse(text);
    }

    fn refuse(&self, text: String) {
        self.failures.lock().unwrap_or_else(PoisonError::into_inner).push(text);
    }
}
