//! The text of a `scenario.toml`.

use crate::generate::GridOptions;
use serde::{Deserialize, Serialize};

/// What a `scenario.toml` may say; unknown keys are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Definition {
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) description: String,
    #[serde(default)]
    pub(super) source: String,
    #[serde(default)]
    pub(super) net: Option<String>,
    #[serde(default)]
    pub(super) routes: Vec<String>,
    #[serde(default)]
    pub(super) additional: Vec<String>,
    #[serde(default)]
    pub(super) begin: u32,
    pub(super) end: u32,
    #[serde(default)]
    pub(super) sumo: SumoOptions,
    #[serde(default)]
    pub(super) reference: Reference,
    /// What to build net and routes from, instead of naming them.
    pub(super) generate: Option<Generate>,
    /// Which files of the user's the net and routes were imported from.
    pub(super) import: Option<Import>,
    /// What net and demand must hash to.
    #[serde(default)]
    pub(super) pin: Pin,
}

/// A net and a demand that are built here.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Generate {
    pub(super) grid: GridOptions,
}

/// Files in another simulator's format that only the user has.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Import {
    /// Names of CityFlow's two files, as their publishers call them.
    pub(super) cityflow: CityFlowFiles,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CityFlowFiles {
    pub(super) roadnet: String,
    pub(super) flow: String,
}

/// Hashes that the files must have; published figures hold for these alone.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Pin {
    pub(super) net: Option<String>,
    pub(super) demand: Option<String>,
}

/// SUMO options on which published numbers depend.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SumoOptions {
    /// Seconds of standing after which a vehicle is moved on; -1 never.
    pub time_to_teleport: f64,
    /// Speed at departure of vehicles that do not say, as SUMO's `departSpeed` (metres per second or a word).
    pub depart_speed: String,
    /// Lane of departure of vehicles that do not say, as SUMO's `departLane` (an index or a word).
    pub depart_lane: String,
}

impl Default for SumoOptions {
    fn default() -> Self {
        // The defaults of the SUMO versions the published numbers come from; newer ones depart faster and elsewhere.
        Self { time_to_teleport: -1.0, depart_speed: "0".to_owned(), depart_lane: "first".to_owned() }
    }
}

/// How published results on this scenario were made.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Reference {
    /// Benchmark whose map it is, or is like; none for a network of one's own.
    pub benchmark: Option<Benchmark>,
    /// Variant of Max-Pressure that reproduces the paper's row.
    pub max_pressure: ReferenceMaxPressure,
}

/// Where a map comes from. Benchmarks have protocols of their own: [`Preset`](crate::preset::Preset).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Benchmark {
    /// RESCO (Ault and Sharon, 2021).
    Resco,
    /// RESCO's arterial4x4, which it took from MA2C and decides upon twice as often as on its other maps.
    RescoArterial,
    /// MA2C (Chu et al., 2019).
    Ma2c,
    /// CityFlow's data sets.
    Cityflow,
}

/// A variant of Max-Pressure: what counts against a phase on its outgoing lanes, and how far detectors reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReferenceMaxPressure {
    /// Vehicles counted on outgoing lanes.
    pub outgoing: ReferenceOutgoing,
    /// Reach of the counts.
    pub range: ReferenceRange,
}

/// Vehicles that Max-Pressure counts on outgoing lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReferenceOutgoing {
    /// All vehicles.
    All,
    /// Stopped vehicles.
    #[default]
    Stopped,
}

/// Part of a lane on which Max-Pressure counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReferenceRange {
    /// All of it.
    #[default]
    WholeLane,
    /// Its last 50 m.
    Last50m,
}
