//! The journal: what became of each fragment, by name.
//!
//! Counters say how many; to find out why one actor's data is missing, or to prove that none is trained on twice, one needs to
//! know which. Off unless asked for with `--log info,cross_learner::fragments=debug`; then each fragment has a line when it
//! is accepted or declined, and one when it leaves the buffer. A round is written down when an update takes it; should the
//! update fail, each of its fragments has one more line, dropped. An acknowledgement goes out after the line that it rests on.

use super::types::{Dropped, Outcome};
use cross_proto::fragment::Checked;
use cross_sim::trajectory::FragmentId;

/// Filter by which the journal is switched on.
const TARGET: &str = "cross_learner::fragments";

macro_rules! entry {
    ($id:expr, $($rest:tt)+) => {
        tracing::debug!(
            target: TARGET,
            actor = $id.actor,
            session = $id.session_epoch,
            episode = $id.episode,
            sequence = $id.sequence,
            $($rest)+
        )
    };
}

/// It is in the buffer, and about to be acknowledged.
pub(super) fn accepted(fragment: &Checked) {
    let decisions = fragment.actions.len();
    entry!(
        fragment.id,
        scenario = fragment.scenario,
        policy_version = fragment.policy_version,
        steps = fragment.steps,
        decisions,
        "fragment accepted"
    );
}

/// It was offered and is not kept.
pub(super) fn declined(id: &FragmentId, outcome: Outcome) {
    entry!(id, outcome = outcome.label(), "fragment declined");
}

/// It has left the buffer for the round that this update trains on, unless it fails.
pub(super) fn trained_on(fragment: &Checked, update: u64) {
    entry!(fragment.id, update, "fragment trained on");
}

/// It was received and will not be trained on.
pub(super) fn dropped(id: &FragmentId, reason: Dropped) {
    entry!(id, reason = reason.label(), "fragment dropped");
}
