//! The admin port: `/metrics`, `/ready`, `/live`.
//!
//! The first is for those who may know; the other two say one word and are open to whatever asks whether a process is well.

use crate::incoming::{Incoming, Peer};
use crate::server::ServerSecurity;
use axum::Router;
use axum::extract::{ConnectInfo, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use std::future::Future;
use std::time::Duration;

/// How often histograms are folded; what nobody scrapes would grow without end otherwise.
const UPKEEP: Duration = Duration::from_secs(5);
/// The connections that an admin port has at a time.
pub const CONNECTIONS: usize = 64;

/// What the admin port tells about a process.
pub trait Subject: Clone + Send + Sync + 'static {
    /// What the process counts, in Prometheus' text format; what the operating system knows of it is added.
    fn metrics(&self) -> String;

    /// Folds histograms; called every few seconds. Nothing to do where few samples come between two scrapes.
    fn upkeep(&self) {}

    /// `Ok` when there is work to be had, else why not, in a few words.
    ///
    /// # Errors
    /// The reason.
    fn ready(&self) -> Result<(), &'static str>;
}

#[derive(Clone)]
struct Admin<S> {
    subject: S,
    security: ServerSecurity,
}

/// Serves until `stop` resolves.
pub async fn serve<S: Subject>(
    incoming: Incoming,
    security: ServerSecurity,
    subject: S,
    stop: impl Future<Output = ()>,
) {
    let router = Router::new()
        .route("/metrics", get(metrics::<S>))
        .route("/ready", get(ready::<S>))
        .route("/live", get(async || "live\n"))
        .with_state(Admin { subject: subject.clone(), security });
    let upkeep = async {
        let mut ticks = tokio::time::interval(UPKEEP);
        loop {
            ticks.tick().await;
            subject.upkeep();
        }
    };
    tokio::select! {
        result = async { axum::serve(incoming, router.into_make_service_with_connect_info::<Peer>()).await } => {
            if let Err(error) = result {
                tracing::error!("the admin port failed: {error}");
            }
        }
        () = upkeep => {}
        () = stop => {}
    }
}

async fn metrics<S: Subject>(
    State(admin): State<Admin<S>>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    headers: HeaderMap,
) -> Response {
    if admin.security.wants_client_certificates() && !peer.certificate {
        return (StatusCode::FORBIDDEN, "show a certificate that --tls-client-ca has signed\n")
            .into_response();
    }
    let authorization = headers.get(header::AUTHORIZATION).map(header::HeaderValue::as_bytes);
    if admin.security.tokens().is_some_and(|tokens| !tokens.accepts(authorization)) {
        let challenge = [(header::WWW_AUTHENTICATE, "Bearer")];
        return (StatusCode::UNAUTHORIZED, challenge, "send the token as: authorization: Bearer TOKEN\n")
            .into_response();
    }
    let kind = [(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")];
    (kind, admin.subject.metrics() + &crate::process::metrics() + &crate::threads::metrics()).into_response()
}

async fn ready<S: Subject>(State(admin): State<Admin<S>>) -> Response {
    match admin.subject.ready() {
        Ok(()) => (StatusCode::OK, "ready\n").into_response(),
        Err(reason) => (StatusCode::SERVICE_UNAVAILABLE, format!("{reason}\n")).into_response(),
    }
}
