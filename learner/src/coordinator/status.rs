//! The state of training as `Training.GetStatus` tells it.

use crate::admission::{Admission, Dropped, Outcome};
use cross_proto::v1::{ScenarioStatus, TrainingStatus, training_status::Phase};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// What the last update and checkpoint gave.
#[derive(Debug, Default)]
pub(super) struct Last {
    pub(super) losses: BTreeMap<String, f64>,
    pub(super) diagnostics: BTreeMap<String, f64>,
    pub(super) seconds: f64,
    pub(super) checkpoint: String,
}

/// Agent-decisions a second over the last [`Rate::WINDOW`] seconds.
#[derive(Debug, Default)]
pub(super) struct Rate(VecDeque<(u64, u64)>);

impl Rate {
    const WINDOW: u64 = 10;

    pub(super) fn add(&mut self, now: Duration, decisions: u64) {
        match self.0.back_mut() {
            Some((second, sum)) if *second == now.as_secs() => *sum += decisions,
            _ => self.0.push_back((now.as_secs(), decisions)),
        }
        self.forget(now);
    }

    pub(super) fn per_second(&mut self, now: Duration) -> f64 {
        self.forget(now);
        let sum: u64 = self.0.iter().map(|(_, decisions)| decisions).sum();
        let span = now.as_secs_f64().clamp(1.0, Self::WINDOW as f64);
        sum as f64 / span
    }

    fn forget(&mut self, now: Duration) {
        let oldest = now.as_secs().saturating_sub(Self::WINDOW - 1);
        while self.0.front().is_some_and(|(second, _)| *second < oldest) {
            self.0.pop_front();
        }
    }
}

pub(super) fn status(
    admission: &Admission,
    run_id: &str,
    phase: Phase,
    last: &Last,
    decisions_per_second: f64,
    uptime: Duration,
) -> TrainingStatus {
    let progress = admission.progress();
    let scenarios = admission.settings().scenarios.iter().enumerate().map(|(i, scenario)| {
        let own = progress.scenarios.get(&scenario.name).copied().unwrap_or_default();
        ScenarioStatus {
            name: scenario.name.clone(),
            episodes: own.episodes,
            decisions: own.decisions,
            buffered_steps: admission.buffered_steps(i),
            episode_return: own.episode_return,
            queue_length: own.queue_length,
            dropped: dropped(admission, i),
        }
    });
    TrainingStatus {
        run_id: run_id.to_owned(),
        phase: phase.into(),
        // A round counts once it has been trained on.
        updates: progress.updates - u64::from(admission.is_updating()),
        updates_wanted: admission.settings().updates,
        policy_version: admission.policy_version(),
        decisions: progress.decisions,
        episodes: progress.episodes,
        actors: u32::try_from(admission.actors()).unwrap_or(u32::MAX),
        decisions_per_second,
        scenarios: scenarios.collect(),
        losses: last.losses.clone().into_iter().collect(),
        diagnostics: last.diagnostics.clone().into_iter().collect(),
        update_seconds: last.seconds,
        latest_checkpoint: last.checkpoint.clone(),
        uptime_seconds: uptime.as_secs_f64(),
    }
}

/// Fragments that were not trained on, by reason, without the zeros.
fn dropped<M: FromIterator<(String, u64)>>(admission: &Admission, scenario: usize) -> M {
    let refused = Outcome::ALL
        .into_iter()
        .filter(|outcome| *outcome != Outcome::Accepted)
        .map(|outcome| (outcome.label().to_owned(), admission.offered(scenario, outcome)));
    let later = Dropped::ALL
        .into_iter()
        .map(|reason| (format!("buffered_{}", reason.label()), admission.dropped(scenario, reason)));
    refused.chain(later).filter(|(_, count)| *count > 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_forgets_what_is_older_than_its_window() {
        let mut rate = Rate::default();
        for second in 0..20 {
            rate.add(Duration::from_secs(second), 100);
        }
        assert_eq!(rate.per_second(Duration::from_secs(19)), 100.0);
        assert_eq!(rate.per_second(Duration::from_secs(24)), 50.0);
        assert_eq!(rate.per_second(Duration::from_secs(60)), 0.0);
    }
}
