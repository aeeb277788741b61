//! The CROSS model on libtorch: features, networks, losses, PPO and snapshots.
//!
//! ```text
//!  Observation ──features──> Sample ──batch──> Batch ──net──> Forward ──losses──> gradients ──adam──> parameters
//!     (counts)   (per agent)        (packed by          (GFE, PCC,                                        │
//!                                    phase count)        MoE, heads)                    snapshot <────────┘
//! ```
//! [`Trainer`] learns from [`Fragment`](cross_sim::trajectory::Fragment)s and is owned by one thread of the learner;
//! [`Policy`] acts, and is owned by the simulator thread of an actor. Nothing here is asynchronous.

pub mod adam;
mod average;
pub mod batch;
pub mod error;
pub mod features;
pub mod gae;
mod guard;
mod inference;
pub mod losses;
pub mod net;
pub mod params;
pub mod placement;
pub mod plain;
pub mod policy;
pub mod rounds;
pub mod routing;
pub mod snapshot;
pub mod stats;
pub mod trainer;
pub mod value_scale;
mod vector;

pub use average::average;
pub use error::ModelError;
pub use placement::{Abilities, Placement};
pub use plain::PlainPolicy;
pub use policy::{ActMode, Decision, Policy};
pub use routing::Routing;
pub use stats::{ScenarioStats, UpdateStats};
pub use trainer::{Trainer, TrainerFiles};

/// One libtorch thread for this process.
///
/// Two OpenMP threads on a machine whose cores are busy made one small forward pass 150 times slower.
pub fn set_single_threaded() {
    tch::set_num_threads(1);
}

/// The version of libtorch that this crate is built for; the build refuses any other.
#[must_use]
pub fn libtorch_version() -> &'static str {
    "2.11.0"
}
