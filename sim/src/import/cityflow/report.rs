//! What became of what was read.

use serde::Serialize;

/// One kind of thing: how many were read and what became of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Item {
    /// What is counted.
    pub what: &'static str,
    /// How many the files have.
    pub read: u64,
    /// How many the scenario has.
    pub kept: u64,
    /// How many of these are not as they were.
    pub changed: u64,
    /// How many it does not have.
    pub lost: u64,
    /// How they changed, and why they were lost.
    pub notes: Vec<String>,
}

impl Item {
    pub(super) fn new(what: &'static str) -> Self {
        Self { what, read: 0, kept: 0, changed: 0, lost: 0, notes: Vec::new() }
    }

    /// Counts some as kept and others as lost for this reason.
    pub(super) fn keep(&mut self, kept: u64, lost: u64, reason: &str) {
        self.kept += kept;
        self.lost += lost;
        if lost > 0 {
            self.note(&format!("lost: those {reason}"));
        }
    }

    /// Counts some of those that were kept as changed.
    pub(super) fn change(&mut self, changed: u64, how: &str) {
        self.changed += changed;
        if changed > 0 {
            self.note(&format!("changed {how}"));
        }
    }

    pub(super) fn note(&mut self, note: &str) {
        if !self.notes.iter().any(|known| known == note) {
            self.notes.push(note.to_owned());
        }
    }
}
