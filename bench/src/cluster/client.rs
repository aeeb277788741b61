//! Connections as actors make them.

use crate::error::BenchError;
use cross_proto::client::{LearnerClient, TrainingClient};
use cross_support::client::{ClientSecurity, Connection};
use std::time::Duration;

/// Largest message that is taken; chunks of weights are the largest.
const MESSAGE_BYTES: usize = 64 << 20;
/// How often a server that does not answer a connection is tried again, and the pause between: a thousand clients at once
/// fill the queue of connections that nobody has accepted yet.
const TRIES: u32 = 5;
const PAUSE: Duration = Duration::from_millis(200);

/// A connection to `address` (`host:port`) with the settings of actors.
pub(crate) async fn connect(address: &str) -> Result<Connection, BenchError> {
    let security = ClientSecurity::default();
    let endpoint = cross_actor::endpoint(address, &security, false)
        .map_err(|source| BenchError::Address { source: Box::new(source) })?;
    let mut tries = 1;
    loop {
        match endpoint.connect().await {
            Ok(channel) => return Ok(security.connection(channel)),
            Err(_) if tries < TRIES => tokio::time::sleep(PAUSE).await,
            Err(source) => return Err(BenchError::Connect { address: address.to_owned(), source }),
        }
        tries += 1;
    }
}

/// The learner as actors see it.
pub(crate) fn learner(connection: Connection) -> LearnerClient<Connection> {
    LearnerClient::new(connection)
        .max_decoding_message_size(MESSAGE_BYTES)
        .max_encoding_message_size(MESSAGE_BYTES)
}

/// The run as people see it.
pub(crate) async fn training(address: &str) -> Result<TrainingClient<Connection>, BenchError> {
    Ok(TrainingClient::new(connect(address).await?))
}

/// An error of a call.
pub(crate) fn failed(call: &'static str) -> impl Fn(tonic::Status) -> BenchError {
    move |status| BenchError::Call { call, problem: status.message().to_owned(), code: status.code() }
}
