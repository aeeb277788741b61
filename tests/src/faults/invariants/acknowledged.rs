//! No fragment is lost after its acknowledgement while the learner lives: what an actor was told is accepted is in the
//! learner's buffer until an update takes it, oldest first, or it is dropped for one of the reasons for which data that was
//! accepted may be dropped. What was declined stays declined. And the buffer is bounded.

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
    /// Accepted in this learner's life and not heard of again.
    buffered: HashMap<Id, Held>,
    /// What the newest update took: should it fail, it is dropped by name.
    taken: (u64, HashSet<Id>),
    /// Every fragment that a learner said it accepted.
    accepted: HashSet<Id>,
    /// Every fragment that a learner did not keep, other than duplicates.
    declined: HashSet<Id>,
    /// Said to be accepted by an actor, not yet by the learner.
    unconfirmed: HashMap<Id, Instant>,
    updated: Option<Instant>,
    counts: (u64, u64, u64),
}

/// A fragment in the buffer.
#[derive(Debug)]
struct Held {
    decisions: u64,
    since: Instant,
    /// How many were accepted before it.
    place: u64,
}

impl Acknowledged {
    pub(super) fn check(&mut self, look: &Look<'_>) -> Result<(), String> {
        for entry in look.entries {
            match entry {
                Entry::Accepted { id, decisions, .. } => {
                    if self.declined.contains(id) {
                        return Err(format!("{id} was declined and is accepted"));
                    }
                    let held = Held { decisions: *decisions, since: look.now, place: self.counts.0 };
                    self.counts.0 += 1;
                    self.accepted.insert(id.clone());
                    self.buffered.insert(id.clone(), held);
                    self.unconfirmed.remove(id);
                }
                Entry::Declined { id, outcome } => self.declined(id, outcome)?,
                Entry::TrainedOn { id, update } => {
                    self.updated = Some(look.now);
                    self.trained_on(id, *update)?;
                }
                Entry::Dropped { id, reason } => self.dropped(id, reason)?,
                Entry::Acknowledged { id, outcome }
                    if outcome == "OUTCOME_ACCEPTED" && !self.accepted.contains(id) =>
                {
                    self.unconfirmed.insert(id.clone(), look.now);
                }
                _ => {}
            }
        }
        if let Some((id, _)) =
            self.unconfirmed.iter().find(|(_, since)| look.now - **since > LATE * look.patience)
        {
            return Err(format!("{id} was acknowledged and the learner never accepted it"));
        }
        let held: u64 = self.buffered.values().map(|held| held.decisions).sum();
        if held > MOST_BUFFERED {
            return Err(format!("{held} decisions are accepted and neither trained on nor dropped"));
        }
        // The oldest goes first, so whatever is passed over for long while updates go on is lost.
        let passed_over =
            |held: &Held| self.updated.is_some_and(|updated| updated > held.since + STANDS_STILL);
        if let Some((id, _)) = self.buffered.iter().find(|(_, held)| passed_over(held)) {
            return Err(format!("{id} was accepted and has been passed over since"));
        }
        Ok(())
    }

    fn declined(&mut self, id: &Id, outcome: &str) -> Result<(), String> {
        match outcome {
            "duplicate" => {}
            // Sent again when its episode, or its learner, was over.
            "old_session" | "unknown_episode" if self.accepted.contains(id) => {}
            _ if self.accepted.contains(id) => {
                return Err(format!("{id} was accepted and is declined as {outcome}"));
            }
            _ => {
                self.declined.insert(id.clone());
            }
        }
        Ok(())
    }

    fn trained_on(&mut self, id: &Id, update: u64) -> Result<(), String> {
        self.counts.1 += 1;
        let Some(held) = self.buffered.remove(id) else {
            return Err(format!("{id} is trained on and was not in the buffer"));
        };
        // The suite has one scenario, and so the learner one buffer.
        if let Some((older, _)) = self.buffered.iter().find(|(_, other)| other.place < held.place) {
            return Err(format!("{id} is trained on before {older}, which was accepted earlier"));
        }
        if self.taken.0 != update {
            self.taken = (update, HashSet::new());
        }
        self.taken.1.insert(id.clone());
        Ok(())
    }

    fn dropped(&mut self, id: &Id, reason: &str) -> Result<(), String> {
        self.counts.2 += 1;
        match reason {
            "stale" | "overflow" => {
                let buffered = self.buffered.remove(id).is_some();
                buffered.then_some(()).ok_or_else(|| format!("{id} is dropped and was not in the buffer"))
            }
            "update_failed" => {
                self.counts.1 = self.counts.1.saturating_sub(1);
                let taken = self.taken.1.remove(id);
                taken
                    .then_some(())
                    .ok_or_else(|| format!("{id} is dropped with an update that had not taken it"))
            }
            // It waited for room, and its actor was never told anything.
            "actor_lost" if !self.accepted.contains(id) => Ok(()),
            // `aborted` is for serial mode.
            _ => Err(format!("{id} is dropped for a reason that has no place here: {reason}")),
        }
    }

    /// What it had in its memory is gone with it, as `docs/architecture.md` says.
    pub(super) fn learner_ended(&mut self) {
        self.buffered.clear();
        self.taken.1.clear();
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

    fn see(invariant: &mut Acknowledged, entry: Entry) -> Result<(), String> {
        invariant.check(&Look { entries: &[entry], ..look() })
    }

    fn dropped(n: u64, reason: &str) -> Entry {
        Entry::Dropped { id: id(n), reason: reason.to_owned() }
    }

    fn declined(n: u64, outcome: &str) -> Entry {
        Entry::Declined { id: id(n), outcome: outcome.to_owned() }
    }

    #[test]
    fn what_was_accepted_is_dropped_for_a_reason_that_it_may_be_dropped_for() {
        for (reason, fine) in [
            ("stale", true),
            ("overflow", true),
            ("actor_lost", false),
            ("aborted", false),
            ("update_failed", false),
            ("", false),
        ] {
            let mut invariant = Acknowledged::default();
            see(&mut invariant, accepted(1)).unwrap();
            assert_eq!(see(&mut invariant, dropped(1, reason)).is_ok(), fine, "{reason}");
        }
        // What waited goes with its actor, and cannot go from a buffer that it never was in.
        assert!(see(&mut Acknowledged::default(), dropped(1, "actor_lost")).is_ok());
        assert!(see(&mut Acknowledged::default(), dropped(1, "stale")).is_err());
    }

    #[test]
    fn only_what_the_newest_update_took_is_lost_with_it() {
        let mut invariant = Acknowledged::default();
        let trained = |n, update| Entry::TrainedOn { id: id(n), update };
        for entry in [accepted(1), accepted(2), trained(1, 7), trained(2, 8), dropped(2, "update_failed")] {
            see(&mut invariant, entry).unwrap();
        }
        assert_eq!(invariant.counts(), (2, 1, 1));
        assert!(see(&mut invariant, dropped(2, "update_failed")).is_err());
        assert!(see(&mut invariant, dropped(1, "update_failed")).is_err());
    }

    #[test]
    fn the_oldest_is_trained_on_first() {
        let mut invariant = Acknowledged::default();
        for n in 1..4 {
            see(&mut invariant, accepted(n)).unwrap();
        }
        see(&mut invariant, dropped(1, "overflow")).unwrap();
        let out_of_turn = see(&mut invariant, Entry::TrainedOn { id: id(3), update: 1 });
        assert!(out_of_turn.unwrap_err().contains("accepted earlier"));
        see(&mut invariant, Entry::TrainedOn { id: id(2), update: 1 }).unwrap();
    }

    #[test]
    fn what_was_accepted_is_not_declined_later_nor_the_other_way_round() {
        let mut invariant = Acknowledged::default();
        for entry in [accepted(1), declined(1, "duplicate"), declined(1, "old_session"), declined(2, "stale")]
        {
            see(&mut invariant, entry).unwrap();
        }
        assert!(see(&mut invariant, declined(1, "stale")).unwrap_err().contains("declined as stale"));
        assert!(see(&mut invariant, accepted(2)).unwrap_err().contains("was declined"));
    }
}
