//! The weight stream: the newest snapshot at once, then each new one; whoever is slow skips to the newest.
//!
//! ```text
//!   watch_weights ── Subscription ──> WithWeights (layer) ── body: shared bytes ──> HTTP/2
//! ```
//! tonic encodes every message anew for every stream, a mebibyte of memory for each watcher while it reads. So the service
//! only subscribes, and the layer puts a body in place that hands out the bytes which the trainer encoded.

use crate::publish::{Newest, Published};
use cross_proto::v1::WatchWeightsResponse;
use futures::future::ready;
use futures::stream::{BoxStream, empty, once, unfold};
use futures::{Stream, StreamExt};
use http_body::Frame;
use http_body_util::StreamBody;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio_util::sync::CancellationToken;
use tonic::body::Body;
use tonic::codegen::{Bytes, Service, http};
use tonic::{Code, Response, Status};

/// Who watches, from which version on.
#[derive(Debug, Clone)]
struct Subscription {
    newest: Newest,
    known: u64,
    closing: CancellationToken,
}

/// A response that [`WithWeights`] fills: snapshots newer than `known`, until `closing` is cancelled.
pub(super) fn subscribe(
    newest: Newest,
    known: u64,
    closing: CancellationToken,
) -> Response<BoxStream<'static, Result<WatchWeightsResponse, Status>>> {
    let mut response = Response::new(empty().boxed());
    response.extensions_mut().insert(Subscription { newest, known, closing });
    response
}

/// Puts the bytes into responses of [`subscribe`].
#[derive(Debug, Clone)]
pub(super) struct WeightsLayer;

impl<S> tower::Layer<S> for WeightsLayer {
    type Service = WithWeights<S>;

    fn layer(&self, inner: S) -> WithWeights<S> {
        WithWeights(inner)
    }
}

/// A service behind the layer.
#[derive(Debug, Clone)]
pub(super) struct WithWeights<S>(S);

type Answer<E> = Pin<Box<dyn Future<Output = Result<http::Response<Body>, E>> + Send>>;

impl<S, B> Service<http::Request<B>> for WithWeights<S>
where
    S: Service<http::Request<B>, Response = http::Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = http::Response<Body>;
    type Error = S::Error;
    type Future = Answer<S::Error>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.0.poll_ready(context)
    }

    fn call(&mut self, request: http::Request<B>) -> Self::Future {
        let answer = self.0.call(request);
        Box::pin(async move {
            let mut response = answer.await?;
            Ok(match response.extensions_mut().remove::<Subscription>() {
                Some(subscription) => response.map(|_| body(messages(subscription))),
                None => response,
            })
        })
    }
}

struct Watcher {
    newest: Newest,
    /// Version the reader has, or is getting; 0 for none.
    known: u64,
    /// Snapshot that is being sent, and the next message. It is sent to its end even if a newer one appears: a reader slower
    /// than the updates would otherwise never get a whole one.
    sending: Option<(Arc<Published>, usize)>,
    closing: CancellationToken,
}

/// Encoded messages for one watcher.
fn messages(subscription: Subscription) -> impl Stream<Item = Bytes> + Send + 'static {
    let Subscription { newest, known, closing } = subscription;
    unfold(Watcher { newest, known, sending: None, closing }, |mut watcher| async move {
        let message = watcher.next().await?;
        Some((message, watcher))
    })
}

impl Watcher {
    async fn next(&mut self) -> Option<Bytes> {
        loop {
            if let Some((published, at)) = &mut self.sending {
                if let Some(message) = published.messages.get(*at) {
                    *at += 1;
                    return Some(message.clone());
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

/// A body of encoded messages, then the status that ends a stream well.
fn body(messages: impl Stream<Item = Bytes> + Send + 'static) -> Body {
    let trailers = http::HeaderMap::from_iter([(Status::GRPC_STATUS, (Code::Ok as i32).into())]);
    let frames = messages.map(Frame::data).chain(once(ready(Frame::trailers(trailers))));
    Body::new(StreamBody::new(frames.map(Ok::<_, Status>)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::publish::PREFIX_BYTES;
    use cross_proto::weights::{Assembler, CHUNK_BYTES};
    use http_body_util::BodyExt;
    use prost::Message;
    use std::pin::pin;
    use tokio::sync::watch;

    fn published(version: u64, size: usize) -> Option<Arc<Published>> {
        Some(Published::new(version, vec![version as u8; size]))
    }

    fn watch_from(newest: &Newest, known: u64, closing: &CancellationToken) -> BoxStream<'static, Bytes> {
        messages(Subscription { newest: newest.clone(), known, closing: closing.clone() }).boxed()
    }

    /// The message behind its prefix, which must be right.
    fn decoded(frame: &Bytes) -> WatchWeightsResponse {
        let (prefix, message) = frame.split_at(PREFIX_BYTES);
        assert_eq!(prefix[0], 0, "not compressed");
        assert_eq!(u32::from_be_bytes(prefix[1..].try_into().unwrap()) as usize, message.len());
        WatchWeightsResponse::decode(message).unwrap()
    }

    #[tokio::test]
    async fn a_slow_reader_finishes_one_snapshot_and_skips_to_the_newest() {
        let (sender, newest) = watch::channel(published(1, 2 * CHUNK_BYTES + 5));
        let closing = CancellationToken::new();
        let mut stream = pin!(watch_from(&newest, 0, &closing));
        let mut assembler = Assembler::new(4 * CHUNK_BYTES);
        let mut whole = Vec::new();
        let mut chunks = 0;
        while whole.len() < 2 {
            let chunk = decoded(&stream.next().await.unwrap());
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
        let closing = CancellationToken::new();
        let mut known = pin!(watch_from(&newest, 3, &closing));
        let mut other = pin!(watch_from(&newest, 0, &closing));
        assert_eq!(decoded(&other.next().await.unwrap()).policy_version, 3);
        sender.send_replace(published(4, 10));
        let (a, b) = (known.next().await.unwrap(), other.next().await.unwrap());
        assert_eq!((decoded(&a).policy_version, decoded(&b).policy_version), (4, 4));
        assert_eq!(a.as_ptr(), b.as_ptr());
    }

    #[tokio::test]
    async fn a_body_ends_with_the_status_that_says_well() {
        let (_sender, newest) = watch::channel(published(1, 10));
        let closing = CancellationToken::new();
        let mut body = body(watch_from(&newest, 0, &closing));
        assert!(body.frame().await.unwrap().unwrap().is_data());
        closing.cancel();
        let trailers = body.frame().await.unwrap().unwrap().into_trailers().unwrap();
        assert_eq!(trailers.get("grpc-status").unwrap(), "0");
        assert!(body.frame().await.is_none());
    }
}
