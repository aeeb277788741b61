//! What every process of CROSS does the same way: files written whole, the admin port, TLS and tokens.
//!
//! ```text
//!   files        a reader, or a crash, never meets half of one
//!   admin        /metrics (with process), /ready, /live
//!   options ──> pem, token ──> server ── incoming ──> gRPC and admin ports
//!                         └──> client ──────────────> endpoint, bearer token
//!   problem      what a failed handshake means, in words
//! ```
//! It knows nothing of traffic, learning or libtorch. Secrets are held in types that do not print them.

pub mod admin;
pub mod client;
mod error;
pub mod files;
pub mod incoming;
pub mod options;
mod pem;
pub mod problem;
mod process;
pub mod server;
pub mod token;

pub use error::SecurityError;
