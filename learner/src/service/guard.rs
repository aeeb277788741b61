//! What every call must pass before a service sees it: the rate of its address, the token, the number of open calls.
//!
//! Refused calls get what every error of these services has: a sentence, a reason, and when to come again if that helps.

use super::COME_AGAIN;
use super::rates::Rates;
use cross_proto::status::{self, Reason};
use cross_support::incoming::Peer;
use cross_support::server::ServerSecurity;
use http_body::{Frame, SizeHint};
use std::net::{IpAddr, Ipv4Addr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Instant;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::body::Body;
use tonic::codegen::{Bytes, Service, http};
use tonic::{Code, Status};

/// Tells a client which compressions it may use.
const ENCODINGS: &str = "grpc-accept-encoding";

/// Limits on calls.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Calls that may be open, streams included.
    pub(super) streams: usize,
    /// Calls that one address may begin a second.
    pub(super) requests_per_second: u32,
    /// Largest message, bytes; services enforce it, and this says so.
    pub(super) message_bytes: usize,
}

/// Puts the guard before all services of a server.
#[derive(Debug, Clone)]
pub(super) struct GuardLayer(Arc<Guard>);

#[derive(Debug)]
struct Guard {
    security: ServerSecurity,
    limits: Limits,
    rates: Mutex<Rates>,
    places: Arc<Semaphore>,
    started: Instant,
}

impl GuardLayer {
    pub(super) fn new(security: ServerSecurity, limits: Limits) -> Self {
        Self(Arc::new(Guard {
            security,
            limits,
            rates: Mutex::new(Rates::new(limits.requests_per_second)),
            places: Arc::new(Semaphore::new(limits.streams.min(Semaphore::MAX_PERMITS))),
            started: Instant::now(),
        }))
    }
}

impl<S> tower::Layer<S> for GuardLayer {
    type Service = Guarded<S>;

    fn layer(&self, inner: S) -> Guarded<S> {
        Guarded { inner, guard: Arc::clone(&self.0) }
    }
}

impl Guard {
    /// A place for the call, or why it has none.
    fn admit<B>(&self, request: &http::Request<B>) -> Result<OwnedSemaphorePermit, Status> {
        // Every connection of this server has its peer; were one without, it would share a bucket with its like.
        let peer = request.extensions().get::<Peer>();
        let address = peer.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |peer| peer.address.ip());
        // First the rate, so that tokens cannot be tried out at will.
        let mut rates = self.rates.lock().unwrap_or_else(PoisonError::into_inner);
        let admitted = rates.admit(self.started.elapsed(), address);
        drop(rates);
        admitted.map_err(|wait| status::too_many_requests(self.limits.requests_per_second, wait))?;
        let authorization = request.headers().get(http::header::AUTHORIZATION);
        let authorization = authorization.map(http::HeaderValue::as_bytes);
        if self.security.tokens().is_some_and(|tokens| !tokens.accepts(authorization)) {
            let problem = match authorization {
                Some(_) => {
                    "the token is not the learner's; give the client the same --token-file or CROSS_TOKEN"
                }
                None => "the learner asks for a token; give the client --token-file or CROSS_TOKEN",
            };
            return Err(status::error(Reason::Unauthenticated, problem));
        }
        Arc::clone(&self.places)
            .try_acquire_owned()
            .map_err(|_| status::too_many_streams(self.limits.streams, COME_AGAIN))
    }

    /// The same response, or one with a reason where the transport gave none. Errors of the services have details; those
    /// without are of tonic, which refused the call before a service saw it.
    fn explained(&self, path: &str, response: http::Response<Body>) -> http::Response<Body> {
        let status = match Status::from_header_map(response.headers()) {
            Some(status) if status.details().is_empty() => status,
            _ => return response,
        };
        let explained = match (status.code(), status.message()) {
            // The present tonic says so of a message above the limit.
            (Code::OutOfRange, _) => status::message_too_large(self.limits.message_bytes),
            (Code::Unimplemented, "") => status::unknown_method(path),
            (Code::Unimplemented, compression) => status::error(Reason::Unsupported, compression),
            (Code::Internal, problem) => {
                status::error(Reason::UnexpectedMessage, format!("the request cannot be read: {problem}"))
            }
            _ => return response,
        };
        let mut answer = explained.into_http();
        if let Some(encodings) = response.headers().get(ENCODINGS) {
            answer.headers_mut().insert(ENCODINGS, encodings.clone());
        }
        answer
    }
}

/// A service behind the guard.
#[derive(Debug, Clone)]
pub(super) struct Guarded<S> {
    inner: S,
    guard: Arc<Guard>,
}

type Answer<E> = Pin<Box<dyn Future<Output = Result<http::Response<Body>, E>> + Send>>;

impl<S, B> Service<http::Request<B>> for Guarded<S>
where
    S: Service<http::Request<B>, Response = http::Response<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = http::Response<Body>;
    type Error = S::Error;
    type Future = Answer<S::Error>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: http::Request<B>) -> Self::Future {
        match self.guard.admit(&request) {
            Err(status) => Box::pin(std::future::ready(Ok(status.into_http()))),
            Ok(place) => {
                let guard = Arc::clone(&self.guard);
                let uri = request.uri().clone();
                let answer = self.inner.call(request);
                Box::pin(async move {
                    let response = guard.explained(uri.path(), answer.await?);
                    Ok(response.map(|body| Body::new(Held { body, _place: place })))
                })
            }
        }
    }
}

/// A response's body, which keeps the call's place until all of it is sent or the client is gone.
struct Held {
    body: Body,
    _place: OwnedSemaphorePermit,
}

impl http_body::Body for Held {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
