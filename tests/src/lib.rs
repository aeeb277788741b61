//! Helpers of the cluster tests: the built programs, small runs of them, and what the machine says about processes.
//!
//! Nothing is mocked: tests start `cross`, which starts the learner, the actors and SUMO. Waiting is for events with
//! generous deadlines, never for a time to pass.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a helper that fails ends its test, and its message is the report"
)]

pub mod binaries;
pub mod certificates;
pub mod faults;
pub mod grpcurl;
pub mod http;
pub mod packages;
pub mod page;
pub mod processes;
pub mod prometheus;
pub mod runs;
pub mod s3;
pub mod scenarios;
pub mod tools;
pub mod wait;
