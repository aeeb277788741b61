//! Publication of weights: encoded once, shared by every watcher.

use bytes::Bytes;
use cross_proto::v1::WatchWeightsResponse;
use cross_proto::weights::{Snapshot, split};
use std::sync::Arc;
use tokio::sync::watch;

/// A published snapshot, cut into messages that share its memory.
#[derive(Debug)]
pub struct Published {
    /// Its version.
    pub policy_version: u64,
    /// In order; the last has the checksum.
    pub chunks: Vec<WatchWeightsResponse>,
}

impl Published {
    /// Cuts and hashes a snapshot: done once, on the trainer's thread.
    #[must_use]
    pub fn new(policy_version: u64, bytes: Vec<u8>) -> Arc<Self> {
        let snapshot = Snapshot { policy_version, bytes: Bytes::from(bytes) };
        Arc::new(Self { policy_version, chunks: split(&snapshot) })
    }
}

/// The newest snapshot; `None` before the first.
pub type Newest = watch::Receiver<Option<Arc<Published>>>;
