//! Metrics of an episode, as the field's papers define them.
//!
//! ```text
//!   Env, each second ── SecondMeter ──> queue length, speed, completion rate, teleports ─┐
//!   SUMO's tripinfo file ── TripTotals ──> trip time, delay, duration, time loss, ... ───┴─> EpisodeMetrics
//! ```
//! [`Metric`] names each one with unit and better direction; `docs/metrics.md` has the formulas.

mod episode;
mod metric;
mod moments;
mod seconds;
mod trips;

pub use episode::{EpisodeMetrics, Vehicles};
pub use metric::{Better, Metric};
pub use moments::{MeanStd, Moments};
pub use seconds::SecondMeter;
pub use trips::{TripInfoError, TripTotals};
