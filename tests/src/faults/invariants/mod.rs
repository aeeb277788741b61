//! What has to hold at every moment, whatever is broken: one file each, each a small function over what was observed.

mod acknowledged;
mod checkpoints;
mod memory;
mod orphans;
mod panics;
mod trained_once;
mod versions;

pub use memory::Peak;

use super::Broken;
use super::journal::Entry;
use super::observe::Seen;
use cross_proto::v1::TrainingStatus;
use std::path::Path;
use std::time::Instant;

/// One look at the cluster.
#[derive(Debug)]
pub struct Look<'a> {
    /// When.
    pub now: Instant,
    /// The learner's status, if it was asked and answered.
    pub status: Option<&'a TrainingStatus>,
    /// What was written down since the last look, in the order of each process.
    pub entries: &'a [Entry],
    /// The process table, if it was looked at.
    pub processes: Option<&'a [Seen]>,
    /// Process ids of the actors that are supervised or known to be there.
    pub actors: &'a [i32],
    /// The learner's process.
    pub learner: Option<i32>,
    /// The run directory, if its checkpoints are to be looked at.
    pub run: Option<&'a Path>,
    /// How many times longer than usual things may take.
    pub patience: u32,
}

/// All invariants with what each has to remember.
#[derive(Debug, Default)]
pub struct Invariants {
    versions: versions::Versions,
    trained_once: trained_once::TrainedOnce,
    acknowledged: acknowledged::Acknowledged,
    checkpoints: checkpoints::Checkpoints,
    memory: memory::Memory,
    orphans: orphans::Orphans,
}

impl Invariants {
    /// Names, for the report.
    pub const NAMES: [&'static str; 7] = [
        versions::NAME,
        trained_once::NAME,
        acknowledged::NAME,
        checkpoints::NAME,
        memory::NAME,
        orphans::NAME,
        panics::NAME,
    ];

    /// Checks all of them.
    ///
    /// # Errors
    /// The first that does not hold.
    pub fn check(&mut self, look: &Look<'_>) -> Result<(), Broken> {
        let broken = |name| move |seen| Broken { invariant: name, seen };
        panics::check(look).map_err(broken(panics::NAME))?;
        self.versions.check(look).map_err(broken(versions::NAME))?;
        self.trained_once.check(look).map_err(broken(trained_once::NAME))?;
        self.acknowledged.check(look).map_err(broken(acknowledged::NAME))?;
        self.checkpoints.check(look).map_err(broken(checkpoints::NAME))?;
        self.memory.check(look).map_err(broken(memory::NAME))?;
        self.orphans.check(look).map_err(broken(orphans::NAME))
    }

    /// The learner's process has ended: what only it knew is gone, and another may begin where its checkpoints say.
    pub fn learner_ended(&mut self) {
        self.versions.learner_ended(self.checkpoints.newest());
        self.acknowledged.learner_ended();
    }

    /// The suite itself has damaged this checkpoint.
    pub fn damaged(&mut self, checkpoint: &Path) {
        self.checkpoints.damaged(checkpoint);
        self.versions.learner_ended(self.checkpoints.newest());
    }

    /// Looks at the checkpoints now, whenever they were looked at last.
    ///
    /// # Errors
    /// If one cannot be loaded.
    pub fn look_at_checkpoints(&mut self, run: &Path) -> Result<(), Broken> {
        self.checkpoints.look(run).map_err(|seen| Broken { invariant: checkpoints::NAME, seen })
    }

    /// Largest sizes seen.
    #[must_use]
    pub fn peaks(&self) -> Vec<(String, Peak)> {
        self.memory.peaks()
    }

    /// Fragments accepted, trained on and dropped so far.
    #[must_use]
    pub fn fragments(&self) -> (u64, u64, u64) {
        self.acknowledged.counts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::journal::Id;
    use crate::processes::Found;

    /// A look at nothing.
    pub(super) fn look() -> Look<'static> {
        Look {
            now: Instant::now(),
            status: None,
            entries: &[],
            processes: None,
            actors: &[],
            learner: None,
            run: None,
            patience: 1,
        }
    }

    pub(super) fn id(sequence: u64) -> Id {
        Id { actor: "a".to_owned(), session: 1, episode: 2, sequence }
    }

    pub(super) fn accepted(sequence: u64) -> Entry {
        Entry::Accepted { id: id(sequence), decisions: 160, policy_version: 1 }
    }

    pub(super) fn process(program: &str, pid: i32, parent: i32) -> Seen {
        let found = Found { pid, arguments: vec![program.to_owned()] };
        Seen { found, parent, resident: 1024, files: 3, threads: 1 }
    }
}
