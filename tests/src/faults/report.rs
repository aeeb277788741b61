//! What a campaign has shown.

use super::inject::Kind;
use super::invariants::{Invariants, Peak};
use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

/// A fault that was survived.
#[derive(Debug, Clone)]
pub struct Struck {
    /// What it was.
    pub kind: Kind,
    /// From its beginning to its end.
    pub lasted: Duration,
    /// From its end until throughput was back.
    pub recovery: Duration,
}

/// The figures.
#[derive(Debug, Clone)]
pub struct Report {
    /// Seed of the plan.
    pub seed: u64,
    /// Actors.
    pub actors: usize,
    /// Every fault, in order.
    pub struck: Vec<Struck>,
    /// Duration of the run, seconds.
    pub seconds: f64,
    /// The target that was reached.
    pub updates: u64,
    /// Fragments accepted, trained on, dropped.
    pub fragments: (u64, u64, u64),
    /// Largest sizes by program.
    pub peaks: Vec<(String, Peak)>,
}

impl Report {
    pub(super) fn new(seed: u64, actors: usize) -> Self {
        Self {
            seed,
            actors,
            struck: Vec::new(),
            seconds: 0.0,
            updates: 0,
            fragments: (0, 0, 0),
            peaks: Vec::new(),
        }
    }

    /// The longest recovery.
    #[must_use]
    pub fn longest(&self) -> Duration {
        self.struck.iter().map(|struck| struck.recovery).max().unwrap_or_default()
    }
}

fn median(sorted: &[Duration]) -> Duration {
    sorted.get(sorted.len() / 2).copied().unwrap_or_default()
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut kinds: BTreeMap<Kind, Vec<Duration>> = BTreeMap::new();
        for struck in &self.struck {
            kinds.entry(struck.kind).or_default().push(struck.recovery);
        }
        writeln!(f, "| fault | times | back after, median | longest |")?;
        writeln!(f, "|---|---|---|---|")?;
        for (kind, recoveries) in &mut kinds {
            recoveries.sort_unstable();
            writeln!(
                f,
                "| {} | {} | {:.1} s | {:.1} s |",
                kind.what(),
                recoveries.len(),
                median(recoveries).as_secs_f64(),
                recoveries.last().copied().unwrap_or_default().as_secs_f64()
            )?;
        }
        let mut all: Vec<Duration> = self.struck.iter().map(|struck| struck.recovery).collect();
        all.sort_unstable();
        writeln!(
            f,
            "\n{} faults in a row, seed {}, {} actors, {:.0} s; {} updates; throughput back after {:.1} s in the median \
             and {:.1} s at most",
            self.struck.len(),
            self.seed,
            self.actors,
            self.seconds,
            self.updates,
            median(&all).as_secs_f64(),
            self.longest().as_secs_f64()
        )?;
        let (accepted, trained, dropped) = self.fragments;
        writeln!(
            f,
            "fragments: {accepted} accepted, {trained} trained on, {dropped} dropped by name, the rest went with a learner"
        )?;
        for (program, Peak { resident, files, threads }) in &self.peaks {
            writeln!(f, "{program}: at most {resident} MiB, {files} open files, {threads} threads")?;
        }
        write!(f, "invariants that held throughout: {}", Invariants::NAMES.join(", "))
    }
}
