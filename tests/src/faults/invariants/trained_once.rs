//! No fragment is trained on twice, within a session or over any number of them, and none that was not accepted.

use super::Look;
use crate::faults::journal::{Entry, Id};
use std::collections::HashMap;

pub(super) const NAME: &str = "no fragment trained on twice";

#[derive(Debug, Default)]
pub(super) struct TrainedOnce {
    /// The update that took each accepted fragment; none while it waits.
    fate: HashMap<Id, Option<u64>>,
}

impl TrainedOnce {
    pub(super) fn check(&mut self, look: &Look<'_>) -> Result<(), String> {
        for entry in look.entries {
            match entry {
                Entry::Accepted { id, .. } => {
                    let known = self.fate.insert(id.clone(), None).is_some();
                    if known {
                        return Err(format!("{id} was accepted a second time"));
                    }
                }
                Entry::TrainedOn { id, update } => match self.fate.get_mut(id) {
                    Some(fate @ None) => *fate = Some(*update),
                    Some(Some(earlier)) => {
                        return Err(format!("{id} is in update {update} and was in update {earlier}"));
                    }
                    None => return Err(format!("{id} is in update {update} and was never accepted")),
                },
                _ => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::invariants::tests::{accepted, id, look};

    #[test]
    fn a_second_training_is_seen() {
        let mut invariant = TrainedOnce::default();
        let mut see = |entry| invariant.check(&Look { entries: &[entry], ..look() });
        assert!(see(accepted(1)).is_ok());
        assert!(see(Entry::TrainedOn { id: id(1), update: 3 }).is_ok());
        assert!(see(Entry::TrainedOn { id: id(1), update: 4 }).unwrap_err().contains("update 3"));
        assert!(see(Entry::TrainedOn { id: id(2), update: 4 }).unwrap_err().contains("never accepted"));
        assert!(see(accepted(1)).unwrap_err().contains("second time"));
    }
}
