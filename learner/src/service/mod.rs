//! The gRPC server: three services, health and reflection on one port.

mod checkpoints;
mod fragments;
mod guard;
mod health;
mod learner;
mod rates;
mod training;
mod weights;

use crate::coordinator::{Gone, Handle, Life};
use crate::publish::Newest;
use cross_config::Config;
use cross_proto::fragment::FragmentSpec;
use cross_proto::server::{CheckpointsServer, LearnerServer, TrainingServer};
use cross_proto::{status, v1};
use cross_support::incoming::Incoming;
use cross_support::server::ServerSecurity;
use guard::{GuardLayer, Limits};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tonic::Status;
use tonic::transport::server::Server;

/// Calls that one connection may have open; an actor has two streams. A client with more of them waits.
const CALLS_A_CONNECTION: u32 = 100;
/// Largest headers of a call, bytes; a token and a few names.
const HEADER_BYTES: u32 = 16 * 1024;

/// How long a refused caller should stay away.
const COME_AGAIN: Duration = Duration::from_secs(2);

/// What every service knows.
#[derive(Debug, Clone)]
pub(crate) struct Shared {
    pub(crate) config: Arc<Config>,
    pub(crate) run: PathBuf,
    pub(crate) run_id: String,
    pub(crate) session_epoch: u64,
    /// Scenarios in the configuration's order.
    pub(crate) specs: Arc<[FragmentSpec]>,
    pub(crate) unacked_fragments: usize,
    pub(crate) coordinator: Handle,
    pub(crate) life: watch::Receiver<Life>,
    pub(crate) newest: Newest,
    pub(crate) status: watch::Receiver<v1::TrainingStatus>,
    /// Cancelled when open streams have to end.
    pub(crate) closing: CancellationToken,
}

impl Shared {
    /// Waits while the model is being set up; an error once the learner is leaving.
    async fn serving(&self) -> Result<(), Status> {
        let mut life = self.life.clone();
        let known = life.wait_for(|life| *life != Life::Starting).await;
        match known.as_deref() {
            Ok(Life::Serving) => Ok(()),
            _ => Err(status::draining(COME_AGAIN)),
        }
    }
}

impl From<Gone> for Status {
    fn from(_: Gone) -> Self {
        status::draining(COME_AGAIN)
    }
}

/// Serves until `closing` is cancelled, then until every connection is over.
///
/// # Errors
/// If the server cannot be set up or accepting fails for good.
pub(crate) async fn serve(
    shared: Shared,
    incoming: Incoming,
    security: ServerSecurity,
) -> anyhow::Result<()> {
    let limit = shared.config.learner.max_message_bytes;
    let limits = Limits {
        streams: shared.config.learner.max_streams,
        requests_per_second: shared.config.learner.requests_per_second,
        message_bytes: limit,
    };
    // What the learner sends in one message is bounded by itself: a chunk and its frame, however small the limit on actors.
    let outgoing = limit.max(2 * cross_proto::weights::CHUNK_BYTES);
    let (health, reporting) = health::service(shared.life.clone(), shared.closing.clone()).await;

    let learner = LearnerServer::new(learner::LearnerService::new(shared.clone()))
        .max_decoding_message_size(limit)
        .max_encoding_message_size(outgoing);
    let checkpoints = CheckpointsServer::new(checkpoints::CheckpointsService::new(shared.clone()))
        .max_decoding_message_size(limit)
        .max_encoding_message_size(outgoing);
    let training = TrainingServer::new(training::TrainingService::new(shared.clone()))
        .max_decoding_message_size(limit)
        .max_encoding_message_size(outgoing);
    // The two reflection versions have different types, but describe the same: also each other.
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(cross_proto::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(cross_proto::HEALTH_FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(cross_proto::ERROR_FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET)
    };
    let keepalive = Duration::from_secs(shared.config.learner.lease_seconds).div_f64(3.0);
    let served = Server::builder()
        .http2_keepalive_interval(Some(keepalive))
        .http2_keepalive_timeout(Some(keepalive))
        .max_concurrent_streams(CALLS_A_CONNECTION)
        .http2_max_header_list_size(HEADER_BYTES)
        .layer(GuardLayer::new(security, limits))
        .layer(weights::WeightsLayer)
        .add_service(health)
        .add_service(reflection().build_v1()?)
        .add_service(reflection().build_v1alpha()?)
        .add_service(learner)
        .add_service(checkpoints)
        .add_service(training)
        .serve_with_incoming_shutdown(incoming, shared.closing.clone().cancelled_owned())
        .await;
    reporting.abort();
    Ok(served?)
}
