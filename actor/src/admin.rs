//! What the actor tells on its admin port, and where that port is.

use crate::error::ActorError;
use crate::telemetry::Telemetry;
use cross_support::admin::Subject;
use cross_support::files::replace_file;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use tokio::net::TcpListener;

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
        // Once, before there is any other work for these threads.
        replace_file(path, format!("{bound}\n").as_bytes())
            .map_err(|source| ActorError::AddressFile { path: path.to_owned(), source })?;
    }
    Ok(listener)
}

/// The actor as its admin port shows it.
#[derive(Debug, Clone)]
pub(crate) struct Admin(pub(crate) Arc<Telemetry>);

impl Subject for Admin {
    fn metrics(&self) -> String {
        self.0.render()
    }

    fn upkeep(&self) {
        self.0.upkeep();
    }

    fn ready(&self) -> Result<(), &'static str> {
        if self.0.is_ready() { Ok(()) } else { Err("waiting for a learner or its weights") }
    }
}
