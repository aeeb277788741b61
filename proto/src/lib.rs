//! The wire of CROSS: the `cross.v1` services and messages, and their conversions to domain types.
//!
//! ```text
//!   proto/cross/v1/*.proto ── generated/ ── v1, client, server
//!                                            │
//!   cross_sim Fragment <── fragment, packing ┤   every field checked before the learner sees it
//!   snapshot bytes     <── weights ──────────┤   chunks and their reassembly
//!   reasons, fields    <── status ───────────┘   errors with google.rpc details
//! ```
//! [`codec`] is prost's encoding, read with less bookkeeping. The generated code is committed, so that nobody needs a `protoc`; `tests/bootstrap.rs` keeps it equal to the schema.
//! `docs/protocol.md` tells how the messages follow each other.

pub mod codec;
pub mod fragment;
pub mod ids;
pub mod packing;
pub mod status;
mod violation;
pub mod weights;

pub use violation::Violation;

/// Version of this wire protocol; `Join` refuses any other.
///
/// It grows with every change after which old and new processes would misunderstand each other.
pub const PROTOCOL_VERSION: u32 = 1;

/// The encoded `google.protobuf.FileDescriptorSet` of `cross.v1` with its imports and comments, for reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!("generated/cross.v1.bin");

/// The encoded `google.protobuf.FileDescriptorSet` of `grpc.health.v1`, to be registered beside [`FILE_DESCRIPTOR_SET`].
pub const HEALTH_FILE_DESCRIPTOR_SET: &[u8] = tonic_health::pb::FILE_DESCRIPTOR_SET;

/// The encoded `google.protobuf.FileDescriptorSet` of `google.rpc`, to be registered likewise: a reflection client such as
/// grpcurl cannot print the details of an error otherwise.
pub const ERROR_FILE_DESCRIPTOR_SET: &[u8] = tonic_types::pb::FILE_DESCRIPTOR_SET;

/// Full names of the services, as health checks and reflection know them.
pub mod service {
    /// The learner as actors see it.
    pub const LEARNER: &str = "cross.v1.Learner";
    /// Checkpoints of the run.
    pub const CHECKPOINTS: &str = "cross.v1.Checkpoints";
    /// State of the training run.
    pub const TRAINING: &str = "cross.v1.Training";
    /// The three of them.
    pub const ALL: [&str; 3] = [LEARNER, CHECKPOINTS, TRAINING];
}

/// Messages and services of package `cross.v1`, generated from the schema.
#[allow(
    missing_docs,
    unreachable_pub,
    clippy::all,
    reason = "generated; its documentation is the comments of the .proto files"
)]
pub mod v1 {
    include!("generated/cross.v1.rs");
}

/// Clients of the three services.
pub mod client {
    pub use crate::v1::checkpoints_client::CheckpointsClient;
    pub use crate::v1::learner_client::LearnerClient;
    pub use crate::v1::training_client::TrainingClient;
}

/// The three services as a server implements them, and the wrappers that route to an implementation.
pub mod server {
    pub use crate::v1::checkpoints_server::{Checkpoints, CheckpointsServer};
    pub use crate::v1::learner_server::{Learner, LearnerServer};
    pub use crate::v1::training_server::{Training, TrainingServer};
}
