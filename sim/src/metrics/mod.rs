//! Metrics of an episode, as the field's papers define them.
//!
//! ```text
//!   Env, each second ── SecondMeter ──> queue length, speed, completion rate, teleports ─┐
//!   SUMO's tripinfo file ── TripTotals ──> trip time, delay, duration, CO2, fuel, ... ───┴─> EpisodeMetrics
//! ```
//! [`Metric`] names each one with unit, formula, source and better direction; `docs/metrics.md` tells what each leaves out.

mod definition;
mod episode;
pub(crate) mod keyed;
mod metric;
mod moments;
mod seconds;
mod tripinfo;
mod trips;

pub use definition::{Definition, definitions};
pub use episode::{EpisodeMetrics, Vehicles};
pub use metric::{Better, Metric};
pub use moments::{MeanStd, Moments};
pub use seconds::SecondMeter;
pub use tripinfo::{Emissions, Fate, Trip, TripInfoError, parse_trips, read_trips};
pub use trips::TripTotals;
