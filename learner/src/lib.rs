//! The learner: takes trajectory fragments from actors, trains on them, publishes weights, keeps checkpoints.
//!
//! ```text
//!            service/ (gRPC)                coordinator/                 trainer.rs (own thread)
//!  actors ── fragments ── decode, check ──> admission/ ── round ──────> PPO update ──> checkpoint/
//!     ^                                        │                            │          metrics_log.rs
//!     ├────────── acknowledgements, episodes ──┘                            │
//!     └────────── weights (publish.rs) <────────────────────────────────────┘
//! ```
//! mirror.rs copies what checkpoint/ holds to an object store, on the asynchronous side, and training never waits for it.
//!
//! [`admission`] holds the rules and does no I/O; the coordinator owns it and does what it commands; the trainer thread
//! alone touches libtorch and the disk. [`checkpoint`] is also how other programs read what a learner wrote.

mod admin;
pub mod admission;
pub mod checkpoint;
mod coordinator;
mod learner;
pub mod metrics_log;
mod mirror;
pub mod publish;
pub mod run_dir;
mod service;
pub mod telemetry;
mod trainer;

pub use coordinator::{Ending, Life};
pub use learner::{
    Learner, ScenarioLayout, Setup, StartError, fetch_checkpoint, find_checkpoint, load_scenarios,
};
pub use mirror::MirrorSetup;
