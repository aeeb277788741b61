//! No process panics.

use super::Look;
use crate::faults::journal::Entry;

pub(super) const NAME: &str = "no panic";

pub(super) fn check(look: &Look<'_>) -> Result<(), String> {
    match look.entries.iter().find_map(|entry| match entry {
        Entry::Panicked { line } => Some(line),
        _ => None,
    }) {
        Some(line) => Err(line.clone()),
        None => Ok(()),
    }
}
