//! The policy version grows: within a learner's life it never falls, and a new life begins no earlier than at the newest
//! checkpoint that the one before left whole. Nor do actors fall back: within a session, what the learner accepts of one is
//! never of an older version than what it accepted before.

use super::Look;
use crate::faults::journal::Entry;
use std::collections::HashMap;

pub(super) const NAME: &str = "version monotone";

#[derive(Debug, Default)]
pub(super) struct Versions {
    /// Newest policy version and number of updates of this life.
    last: (u64, u64),
    /// Least number of updates at which the next life may begin.
    least: u64,
    begun: bool,
    /// Newest version of the data accepted of each actor, and under which session.
    accepted: HashMap<String, (u64, u64)>,
}

impl Versions {
    pub(super) fn check(&mut self, look: &Look<'_>) -> Result<(), String> {
        for entry in look.entries {
            let Entry::Accepted { id, policy_version, .. } = entry else { continue };
            let (session, newest) = self.accepted.entry(id.actor.clone()).or_default();
            if *session == id.session && policy_version < newest {
                return Err(format!("{id} is of version {policy_version}, and one of {newest} came before"));
            }
            (*session, *newest) = (id.session, *policy_version);
        }
        let Some(status) = look.status else { return Ok(()) };
        let now = (status.policy_version, status.updates);
        if !self.begun {
            // Until the model stands, the status says nothing of it.
            if status.policy_version == 0 {
                return Ok(());
            }
            self.begun = true;
            if status.updates < self.least {
                return Err(format!(
                    "a learner began at update {}, though the checkpoint of update {} was whole",
                    status.updates, self.least
                ));
            }
        } else if now.0 < self.last.0 || now.1 < self.last.1 {
            return Err(format!(
                "version {} and update {} came after version {} and update {}",
                now.0, now.1, self.last.0, self.last.1
            ));
        }
        self.last = now;
        Ok(())
    }

    pub(super) fn learner_ended(&mut self, newest_checkpoint: u64) {
        *self = Self { least: newest_checkpoint, ..Self::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::invariants::tests::{id, look};
    use crate::faults::journal::Id;
    use cross_proto::v1::TrainingStatus;

    fn status(policy_version: u64, updates: u64) -> TrainingStatus {
        TrainingStatus { policy_version, updates, ..TrainingStatus::default() }
    }

    #[test]
    fn an_actor_may_fall_back_only_under_another_session() {
        let mut versions = Versions::default();
        let mut see = |actor: &str, session, policy_version| {
            let id = Id { actor: actor.to_owned(), session, ..id(1) };
            let entries = [Entry::Accepted { id, decisions: 1, policy_version }];
            versions.check(&super::super::Look { entries: &entries, ..look() })
        };
        assert!(see("a", 1, 5).is_ok());
        assert!(see("a", 1, 5).is_ok());
        assert!(see("b", 1, 4).is_ok());
        assert!(see("a", 2, 3).is_ok());
        assert!(see("a", 2, 2).unwrap_err().contains("one of 3 came before"));
    }

    #[test]
    fn a_version_may_fall_only_to_the_newest_checkpoint_of_a_learner_that_ended() {
        let mut versions = Versions::default();
        let see = |versions: &mut Versions, v, u| {
            let status = status(v, u);
            versions.check(&super::super::Look { status: Some(&status), ..look() })
        };
        assert!(see(&mut versions, 11, 10).is_ok());
        assert!(see(&mut versions, 11, 10).is_ok());
        assert!(see(&mut versions, 10, 9).is_err());
        versions.learner_ended(5);
        assert!(see(&mut versions, 6, 5).is_ok());
        versions.learner_ended(5);
        assert!(see(&mut versions, 5, 4).is_err());
    }
}
