//! No fragment is lost after its acknowledgement while the learner lives: what an actor was told is accepted is in the
//! learner's buffer until an update takes it or it is dropped by name. And the buffer is bounded.

use super::Look;
use crate::faults::journal::{Entry, Id};
use std::collections::{HashMap, HashSet};
use std::time::{Duration, Instant};

pub(super) const NAME: &str = "none lost after acknowledgement";

/// What a learner's buffer may ever hold in this suite's configuration, agent-decisions: see `Admission::hard_limit`.
const MOST_BUFFERED: u64 = 16 * 400;
/// An actor's log may be read before the learner's.
const LATE: Duration = Duration::from_secs(5);
/// Fragments wait for longer only while updates stand still.
const STANDS_STILL: Duration = Duration::from_secs(60);

#[derive(Debug, Default)]
pub(super) struct Acknowledged {
    /// Accepted in this learner's life and not heard of again, with their decisions, and since when.
    buffered: HashMap<Id, (u64, Instant)>,
    /// Every fragment that a learner said it accepted.
    accepted: HashSet<Id>,
    /// Said to be accepted by an actor, not yet by the learner.
    unconfirmed: HashMap<Id, Instant>,
    updated: Option<Instant>,
    counts: (u64, u64, u64),
}

impl Acknowledged {
    pub(super) fn check(&mut self, look: &Look<'_>) -> Result<(), String> {
        for entry in look.entries {
            match entry {
                Entry::Accepted { id, decisions, .. } => {
                    self.counts.0 += 1;
                    self.accepted.insert(id.clone());
                    self.buffered.insert(id.clone(), (*decisions, look.now));
                    self.unconfirmed.remove(id);
                }
                Entry::TrainedOn { id, .. } => {
                    self.counts.1 += 1;
                    self.updated = Some(look.now);
                    if self.buffered.remove(id).is_none() {
                        return Err(format!("{id} is trained on and was not in the buffer"));
                    }
                }
                Entry::Dropped { id, .. } => {
                    self.counts.2 += 1;
                    self.buffered.remove(id);
                }
                Entry::Acknowledged { id, outcome }
                    if outcome == "OUTCOME_ACCEPTED" && !self.accepted.contains(id) =>
                {
                    self.unconfirmed.insert(id.clone(), look.now);
                }
                _ => {}
            }
        }
        if let Some((id, _)) = self.unconfirmed.iter().find(|(_, since)| look.now - **since > LATE) {
            return Err(format!("{id} was acknowledged and the learner never accepted it"));
        }
        let held: u64 = self.buffered.values().map(|(decisions, _)| decisions).sum();
        if held > MOST_BUFFERED {
            return Err(format!("{held} decisions are accepted and neither trained on nor dropped"));
        }
        // The oldest goes first, so whatever is passed over for long while updates go on is lost.
        let passed_over =
            |since: &Instant| self.updated.is_some_and(|updated| updated > *since + STANDS_STILL);
        if let Some((id, _)) = self.buffered.iter().find(|(_, (_, since))| passed_over(since)) {
            return Err(format!("{id} was accepted and has been passed over since"));
        }
        Ok(())
    }

    /// What it had in its memory is gone with it, as `docs/architecture.md` says.
    pub(super) fn learner_ended(&mut self) {
        self.buffered.clear();
    }

    pub(super) fn counts(&self) -> (u64, u64, u64) {
        self.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::invariants::tests::{accepted, id, look};

    fn told(n: u64) -> Entry {
        Entry::Acknowledged { id: id(n), outcome: "OUTCOME_ACCEPTED".to_owned() }
    }

    #[test]
    fn a_fragment_that_only_the_actor_knows_of_is_lost() {
        let mut invariant = Acknowledged::default();
        assert!(invariant.check(&Look { entries: &[told(1)], ..look() }).is_ok());
        let later = Instant::now() + 2 * LATE;
        assert!(invariant.check(&Look { now: later, ..look() }).unwrap_err().contains("never accepted"));
        // The learner's log was only read later.
        let mut invariant = Acknowledged::default();
        assert!(invariant.check(&Look { entries: &[told(1), accepted(1)], ..look() }).is_ok());
        assert!(invariant.check(&Look { now: later, ..look() }).is_ok());
    }

    #[test]
    fn a_fragment_that_is_passed_over_is_lost() {
        let mut invariant = Acknowledged::default();
        let later = Instant::now() + 2 * STANDS_STILL;
        assert!(invariant.check(&Look { entries: &[accepted(1)], ..look() }).is_ok());
        let entries = [accepted(2), Entry::TrainedOn { id: id(2), update: 1 }];
        assert!(invariant.check(&Look { entries: &entries, now: later, ..look() }).is_err());
        // With its learner it may be lost.
        invariant.learner_ended();
        assert!(invariant.check(&Look { now: later, ..look() }).is_ok());
    }
}
