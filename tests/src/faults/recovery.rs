//! When is throughput back? What the learner accepts is counted over windows of two seconds; it is back at the end of the
//! first whole window after the fault that holds at least half of what is usual, once every actor that the fault hit has
//! had a fragment accepted again.

use super::journal::Entry;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

const WINDOW: Duration = Duration::from_secs(2);
/// Longer than any fault and its recovery together.
const KEPT: Duration = Duration::from_secs(150);
/// Undisturbed windows that say what is usual; the machine's other work changes it over minutes.
const USUAL: usize = 30;

/// The moment from which a fault is over, and whom it hit.
#[derive(Debug, Clone)]
pub struct Over {
    /// When.
    pub since: Instant,
    /// Actors that have to deliver again.
    pub actors: Vec<String>,
    /// Whether they lost their episodes, so that only the beginning of another one counts.
    pub anew: bool,
    /// The newest checkpoint, if a newer one has to follow.
    pub checkpoint: Option<String>,
}

#[derive(Debug)]
struct Accepted {
    at: Instant,
    decisions: u64,
    actor: String,
    first: bool,
}

/// What was accepted lately.
#[derive(Debug, Default)]
pub(super) struct Flow {
    accepted: VecDeque<Accepted>,
    /// Decisions in undisturbed windows.
    usual: VecDeque<u64>,
    window_began: Option<Instant>,
}

impl Flow {
    pub(super) fn add(&mut self, now: Instant, entries: &[Entry]) {
        for entry in entries {
            if let Entry::Accepted { id, decisions, .. } = entry {
                let (actor, first) = (id.actor.clone(), id.sequence == 0);
                self.accepted.push_back(Accepted { at: now, decisions: *decisions, actor, first });
            }
        }
        while self.accepted.front().is_some_and(|oldest| now - oldest.at > KEPT) {
            self.accepted.pop_front();
        }
    }

    /// Nothing is broken now: whole windows of such times are what is usual.
    pub(super) fn undisturbed(&mut self, now: Instant) {
        let began = *self.window_began.get_or_insert(now);
        if now - began >= WINDOW {
            self.usual.push_back(self.since(began));
            self.window_began = Some(now);
            if self.usual.len() > USUAL {
                self.usual.pop_front();
            }
        }
    }

    /// Something is.
    pub(super) fn disturbed(&mut self) {
        self.window_began = None;
    }

    fn since(&self, began: Instant) -> u64 {
        self.accepted.iter().rev().take_while(|one| one.at > began).map(|one| one.decisions).sum()
    }

    /// Usual decisions of a window: the median.
    pub(super) fn usual(&self) -> u64 {
        let mut sorted: Vec<u64> = self.usual.iter().copied().collect();
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).copied().unwrap_or(0)
    }

    /// How long it took, if throughput is back now.
    pub(super) fn back(&self, over: &Over, now: Instant) -> Option<Duration> {
        let took = now.checked_duration_since(over.since)?;
        let delivered = |actor: &String| {
            let mut after = self.accepted.iter().rev().take_while(|one| one.at > over.since);
            after.any(|one| one.actor == *actor && (one.first || !over.anew))
        };
        let whole = took >= WINDOW && 2 * self.since(now - WINDOW) >= self.usual();
        (whole && over.actors.iter().all(delivered)).then_some(took)
    }

    /// What is missing, for a person.
    pub(super) fn missing(&self, over: &Over, now: Instant) -> String {
        let silent: Vec<&String> = over
            .actors
            .iter()
            .filter(|actor| {
                let mut after = self.accepted.iter().rev().take_while(|one| one.at > over.since);
                !after.any(|one| one.actor == **actor && (one.first || !over.anew))
            })
            .collect();
        format!(
            "{} decisions in the last window, {} are usual; nothing new of {silent:?}",
            self.since(now - WINDOW),
            self.usual()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::journal::Id;

    fn accepted(actor: &str, sequence: u64, decisions: u64) -> Entry {
        let id = Id { actor: actor.to_owned(), session: 1, episode: 1, sequence };
        Entry::Accepted { id, decisions, policy_version: 1 }
    }

    #[test]
    fn throughput_is_back_with_half_of_the_usual_and_every_actor_hit() {
        let start = Instant::now() + KEPT;
        let at = |tenths: u64| start + Duration::from_millis(100 * tenths);
        let mut flow = Flow::default();
        for tenth in 0..=200 {
            flow.add(at(tenth), &[accepted("a", 1, 10)]);
            flow.undisturbed(at(tenth));
        }
        assert_eq!(flow.usual(), 200);
        flow.disturbed();
        let over = Over { since: at(250), actors: vec!["b".to_owned()], anew: true, checkpoint: None };
        for tenth in 251..=300 {
            flow.add(at(tenth), &[accepted("a", 1, 4)]);
        }
        assert_eq!(flow.back(&over, at(300)), None, "too little, and nothing of b");
        for tenth in 301..=330 {
            flow.add(at(tenth), &[accepted("a", 1, 10), accepted("b", 1, 1)]);
        }
        assert_eq!(flow.back(&over, at(330)), None, "only the rest of an old episode of b");
        flow.add(at(331), &[accepted("b", 0, 1)]);
        assert_eq!(flow.back(&over, at(331)), Some(Duration::from_millis(8100)));
    }
}
