//! Snapshots in chunks: what `WatchWeights` sends and how a reader puts it together again.

use crate::{Violation, v1::WatchWeightsResponse};
use bytes::Bytes;
use sha2::{Digest, Sha256};

/// Bytes in a chunk: large enough that framing costs nothing, small enough that other streams get their turn.
pub const CHUNK_BYTES: usize = 1 << 20;

/// A snapshot of inference weights.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Snapshot {
    /// Policy version it belongs to.
    pub policy_version: u64,
    /// A safetensors file.
    pub bytes: Bytes,
}

/// Cuts a snapshot into messages, in order. They share its memory; only the last carries the checksum.
#[must_use]
pub fn split(snapshot: &Snapshot) -> Vec<WatchWeightsResponse> {
    let total = snapshot.bytes.len();
    let count = total.div_ceil(CHUNK_BYTES).max(1);
    (0..count)
        .map(|index| {
            let start = index * CHUNK_BYTES;
            let end = total.min(start + CHUNK_BYTES);
            let last = index + 1 == count;
            WatchWeightsResponse {
                policy_version: snapshot.policy_version,
                offset: start as u64,
                total_bytes: total as u64,
                chunk: snapshot.bytes.slice(start..end),
                sha256: if last { Sha256::digest(&snapshot.bytes).to_vec().into() } else { Bytes::new() },
            }
        })
        .collect()
}

/// Puts chunks together again.
#[derive(Debug)]
pub struct Assembler {
    max_bytes: usize,
    policy_version: u64,
    total: usize,
    received: Vec<u8>,
}

impl Assembler {
    /// An assembler that refuses snapshots of more than `max_bytes`.
    #[must_use]
    pub fn new(max_bytes: usize) -> Self {
        Self { max_bytes, policy_version: 0, total: 0, received: Vec::new() }
    }

    /// Takes the next message; gives the snapshot once it is complete and its checksum right.
    ///
    /// A message at offset 0 starts a new snapshot, whatever became of the one before.
    ///
    /// # Errors
    /// [`Violation`] if a chunk is missing, too large or not of this snapshot, or the checksum is wrong; the assembler
    /// then waits for the next offset 0.
    pub fn push(&mut self, message: &WatchWeightsResponse) -> Result<Option<Snapshot>, Violation> {
        let result = self.accept(message);
        if result.is_err() {
            self.received = Vec::new();
            self.total = 0;
        }
        result
    }

    fn accept(&mut self, message: &WatchWeightsResponse) -> Result<Option<Snapshot>, Violation> {
        let total = usize::try_from(message.total_bytes).unwrap_or(usize::MAX);
        if total > self.max_bytes {
            return Err(Violation::new(
                "total_bytes",
                format!("is {}; at most {} are accepted", message.total_bytes, self.max_bytes),
            ));
        }
        if message.offset == 0 {
            self.policy_version = message.policy_version;
            self.total = total;
            // Room for what came, not for what was announced.
            self.received = Vec::with_capacity(total.min(CHUNK_BYTES));
        }
        if message.policy_version != self.policy_version {
            return Err(Violation::new(
                "policy_version",
                format!(
                    "changed from {} to {} within a snapshot",
                    self.policy_version, message.policy_version
                ),
            ));
        }
        if total != self.total {
            return Err(Violation::new(
                "total_bytes",
                format!("changed from {} to {total} within a snapshot", self.total),
            ));
        }
        if message.offset != self.received.len() as u64 {
            return Err(Violation::new(
                "offset",
                format!("is {} where {} comes next", message.offset, self.received.len()),
            ));
        }
        if message.chunk.len() > self.total - self.received.len() {
            return Err(Violation::new("chunk", format!("goes past the snapshot's {} bytes", self.total)));
        }
        self.received.extend_from_slice(&message.chunk);
        if self.received.len() < self.total {
            return Ok(None);
        }
        if Sha256::digest(&self.received).as_slice() != message.sha256 {
            return Err(Violation::new(
                "sha256",
                "is not that of the bytes received; the snapshot is damaged",
            ));
        }
        let bytes = Bytes::from(std::mem::take(&mut self.received));
        Ok(Some(Snapshot { policy_version: self.policy_version, bytes }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAX: usize = 4 * CHUNK_BYTES;

    fn snapshot(policy_version: u64, size: usize) -> Snapshot {
        Snapshot { policy_version, bytes: (0..size).map(|index| (index % 251) as u8).collect() }
    }

    fn assemble(assembler: &mut Assembler, messages: &[WatchWeightsResponse]) -> Option<Snapshot> {
        let mut complete =
            messages.iter().map(|message| assembler.push(message).unwrap()).collect::<Vec<_>>();
        let last = complete.pop().flatten();
        assert!(complete.iter().all(Option::is_none), "complete before the last chunk");
        last
    }

    #[test]
    fn an_announced_size_takes_no_memory() {
        let mut assembler = Assembler::new(1 << 30);
        let message = WatchWeightsResponse { total_bytes: 1 << 30, ..WatchWeightsResponse::default() };
        assert_eq!(assembler.push(&message), Ok(None));
        assert!(assembler.received.capacity() <= CHUNK_BYTES);
    }

    #[test]
    fn snapshots_of_every_size_come_together_again() {
        let mut assembler = Assembler::new(MAX);
        for size in [0, 1, CHUNK_BYTES - 1, CHUNK_BYTES, CHUNK_BYTES + 1, 3 * CHUNK_BYTES, MAX] {
            let original = snapshot(size as u64, size);
            let messages = split(&original);
            assert!(messages.iter().all(|message| message.chunk.len() <= CHUNK_BYTES));
            assert_eq!(assemble(&mut assembler, &messages), Some(original));
        }
    }

    #[test]
    fn chunks_share_the_snapshot() {
        let original = snapshot(1, 3 * CHUNK_BYTES);
        let messages = split(&original);
        assert_eq!(messages[1].chunk.as_ptr(), original.bytes[CHUNK_BYTES..].as_ptr());
    }

    #[test]
    fn a_new_snapshot_may_start_before_the_old_one_ends() {
        let mut assembler = Assembler::new(MAX);
        assert_eq!(assembler.push(&split(&snapshot(1, MAX))[0]), Ok(None));
        let newer = snapshot(2, 10);
        assert_eq!(assembler.push(&split(&newer)[0]), Ok(Some(newer)));
    }

    #[test]
    fn damage_is_named_and_the_next_snapshot_still_comes() {
        let original = snapshot(1, 2 * CHUNK_BYTES);
        let messages = split(&original);
        let refused = |change: fn(&mut WatchWeightsResponse)| {
            let mut assembler = Assembler::new(MAX);
            assembler.push(&messages[0]).unwrap();
            let mut second = messages[1].clone();
            change(&mut second);
            let field = assembler.push(&second).unwrap_err().field;
            assert_eq!(assemble(&mut assembler, &messages), Some(original.clone()));
            field
        };
        assert_eq!(refused(|message| message.offset += 1), "offset");
        assert_eq!(refused(|message| message.policy_version += 1), "policy_version");
        assert_eq!(refused(|message| message.total_bytes += 1), "total_bytes");
        assert_eq!(refused(|message| message.chunk = vec![0; CHUNK_BYTES + 1].into()), "chunk");
        assert_eq!(refused(|message| message.chunk = vec![0; CHUNK_BYTES].into()), "sha256");
        assert_eq!(refused(|message| message.sha256 = Bytes::new()), "sha256");
    }

    #[test]
    fn a_snapshot_above_the_limit_takes_no_memory() {
        let mut assembler = Assembler::new(MAX);
        let mut message = split(&snapshot(1, 1))[0].clone();
        for total in [MAX as u64 + 1, u64::MAX] {
            message.total_bytes = total;
            assert_eq!(assembler.push(&message).unwrap_err().field, "total_bytes");
        }
    }

    #[test]
    fn a_lost_beginning_is_noticed() {
        let messages = split(&snapshot(0, 2 * CHUNK_BYTES));
        assert!(Assembler::new(MAX).push(&messages[1]).is_err());
    }
}
