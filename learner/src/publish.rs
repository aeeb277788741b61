//! Publication of weights: encoded once, shared by every watcher.

use bytes::{BufMut, Bytes, BytesMut};
use cross_proto::v1::WatchWeightsResponse;
use cross_proto::weights::{Snapshot, split};
use prost::Message;
use std::sync::Arc;
use tokio::sync::watch;

/// What comes before each message on a gRPC stream: whether it is compressed, one byte, and its length, four.
pub const PREFIX_BYTES: usize = 5;

/// A published snapshot as it goes over the wire. Watchers share these bytes: what one more of them costs is a socket.
#[derive(Debug)]
pub struct Published {
    /// Its version.
    pub policy_version: u64,
    /// Encoded `WatchWeightsResponse`s, each with its prefix, in order; the last has the checksum.
    pub messages: Vec<Bytes>,
}

impl Published {
    /// Cuts, hashes and encodes a snapshot: done once, on the trainer's thread.
    #[must_use]
    pub fn new(policy_version: u64, bytes: Vec<u8>) -> Arc<Self> {
        let snapshot = Snapshot { policy_version, bytes: Bytes::from(bytes) };
        Arc::new(Self { policy_version, messages: split(&snapshot).iter().map(framed).collect() })
    }
}

/// A message as a gRPC stream carries it, uncompressed.
fn framed(message: &WatchWeightsResponse) -> Bytes {
    let length = message.encoded_len();
    let mut frame = BytesMut::with_capacity(PREFIX_BYTES + length);
    frame.put_u8(0);
    // A chunk has a mebibyte, so that this never saturates.
    frame.put_u32(u32::try_from(length).unwrap_or(u32::MAX));
    // Fails only where there is no room, and this buffer grows.
    let _ = message.encode(&mut frame);
    frame.freeze()
}

/// The newest snapshot; `None` before the first.
pub type Newest = watch::Receiver<Option<Arc<Published>>>;
