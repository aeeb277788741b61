//! Nothing is left behind: every SUMO has a living actor for its parent, no actor has two, and there is one learner. A
//! process that was just killed, or just started to take the place of one, may take a moment.

use super::Look;
use crate::faults::observe::Seen;
use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

pub(super) const NAME: &str = "no orphan";

/// As `processes::assert_none_left` has it for the end of a run.
const GONE_WITHIN: Duration = Duration::from_secs(5);

#[derive(Debug, Default)]
pub(super) struct Orphans {
    /// Processes that should not be there, since when.
    since: BTreeMap<i32, Instant>,
}

impl Orphans {
    pub(super) fn check(&mut self, look: &Look<'_>) -> Result<(), String> {
        let Some(processes) = look.processes else { return Ok(()) };
        let strays: BTreeMap<i32, String> = processes
            .iter()
            .filter_map(|process| Some((process.found.pid, stray(process, processes, look)?)))
            .collect();
        let pids: BTreeSet<i32> = strays.keys().copied().collect();
        self.since.retain(|pid, _| pids.contains(pid));
        for (pid, why) in strays {
            let since = self.since.entry(pid).or_insert(look.now);
            if look.now - *since > GONE_WITHIN * look.patience {
                return Err(format!("process {pid} {why}"));
            }
        }
        Ok(())
    }
}

/// Why a process should not be there.
fn stray(process: &Seen, processes: &[Seen], look: &Look<'_>) -> Option<String> {
    let pid = process.found.pid;
    match process.found.program() {
        "sumo" => {
            let parent = process.parent;
            if !look.actors.contains(&parent) {
                return Some(format!("is a sumo whose parent {parent} is no actor"));
            }
            let older = processes.iter().any(|other| {
                other.found.program() == "sumo" && other.parent == parent && other.found.pid < pid
            });
            older.then(|| format!("is a second sumo of actor {parent}"))
        }
        "cross-learner" => (look.learner != Some(pid)).then(|| "is a second learner".to_owned()),
        "cross-actor" => {
            (!look.actors.contains(&pid)).then(|| "is an actor that nobody supervises".to_owned())
        }
        // On its way to becoming one of these.
        "nsenter" | "setpriv" => None,
        other => Some(format!("is a {other}, which is no part of a cluster")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::invariants::tests::{look, process};

    #[test]
    fn what_has_no_place_may_stay_for_a_moment_only() {
        let now = Instant::now();
        let all = [
            process("cross-learner", 10, 1),
            process("cross-actor", 11, 1),
            process("sumo", 12, 11),
            process("sumo", 13, 14),
        ];
        let see = |orphans: &mut Orphans, processes: &[Seen], now| {
            orphans.check(&Look {
                processes: Some(processes),
                learner: Some(10),
                actors: &[11],
                now,
                ..look()
            })
        };
        let mut orphans = Orphans::default();
        assert!(see(&mut orphans, &all[..3], now).is_ok());
        assert!(see(&mut orphans, &all[..3], now + 2 * GONE_WITHIN).is_ok());
        assert!(see(&mut orphans, &all, now).is_ok());
        assert!(see(&mut orphans, &all, now + 2 * GONE_WITHIN).unwrap_err().contains("parent 14"));
        // Gone in between, it may be another process of the same number.
        assert!(see(&mut orphans, &all[..3], now + 3 * GONE_WITHIN).is_ok());
        assert!(see(&mut orphans, &all, now + 4 * GONE_WITHIN).is_ok());
    }

    #[test]
    fn a_second_learner_or_sumo_has_no_place() {
        let (learner, sumo) = (process("cross-learner", 20, 1), process("sumo", 22, 11));
        let all = [process("sumo", 21, 11), sumo.clone()];
        let seen = Look { learner: Some(10), actors: &[11], ..look() };
        assert!(stray(&learner, &all, &seen).is_some());
        assert!(stray(&sumo, &all, &seen).unwrap().contains("second"));
        assert!(stray(&all[0], &all, &seen).is_none());
    }
}
