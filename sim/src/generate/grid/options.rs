//! What a grid may be made of.

use crate::generate::GenerateError;
use crate::generate::demand::Demand;
use serde::{Deserialize, Serialize};

/// Largest number of columns or rows.
pub const MAX_SIDE: u32 = 50;
/// Largest number of lanes of a road in one direction.
pub const MAX_LANES: u32 = 8;

/// A grid of streets (east-west) and avenues (north-south) with a traffic light at every crossing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridOptions {
    /// Avenues, from west to east.
    pub columns: u32,
    /// Streets, from south to north.
    pub rows: u32,
    /// Distance between crossings, metres.
    pub spacing: f64,
    /// Distance from the outermost crossings to the dead ends where vehicles come from and go to, metres.
    pub fringe: f64,
    /// Share of the roads that are left out, as far as every crossing keeps three arms and all can be reached; 0 is a whole
    /// grid.
    pub closed: f64,
    /// How far a crossing may lie from where a regular grid has it, metres east or west and north or south.
    pub jitter: f64,
    /// The east-west roads.
    pub streets: RoadOptions,
    /// The north-south roads.
    pub avenues: RoadOptions,
    /// Whether vehicles may turn right on red after a stop.
    pub right_on_red: bool,
    /// Whether roads of one lane have a phase for left turns alone, besides the one in which these yield.
    pub protected_left: bool,
    /// Duration of every green of the nets' own program, seconds.
    pub green_seconds: u32,
    /// Duration of every yellow of the nets' own program, seconds.
    pub yellow_seconds: u32,
    /// Who drives where and when.
    pub demand: Demand,
    /// Seed of everything random: in the demand, and which roads are left out and crossings moved.
    pub seed: u64,
}

/// One kind of road; both directions are alike.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoadOptions {
    /// Lanes in each direction.
    pub lanes: u32,
    /// Speed limit, m/s.
    pub speed: f64,
}

impl Default for GridOptions {
    fn default() -> Self {
        Self {
            columns: 5,
            rows: 5,
            spacing: 200.0,
            fringe: 200.0,
            closed: 0.0,
            jitter: 0.0,
            streets: RoadOptions { lanes: 2, speed: 20.0 },
            avenues: RoadOptions { lanes: 1, speed: 11.0 },
            right_on_red: false,
            protected_left: false,
            green_seconds: 30,
            yellow_seconds: 3,
            demand: Demand::default(),
            seed: 0,
        }
    }
}

impl GridOptions {
    /// Refuses what makes no grid, or one that no machine could simulate.
    ///
    /// # Errors
    /// [`GenerateError::Option`] names the option and what it may be.
    pub fn validate(&self) -> Result<(), GenerateError> {
        whole("columns", self.columns, 1..=MAX_SIDE)?;
        whole("rows", self.rows, 1..=MAX_SIDE)?;
        // Shorter roads would vanish between the corners of two junctions, and longer ones are no town.
        measure("spacing", self.spacing, 40.0, 100_000.0)?;
        measure("fringe", self.fringe, 40.0, 100_000.0)?;
        for (name, road) in [("streets", &self.streets), ("avenues", &self.avenues)] {
            whole(&format!("{name}.lanes"), road.lanes, 1..=MAX_LANES)?;
            measure(&format!("{name}.speed"), road.speed, 1.0, 100.0)?;
        }
        measure("closed", self.closed, 0.0, 0.5)?;
        let nominal = self.spacing.min(self.fringe);
        // Farther, and two roads of a crossing could meet at too sharp an angle.
        measure("jitter", self.jitter, 0.0, nominal / 4.0)?;
        // A junction is as wide as its roads, and wider where they meet askew; something must remain between two of them.
        let askew = if self.jitter > 0.0 { 1.5 } else { 1.0 };
        let widest = askew * 2.0 * f64::from(self.streets.lanes.max(self.avenues.lanes)) * super::LANE_WIDTH;
        let shortest = nominal - 2.0 * self.jitter;
        if shortest < widest + 20.0 {
            return Err(GenerateError::Option {
                what: format!(
                    "roads of {shortest} m are too short between junctions {widest:.1} m wide; enlarge spacing and \
                     fringe, or take fewer lanes or less jitter"
                ),
            });
        }
        whole("green_seconds", self.green_seconds, 1..=3600)?;
        whole("yellow_seconds", self.yellow_seconds, 0..=60)?;
        self.demand.validate(self)
    }
}

/// Refuses a whole number outside a range.
pub(crate) fn whole(
    name: &str,
    value: u32,
    range: std::ops::RangeInclusive<u32>,
) -> Result<(), GenerateError> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(GenerateError::Option {
        what: format!("{name} is {value} but must be between {} and {}", range.start(), range.end()),
    })
}

/// Refuses a number outside a range, and what is none.
fn measure(name: &str, value: f64, least: f64, most: f64) -> Result<(), GenerateError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(GenerateError::Option { what: format!("{name} is {value} but must be between {least} and {most}") })
}
