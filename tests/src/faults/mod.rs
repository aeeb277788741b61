//! The fault suite: a whole cluster of real processes in network namespaces of its own, faults at random moments, and
//! invariants that are checked all the while.
//!
//! ```text
//!   plan (seed) ──> campaign ──> inject ──> world: learner, actors, SUMOs, links, disk, clocks
//!                      │                      │ journals, status, /proc, checkpoints
//!                      │                      v
//!                      ├──── recovery <─── observe ───> invariants
//!                      v
//!                   report
//! ```
//! `docs/faults.md` says what is injected, what has to hold, and what was measured.

pub mod campaign;
mod clock;
mod disk;
pub mod inject;
pub mod invariants;
pub mod journal;
mod launch;
mod net;
pub mod observe;
pub mod plan;
mod recovery;
mod relay;
pub mod report;
pub mod soak;
mod stranger;
mod supervisor;
pub mod tools;
pub mod world;

/// An invariant that did not hold, or a fault that could not be injected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broken {
    /// Which invariant.
    pub invariant: &'static str,
    /// What was seen instead.
    pub seen: String,
}

impl Broken {
    pub(crate) fn new(invariant: &'static str, seen: impl Into<String>) -> Self {
        Self { invariant, seen: seen.into() }
    }
}

impl std::fmt::Display for Broken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.invariant, self.seen)
    }
}
