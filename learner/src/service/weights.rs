//! The weight stream: the newest snapshot at once, then each new one; whoever is slow skips to the newest.

use crate::publish::{Newest, Published};
use cross_proto::v1::WatchWeightsResponse;
use futures::Stream;
use futures::stream::unfold;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;
use tonic::Status;

struct Watcher {
    newest: Newest,
    /// Version the reader has, or is getting; 0 for none.
    known: u64,
    /// Snapshot that is being sent, and the next chunk. It is sent to its end even if a newer one appears: a reader slower
    /// than the updates would otherwise never get a whole one.
    sending: Option<(Arc<Published>, usize)>,
    closing: CancellationToken,
}

pub(super) fn watch(
    newest: Newest,
    known: u64,
    closing: CancellationToken,
) -> impl Stream<Item = Result<WatchWeightsResponse, Status>> + Send + 'static {
    unfold(Watcher { newest, known, sending: None, closing }, |mut watcher| async move {
        let chunk = watcher.next().await?;
        Some((Ok(chunk), watcher))
    })
}

impl Watcher {
    async fn next(&mut self) -> Option<WatchWeightsResponse> {
        loop {
            if let Some((published, at)) = &mut self.sending {
                if let Some(chunk) = published.chunks.get(*at) {
                    *at += 1;
                    return Some(chunk.clone());
                }
                self.sending = None;
            }
            let newest = self.newest.borrow_and_update().clone();
            match newest {
                Some(published) if published.policy_version != self.known => {
                    self.known = published.policy_version;
                    self.sending = Some((published, 0));
                }
                _ => tokio::select! {
                    changed = self.newest.changed() => changed.ok()?,
                    () = self.closing.cancelled() => return None,
                },
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cross_proto::weights::{Assembler, CHUNK_BYTES};
    use futures::StreamExt;
    use std::pin::pin;
    use tokio::sync::watch;

    fn published(version: u64, size: usize) -> Option<Arc<Published>> {
        Some(Published::new(version, vec![version as u8; size]))
    }

    #[tokio::test]
    async fn a_slow_reader_finishes_one_snapshot_and_skips_to_the_newest() {
        let (sender, newest) = watch::channel(published(1, 2 * CHUNK_BYTES + 5));
        let closing = CancellationToken::new();
        let mut stream = pin!(super::watch(newest, 0, closing.clone()));
        let mut assembler = Assembler::new(4 * CHUNK_BYTES);
        let mut whole = Vec::new();
        let mut chunks = 0;
        while whole.len() < 2 {
            let chunk = stream.next().await.unwrap().unwrap();
            chunks += 1;
            if chunks == 1 {
                for version in 2..=4 {
                    sender.send_replace(published(version, 10));
                }
            }
            whole.extend(assembler.push(&chunk).unwrap().map(|snapshot| snapshot.policy_version));
        }
        assert_eq!((whole, chunks), (vec![1, 4], 4));
        closing.cancel();
        assert!(stream.next().await.is_none());
    }

    #[tokio::test]
    async fn a_reader_gets_nothing_it_already_has_and_all_share_the_bytes() {
        let (sender, newest) = watch::channel(published(3, 10));
        let mut known = pin!(super::watch(newest.clone(), 3, CancellationToken::new()));
        let mut other = pin!(super::watch(newest, 0, CancellationToken::new()));
        assert_eq!(other.next().await.unwrap().unwrap().policy_version, 3);
        sender.send_replace(published(4, 10));
        let (a, b) = (known.next().await.unwrap().unwrap(), other.next().await.unwrap().unwrap());
        assert_eq!((a.policy_version, b.policy_version), (4, 4));
        assert_eq!(a.chunk.as_ptr(), b.chunk.as_ptr());
    }
}
