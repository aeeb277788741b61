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
            self.received = Vec::with_capacity(total);
        }
        if message.policy_version != self.policy_version || total != self.total {
            return Err(Violation::new(
                "policy_version",
                format!(
                    "changed from {} to {} within a snapshot",
                    self.policy_version, message.policy_version
                ),
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
