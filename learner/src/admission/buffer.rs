//! The data of one scenario that waits for an update.
//!
//! ```text
//!   offer ──> waiting (not acknowledged) ──> inserted (acknowledged) ──> round
//!             bounded by each actor's          bounded by the            oldest
//!             unacknowledged fragments         buffer limit              first
//! ```

use super::journal;
use super::types::{Dropped, Lag, Outcome};
use cross_proto::fragment::Checked;
use cross_sim::trajectory::FragmentId;
use std::collections::{BTreeMap, VecDeque};

/// Waiting and inserted fragments of a scenario, and its counters.
#[derive(Debug, Default)]
pub(super) struct ScenarioBuffer {
    inserted: VecDeque<Checked>,
    inserted_steps: u64,
    /// Received, but not inserted while the buffer is full: their acknowledgements are what holds actors back.
    waiting: VecDeque<Checked>,
    /// Fragments offered, by what became of them.
    pub(super) outcomes: BTreeMap<Outcome, u64>,
    /// Fragments dropped after they were received.
    pub(super) dropped: BTreeMap<Dropped, u64>,
}

/// What a round took of a scenario, to be named and taken back should its update fail.
#[derive(Debug)]
pub(super) struct Taken {
    pub(super) fragments: Vec<FragmentId>,
    /// Agent-decisions.
    pub(super) decisions: u64,
}

impl ScenarioBuffer {
    /// Steps that an update may take.
    pub(super) fn steps(&self) -> u64 {
        self.inserted_steps
    }

    #[cfg(test)]
    pub(super) fn fragments(&self) -> usize {
        self.inserted.len()
    }

    /// Steps received in all, waiting ones too.
    pub(super) fn received_steps(&self) -> u64 {
        self.inserted_steps + self.waiting.iter().map(|f| u64::from(f.steps)).sum::<u64>()
    }

    /// Whether a fragment may be inserted now. It may overshoot the limit by less than its own length: a limit that a
    /// whole fragment must fit under could leave a round for ever short of its last few steps.
    pub(super) fn has_room(&self, limit: u64) -> bool {
        self.inserted_steps < limit
    }

    /// Whether something waits: then later arrivals must queue behind it.
    #[cfg(test)]
    pub(super) fn has_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    pub(super) fn insert(&mut self, fragment: Checked) {
        journal::accepted(&fragment);
        self.inserted_steps += u64::from(fragment.steps);
        self.inserted.push_back(fragment);
    }

    pub(super) fn wait(&mut self, fragment: Checked) {
        self.waiting.push_back(fragment);
    }

    /// Takes the first waiting fragment that satisfies the condition.
    pub(super) fn next_waiting(&mut self, wanted: impl Fn(&Checked) -> bool) -> Option<Checked> {
        let at = self.waiting.iter().position(wanted)?;
        self.waiting.remove(at)
    }

    /// Forgets what a lost actor sent and was never told to be safe.
    pub(super) fn forget_waiting(&mut self, lost: impl Fn(&FragmentId) -> bool) {
        let before = self.waiting.len();
        self.waiting.retain(|f| {
            let kept = !lost(&f.id);
            if !kept {
                journal::dropped(&f.id, Dropped::ActorLost);
            }
            kept
        });
        let gone = (before - self.waiting.len()) as u64;
        if gone > 0 {
            *self.dropped.entry(Dropped::ActorLost).or_default() += gone;
        }
    }

    /// Counts an offered fragment.
    pub(super) fn count(&mut self, outcome: Outcome) {
        *self.outcomes.entry(outcome).or_default() += 1;
    }

    /// Drops the oldest until at most `limit` steps are left.
    pub(super) fn drop_overflow(&mut self, limit: u64) {
        while self.inserted_steps > limit && self.inserted.len() > 1 {
            if let Some(oldest) = self.inserted.pop_front() {
                journal::dropped(&oldest.id, Dropped::Overflow);
                self.inserted_steps -= u64::from(oldest.steps);
                *self.dropped.entry(Dropped::Overflow).or_default() += 1;
            }
        }
    }

    /// Drops an episode's inserted fragments.
    pub(super) fn drop_episode(&mut self, episode: u64) {
        self.drop_inserted(Dropped::Aborted, |f| f.id.episode == episode);
    }

    /// Drops inserted data of a version below `oldest`, and returns the waiting fragments that are too old as well: their
    /// senders are still to be told.
    pub(super) fn drop_stale(&mut self, oldest: u64) -> Vec<Checked> {
        self.drop_inserted(Dropped::Stale, |f| f.policy_version < oldest);
        let (stale, fresh): (VecDeque<_>, VecDeque<_>) =
            std::mem::take(&mut self.waiting).into_iter().partition(|f| f.policy_version < oldest);
        self.waiting = fresh;
        stale.into()
    }

    fn drop_inserted(&mut self, reason: Dropped, condition: impl Fn(&Checked) -> bool) {
        let before = self.inserted.len();
        self.inserted.retain(|f| {
            let kept = !condition(f);
            if !kept {
                journal::dropped(&f.id, reason);
            }
            kept
        });
        let gone = (before - self.inserted.len()) as u64;
        if gone > 0 {
            self.inserted_steps = self.inserted.iter().map(|f| u64::from(f.steps)).sum();
            *self.dropped.entry(reason).or_default() += gone;
        }
    }

    /// Moves the oldest fragments into the round until it holds `wanted` steps of this scenario; returns the steps moved.
    pub(super) fn take(&mut self, wanted: u64, round: &mut Vec<Checked>) -> u64 {
        let mut taken = 0;
        while taken < wanted
            && let Some(fragment) = self.inserted.pop_front()
        {
            taken += u64::from(fragment.steps);
            self.inserted_steps -= u64::from(fragment.steps);
            round.push(fragment);
        }
        taken
    }
}

/// Lag of a round's fragments behind a version.
pub(super) fn lag(fragments: &[Checked], policy_version: u64) -> Lag {
    let lags = || fragments.iter().map(|f| policy_version.saturating_sub(f.policy_version));
    let steps: u64 = fragments.iter().map(|f| u64::from(f.steps)).sum();
    let weighted: f64 = lags().zip(fragments).map(|(lag, f)| lag as f64 * f64::from(f.steps)).sum();
    Lag {
        min: lags().min().unwrap_or(0),
        mean: if steps == 0 { 0.0 } else { weighted / steps as f64 },
        max: lags().max().unwrap_or(0),
    }
}
