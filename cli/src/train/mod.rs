//! `cross train`: one learner and its actors as child processes, from preflight to the closing table.
//!
//! ```text
//!   preflight ── everything that can be refused is refused before a process starts
//!   run_dir ──── config.toml, lock
//!   run ──────── the loop: supervise (rules) + cross_support::child (processes) + watch (signals, status) + progress (display)
//!   closing ──── evaluation beside Fixed-Time and Max-Pressure, result.json, curves.svg
//! ```

mod backoff;
pub(crate) mod closing;
pub(crate) mod curves;
pub(crate) mod preflight;
pub(crate) mod progress;
pub(crate) mod run;
pub(crate) mod run_dir;
mod supervise;
pub(crate) mod watch;
