//! A fragment stream whose messages are taken as bytes, without being looked into.

use super::{Bare, Stream};
use bytes::{Buf, Bytes};
use cross_proto::server::LearnerServer;
use cross_proto::v1::{self, stream_fragments_response::Message};
use futures::StreamExt;
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use tonic::body::Body;
use tonic::codec::{Codec, DecodeBuf, Decoder};
use tonic::codegen::{Service, http};
use tonic::server::{Grpc, NamedService, StreamingService};
use tonic::{Request, Response, Status, Streaming};
use tonic_prost::ProstCodec;

/// All that came, of all streams. What each holds is its part of what its stream received, which tonic does not copy.
pub(super) type Kept = Arc<Mutex<Vec<Bytes>>>;

/// How many there are.
pub(super) fn kept(kept: &Kept) -> u64 {
    kept.lock().unwrap_or_else(PoisonError::into_inner).len() as u64
}

const STREAM_FRAGMENTS: &str = "/cross.v1.Learner/StreamFragments";

/// Takes fragments as bytes, and leaves the other calls to the generated server.
#[derive(Debug, Clone)]
pub(super) struct Raw {
    rest: LearnerServer<Bare>,
    message_bytes: usize,
    kept: Option<Kept>,
}

impl Raw {
    /// Messages of at most `message_bytes`, which go to `kept` where there is one.
    pub(super) fn new(rest: LearnerServer<Bare>, message_bytes: usize, kept: Option<Kept>) -> Self {
        Self { rest, message_bytes, kept }
    }
}

impl NamedService for Raw {
    const NAME: &'static str = cross_proto::service::LEARNER;
}

impl Service<http::Request<Body>> for Raw {
    type Response = http::Response<Body>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<http::Response<Body>, Infallible>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: http::Request<Body>) -> Self::Future {
        if request.uri().path() != STREAM_FRAGMENTS {
            return Box::pin(self.rest.call(request));
        }
        let limit = Some(self.message_bytes);
        let acknowledge = Acknowledge { kept: self.kept.clone() };
        Box::pin(async move {
            let mut grpc = Grpc::new(BytesCodec).apply_max_message_size_config(limit, limit);
            Ok(grpc.streaming(acknowledge, request).await)
        })
    }
}

/// Acknowledges each message after the first, which is a hello.
struct Acknowledge {
    kept: Option<Kept>,
}

impl StreamingService<Bytes> for Acknowledge {
    type Response = v1::StreamFragmentsResponse;
    type ResponseStream = Stream<Self::Response>;
    type Future = std::future::Ready<Result<Response<Self::ResponseStream>, Status>>;

    fn call(&mut self, request: Request<Streaming<Bytes>>) -> Self::Future {
        let kept = self.kept.clone();
        let answers = request.into_inner().skip(1).map(move |message| {
            message.map(|bytes| {
                if let Some(kept) = &kept {
                    // Nothing between taking it and giving it back can panic.
                    kept.lock().unwrap_or_else(PoisonError::into_inner).push(bytes);
                }
                let ack = v1::Ack { outcome: v1::Outcome::Accepted.into(), ..v1::Ack::default() };
                v1::StreamFragmentsResponse { message: Some(Message::Ack(ack)) }
            })
        });
        std::future::ready(Ok(Response::new(answers.boxed())))
    }
}

/// Messages come as they are.
#[derive(Debug, Clone, Copy)]
struct BytesCodec;

impl Codec for BytesCodec {
    type Encode = v1::StreamFragmentsResponse;
    type Decode = Bytes;
    type Encoder = <ProstCodec<v1::StreamFragmentsResponse, v1::StreamFragmentsRequest> as Codec>::Encoder;
    type Decoder = BytesDecoder;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<v1::StreamFragmentsResponse, v1::StreamFragmentsRequest>::default().encoder()
    }

    fn decoder(&mut self) -> BytesDecoder {
        BytesDecoder
    }
}

#[derive(Debug, Clone, Copy)]
struct BytesDecoder;

impl Decoder for BytesDecoder {
    type Item = Bytes;
    type Error = Status;

    fn decode(&mut self, message: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        Ok(Some(message.copy_to_bytes(message.remaining())))
    }
}
