//! Memory is bounded, and so are threads and open files: no process ever has more than what a small cluster needs.

use super::Look;
use std::collections::BTreeMap;

pub(super) const NAME: &str = "memory bounded";

/// Most resident memory by program, MiB: about twice what each has in an undisturbed run of the suite's configuration.
const MOST: [(&str, u64); 3] = [("cross-learner", 400), ("cross-actor", 350), ("sumo", 200)];
/// Descriptors and threads of any process.
const MOST_FILES: usize = 200;
const MOST_THREADS: u64 = 64;

/// The largest that was seen of a program.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Peak {
    /// Resident memory, MiB.
    pub resident: u64,
    /// Open files.
    pub files: usize,
    /// Threads.
    pub threads: u64,
}

#[derive(Debug, Default)]
pub(super) struct Memory {
    peaks: BTreeMap<String, Peak>,
}

impl Memory {
    pub(super) fn check(&mut self, look: &Look<'_>) -> Result<(), String> {
        for process in look.processes.into_iter().flatten() {
            let program = process.found.program();
            let Some((_, most)) = MOST.iter().find(|(name, _)| *name == program) else { continue };
            let peak = self.peaks.entry(program.to_owned()).or_default();
            peak.resident = peak.resident.max(process.resident / 1024);
            peak.files = peak.files.max(process.files);
            peak.threads = peak.threads.max(process.threads);
            if peak.resident > *most || peak.files > MOST_FILES || peak.threads > MOST_THREADS {
                return Err(format!("{program} {} has grown to {peak:?}", process.found.pid));
            }
        }
        Ok(())
    }

    pub(super) fn peaks(&self) -> Vec<(String, Peak)> {
        self.peaks.iter().map(|(name, peak)| (name.clone(), *peak)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::invariants::tests::{look, process};

    #[test]
    fn a_process_that_grows_is_seen() {
        let mut memory = Memory::default();
        let mut learner = process("cross-learner", 10, 1);
        learner.resident = 100 * 1024;
        assert!(memory.check(&Look { processes: Some(std::slice::from_ref(&learner)), ..look() }).is_ok());
        learner.resident = 5000 * 1024;
        assert!(memory.check(&Look { processes: Some(&[learner]), ..look() }).is_err());
    }
}
