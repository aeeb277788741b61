//! Several episodes at a time.

use super::details::{Details, NetworkDrawing};
use super::episode::{Episode, evaluate};
use super::report::{EvalReport, Protocol};
use super::{EvaluateError, Setting};
use crate::controller::{Controller, ControllerError};
use crate::error::SimError;
use crate::layout;
use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;

/// Makes a controller, once in each worker thread, which alone uses it.
pub type MakeController<'a> = dyn Fn() -> Result<Box<dyn Controller>, ControllerError> + Sync + 'a;

/// How far an evaluation is, told after each decision of each of its episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SeedProgress {
    /// SUMO seed of the episode that made a decision.
    pub seed: u32,
    /// Decisions that it has made.
    pub step: u32,
    /// Decisions of an episode.
    pub steps: u32,
    /// Episodes that are over.
    pub finished: usize,
    /// Episodes of the evaluation.
    pub episodes: usize,
}

/// Evaluates a policy with several SUMO seeds, at most `workers` episodes at a time, and summarises.
///
/// Each worker has a thread, a SUMO and a controller of its own; the report depends on none of this. `progress` is called
/// from all of them and may end the evaluation, as does the first error.
///
/// # Errors
/// [`EvaluateError`]: no or repeated seeds, or the first failure of an episode.
pub fn evaluate_seeds(
    setting: &Setting<'_>,
    policy: &str,
    make: &MakeController<'_>,
    seeds: &[u32],
    workers: usize,
    progress: &(dyn Fn(SeedProgress) -> ControlFlow<()> + Sync),
) -> Result<EvalReport, EvaluateError> {
    check(seeds)?;
    let (net, layout) = layout::read(setting.scenario, setting.env)?;
    let version = setting.home.version().map_err(SimError::from)?;
    let job = Job {
        setting,
        policy,
        make,
        seeds,
        progress,
        next: AtomicUsize::new(0),
        finished: AtomicUsize::new(0),
        stop: AtomicBool::new(false),
        outcome: Mutex::default(),
    };
    thread::scope(|scope| {
        for worker in 0..workers.clamp(1, seeds.len()) {
            let builder = thread::Builder::new().name(format!("evaluate-{worker}"));
            if let Err(source) = builder.spawn_scoped(scope, || job.work()) {
                job.fail(EvaluateError::Thread { source });
                break;
            }
        }
    });
    // A worker that panicked has made the scope panic, so that no lock is poisoned here.
    let Outcome { episodes, controller, error } =
        job.outcome.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some(error) = error {
        return Err(error);
    }
    let (metrics, details): (_, Vec<_>) =
        episodes.into_iter().map(|episode| (episode.metrics, episode.details)).unzip();
    let report = EvalReport::new(
        setting.scenario.name.clone(),
        policy.to_owned(),
        controller,
        Protocol::new(setting, &layout, version),
        metrics,
    );
    Ok(match details.into_iter().collect() {
        Some(seeds) => report.with_details(Details { network: NetworkDrawing::new(&net, &layout), seeds }),
        None => report,
    })
}

fn check(seeds: &[u32]) -> Result<(), EvaluateError> {
    let mut sorted = seeds.to_vec();
    sorted.sort_unstable();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        _ if seeds.is_empty() => Err(EvaluateError::NoSeeds),
        Some(pair) => Err(EvaluateError::RepeatedSeed { seed: pair[0] }),
        None => Ok(()),
    }
}

/// What the workers share.
struct Job<'j> {
    setting: &'j Setting<'j>,
    policy: &'j str,
    make: &'j MakeController<'j>,
    seeds: &'j [u32],
    progress: &'j (dyn Fn(SeedProgress) -> ControlFlow<()> + Sync),
    /// Index of the next seed that nobody has taken.
    next: AtomicUsize,
    finished: AtomicUsize,
    stop: AtomicBool,
    outcome: Mutex<Outcome>,
}

#[derive(Default)]
struct Outcome {
    episodes: Vec<Episode>,
    controller: String,
    error: Option<EvaluateError>,
}

impl Job<'_> {
    fn work(&self) {
        if let Err(error) = self.episodes() {
            self.fail(error);
        }
    }

    fn episodes(&self) -> Result<(), EvaluateError> {
        let mut controller = (self.make)().map_err(EvaluateError::controller(self.policy))?;
        while let Some(&seed) = self.seeds.get(self.next.fetch_add(1, Ordering::Relaxed)) {
            let mut progress = |episode: super::Progress| {
                if self.stop.load(Ordering::Relaxed) {
                    return ControlFlow::Break(());
                }
                (self.progress)(SeedProgress {
                    seed,
                    step: episode.step,
                    steps: episode.steps,
                    finished: self.finished.load(Ordering::Relaxed),
                    episodes: self.seeds.len(),
                })
            };
            let episode = evaluate(self.setting, controller.as_mut(), seed, &mut progress)?;
            self.finished.fetch_add(1, Ordering::Relaxed);
            let mut outcome = self.lock();
            outcome.episodes.push(episode);
            if outcome.controller.is_empty() {
                outcome.controller = controller.name().to_owned();
            }
        }
        Ok(())
    }

    /// Keeps the first error: the others are its consequences.
    fn fail(&self, error: EvaluateError) {
        self.stop.store(true, Ordering::Relaxed);
        self.lock().error.get_or_insert(error);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Outcome> {
        // Nothing can panic while it is held, and what it holds is whole at any time.
        self.outcome.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_must_be_given_each_once() {
        assert!(matches!(check(&[]), Err(EvaluateError::NoSeeds)));
        assert!(matches!(check(&[3, 1, 3]), Err(EvaluateError::RepeatedSeed { seed: 3 })));
        assert!(check(&[3, 1, 2]).is_ok());
    }
}
