//! The admin port: `/metrics`, `/ready`, `/live`.

use crate::coordinator::Life;
use crate::telemetry::Telemetry;
use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

#[derive(Clone)]
struct Admin {
    telemetry: Telemetry,
    life: watch::Receiver<Life>,
}

/// Serves until `closing` is cancelled.
///
/// # Errors
/// If accepting fails for good.
pub(crate) async fn serve(
    listener: TcpListener,
    telemetry: Telemetry,
    life: watch::Receiver<Life>,
    closing: CancellationToken,
) -> std::io::Result<()> {
    let router = Router::new()
        .route("/metrics", get(metrics))
        .route("/ready", get(ready))
        .route("/live", get(|| async { "live\n" }))
        .with_state(Admin { telemetry, life });
    axum::serve(listener, router).with_graceful_shutdown(closing.cancelled_owned()).await
}

async fn metrics(State(admin): State<Admin>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], admin.telemetry.render())
}

async fn ready(State(admin): State<Admin>) -> (StatusCode, &'static str) {
    match *admin.life.borrow() {
        Life::Serving => (StatusCode::OK, "ready\n"),
        Life::Starting => (StatusCode::SERVICE_UNAVAILABLE, "starting\n"),
        Life::Draining => (StatusCode::SERVICE_UNAVAILABLE, "draining\n"),
    }
}
