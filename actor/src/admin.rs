//! The admin port: `/metrics`, `/ready`, `/live`.

use crate::error::ActorError;
use crate::telemetry::Telemetry;
use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::get;
use std::future::Future;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;

/// How often histograms are folded.
const UPKEEP: Duration = Duration::from_secs(5);

/// Binds the admin port and tells its address, in the log and, if asked for, in a file.
///
/// # Errors
/// [`ActorError`] if the address cannot be had or the file cannot be written.
pub(crate) async fn bind(address: SocketAddr, file: Option<&Path>) -> Result<TcpListener, ActorError> {
    let failed = |source| ActorError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    tracing::info!(address = %bound, "metrics at http://{bound}/metrics");
    if let Some(path) = file {
        write_address(path, bound)
            .await
            .map_err(|source| ActorError::AddressFile { path: path.to_owned(), source })?;
    }
    Ok(listener)
}

/// Written beside and renamed, so that a reader never sees half an address.
async fn write_address(path: &Path, address: SocketAddr) -> std::io::Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".part");
    tokio::fs::write(&partial, format!("{address}\n")).await?;
    tokio::fs::rename(&partial, path).await
}

/// Serves until `stop` resolves.
pub(crate) async fn serve(listener: TcpListener, telemetry: Arc<Telemetry>, stop: impl Future<Output = ()>) {
    let router = Router::new()
        .route("/metrics", get(metrics))
        .route("/ready", get(ready))
        .route("/live", get(async || "live\n"))
        .with_state(Arc::clone(&telemetry));
    let upkeep = async {
        let mut ticks = tokio::time::interval(UPKEEP);
        loop {
            ticks.tick().await;
            telemetry.upkeep();
        }
    };
    tokio::select! {
        result = async { axum::serve(listener, router).await } => {
            if let Err(error) = result {
                tracing::error!("the admin port failed: {error}");
            }
        }
        () = upkeep => {}
        () = stop => {}
    }
}

async fn metrics(State(telemetry): State<Arc<Telemetry>>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], telemetry.render())
}

async fn ready(State(telemetry): State<Arc<Telemetry>>) -> impl IntoResponse {
    if telemetry.is_ready() {
        (StatusCode::OK, "ready\n")
    } else {
        (StatusCode::SERVICE_UNAVAILABLE, "waiting for a learner or its weights\n")
    }
}
