//! Receiving weights: whatever comes in, the simulator finds only the newest complete snapshot.

use crate::backoff::Backoff;
use crate::link::Snapshot;
use crate::telemetry::Telemetry;
use cross_proto::Violation;
use cross_proto::client::LearnerClient;
use cross_proto::v1;
use cross_proto::weights::Assembler;
use cross_support::client::Connection;
use tokio::sync::watch;
use tonic::Status;

/// Larger snapshots are refused: a bound on what a confused peer can make this process allocate.
const MAX_SNAPSHOT_BYTES: usize = 1 << 30;

/// Keeps the slot at the newest weights of session `epoch`; returns why that ended.
///
/// A damaged snapshot costs only its own stream, opened again after a pause of `backoff`: the fragments flow on.
pub(crate) async fn watch(
    mut client: LearnerClient<Connection>,
    actor_id: &str,
    epoch: u64,
    slot: &watch::Sender<Option<Snapshot>>,
    telemetry: &Telemetry,
    mut backoff: Backoff,
) -> Status {
    loop {
        let damage = match receive(&mut client, actor_id, epoch, slot, telemetry, &mut backoff).await {
            Ok(damage) => damage,
            Err(status) => return status,
        };
        telemetry.snapshot_damaged();
        let pause = backoff.pause();
        tracing::warn!(pause_seconds = pause.as_secs_f64(), "asking for the weights again: {damage}");
        tokio::time::sleep(pause).await;
    }
}

/// Receives until a snapshot is damaged, which it describes.
async fn receive(
    client: &mut LearnerClient<Connection>,
    actor_id: &str,
    epoch: u64,
    slot: &watch::Sender<Option<Snapshot>>,
    telemetry: &Telemetry,
    backoff: &mut Backoff,
) -> Result<String, Status> {
    let known_version = known_version(slot.borrow().as_ref(), epoch);
    let request = v1::WatchWeightsRequest { actor_id: actor_id.to_owned(), known_version };
    let mut chunks = client.watch_weights(request).await?.into_inner();
    let mut receiver = Receiver { epoch, assembler: Assembler::new(MAX_SNAPSHOT_BYTES) };
    loop {
        let Some(chunk) = chunks.message().await? else {
            return Err(Status::unavailable("the learner closed the stream of weights"));
        };
        match receiver.take(&chunk, slot) {
            Ok(true) => {
                telemetry.snapshot_received();
                backoff.reset();
            }
            Ok(false) => {}
            Err(violation) => {
                let version = chunk.policy_version;
                return Ok(format!("the snapshot of policy version {version} is not usable: {violation}"));
            }
        }
    }
}

/// What to tell the learner that is here already. Versions of another session mean other weights.
fn known_version(slot: Option<&Snapshot>, epoch: u64) -> u64 {
    slot.filter(|held| held.epoch == epoch).map_or(0, |held| held.weights.policy_version)
}

/// Fills the slot from chunks.
struct Receiver {
    epoch: u64,
    assembler: Assembler,
}

impl Receiver {
    /// Takes a chunk; true if it completed a snapshot that is newer than the slot's.
    fn take(
        &mut self,
        chunk: &v1::WatchWeightsResponse,
        slot: &watch::Sender<Option<Snapshot>>,
    ) -> Result<bool, Violation> {
        let Some(weights) = self.assembler.push(chunk)? else { return Ok(false) };
        let epoch = self.epoch;
        Ok(slot.send_if_modified(|held| {
            let newer = held.as_ref().is_none_or(|held| {
                held.epoch != epoch || held.weights.policy_version < weights.policy_version
            });
            if newer {
                *held = Some(Snapshot { epoch, weights });
            }
            newer
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use cross_proto::weights::{self, CHUNK_BYTES};

    fn chunks(policy_version: u64, size: usize) -> Vec<v1::WatchWeightsResponse> {
        let bytes: Vec<u8> = (0..size).map(|i| (i % 251) as u8).collect();
        weights::split(&weights::Snapshot { policy_version, bytes: Bytes::from(bytes) })
    }

    struct Fixture {
        receiver: Receiver,
        slot: watch::Sender<Option<Snapshot>>,
    }

    impl Fixture {
        fn new(epoch: u64) -> Self {
            let assembler = Assembler::new(4 * CHUNK_BYTES);
            Self { receiver: Receiver { epoch, assembler }, slot: watch::channel(None).0 }
        }

        fn take(&mut self, chunk: &v1::WatchWeightsResponse) -> Result<bool, Violation> {
            self.receiver.take(chunk, &self.slot)
        }

        fn version(&self) -> Option<u64> {
            self.slot.borrow().as_ref().map(|s| s.weights.policy_version)
        }
    }

    #[test]
    fn the_slot_changes_only_with_the_last_chunk() {
        let mut fixture = Fixture::new(1);
        let chunks = chunks(3, 2 * CHUNK_BYTES + 5);
        assert_eq!(fixture.take(&chunks[0]), Ok(false));
        assert_eq!(fixture.take(&chunks[1]), Ok(false));
        assert_eq!(fixture.version(), None);
        assert_eq!(fixture.take(&chunks[2]), Ok(true));
        assert_eq!(fixture.version(), Some(3));
    }

    #[test]
    fn a_damaged_snapshot_leaves_the_slot_as_it_was() {
        let mut fixture = Fixture::new(1);
        assert_eq!(fixture.take(&chunks(3, 10)[0]), Ok(true));

        let mut corrupt = chunks(4, 10);
        corrupt[0].chunk = Bytes::from_static(b"0123456789");
        assert_eq!(fixture.take(&corrupt[0]).unwrap_err().field, "sha256");

        let out_of_order = chunks(4, 2 * CHUNK_BYTES);
        assert!(fixture.take(&out_of_order[1]).is_err());

        let mut oversized = chunks(4, 10);
        oversized[0].total_bytes = u64::MAX;
        assert_eq!(fixture.take(&oversized[0]).unwrap_err().field, "total_bytes");

        assert_eq!(fixture.version(), Some(3));
        assert_eq!(fixture.take(&chunks(4, 10)[0]), Ok(true), "a sound one still comes through");
    }

    #[test]
    fn older_versions_do_not_replace_newer_ones_within_a_session() {
        let mut fixture = Fixture::new(1);
        assert_eq!(fixture.take(&chunks(3, 10)[0]), Ok(true));
        assert_eq!(fixture.take(&chunks(2, 10)[0]), Ok(false));
        assert_eq!(fixture.version(), Some(3));
    }

    #[test]
    fn another_session_replaces_whatever_there_is() {
        let mut fixture = Fixture::new(1);
        assert_eq!(fixture.take(&chunks(9, 10)[0]), Ok(true));
        fixture.receiver = Receiver { epoch: 2, assembler: Assembler::new(CHUNK_BYTES) };
        assert_eq!(fixture.take(&chunks(4, 10)[0]), Ok(true));
        assert_eq!(fixture.version(), Some(4));
    }

    #[test]
    fn a_version_is_known_only_within_its_session() {
        let weights = weights::Snapshot { policy_version: 9, bytes: Bytes::new() };
        let held = Snapshot { epoch: 1, weights };
        assert_eq!(known_version(Some(&held), 1), 9);
        assert_eq!(known_version(Some(&held), 2), 0);
        assert_eq!(known_version(None, 1), 0);
    }
}
