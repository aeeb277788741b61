//! Traffic-signal control on SUMO: scenarios, signals, observation, reward, metrics and rule-based controllers.
//!
//! ```text
//!   scenario.toml ── scenario ──> net ──> layout ─┬─> signal ──┐
//!                                                 └─> lanes ───┼─> env <──> SUMO
//!                                           controller <── observe ──> metrics ──> evaluate
//! ```

pub mod controller;
pub mod env;
pub mod error;
pub mod evaluate;
pub mod generate;
pub mod import;
pub mod lanes;
pub mod layout;
pub mod metrics;
pub mod net;
pub mod observe;
pub mod preset;
pub mod scenario;
pub mod signal;
pub mod trajectory;
mod xml;

pub use error::SimError;
