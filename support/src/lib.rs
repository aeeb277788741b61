//! What every process of CROSS does the same way: files written whole, the admin port, TLS and tokens.
//!
//! ```text
//!   files        a reader, or a crash, never meets half of one
//!   admin        /metrics (with process, threads), /ready, /live
//!   options ──> pem, token ──> server ── incoming ──> gRPC and admin ports
//!                         └──> client ──────────────> endpoint, bearer token
//!                                   places: how many, patience: silent for how long
//!   problem      what a failed handshake means, in words
//!   open_files   how many connections fit
//!   proc         processes and threads, as the kernel tells of them: process, threads
//!   child        processes that are started and end with this one
//! ```
//! It knows nothing of traffic, learning or libtorch. Secrets are held in types that do not print them.

pub mod admin;
pub mod child;
pub mod client;
mod error;
pub mod files;
pub mod incoming;
pub mod open_files;
pub mod options;
mod patience;
mod pem;
mod places;
pub mod problem;
pub mod proc;
mod process;
pub mod server;
mod threads;
pub mod token;

pub use error::SecurityError;
