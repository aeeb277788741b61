//! Benchmarks: each measures ours and a baseline side by side, on one machine in one run, and gives a [`Report`].
//!
//! One file or folder a benchmark; what they share is the report and a way to tell how far they are. `cross bench` is
//! their command line.

pub mod cluster;
mod command_line;
mod cost;
pub mod env;
pub mod error;
mod folder;
pub mod ingest;
pub mod memory;
pub mod minute;
pub mod plain;
pub mod progress;
pub mod report;
pub mod traci;
pub mod update;
pub mod weights;

pub use error::BenchError;
pub use progress::Progress;
pub use report::{Better, Report, Row};
