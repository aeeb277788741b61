//! The text of a `scenario.toml`.

use super::ScenarioError;
use crate::generate::GridOptions;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Longest time between begin and end: demand is counted by the minute, and a typing error must not ask for all memory.
const MAX_SECONDS: u32 = 366 * 86_400;

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

impl Definition {
    /// Reads a definition and checks what can be checked without its files.
    pub(super) fn parse(text: &str, path: &Path) -> Result<Self, ScenarioError> {
        let wrong = |message: String| ScenarioError::Parse { path: path.to_owned(), message };
        let definition: Self =
            toml::from_str(text).map_err(|error| wrong(cross_config::toml_problem(text, &error)))?;
        if definition.end <= definition.begin {
            return Err(wrong(format!(
                "end is {}, which is not after begin, {}",
                definition.end, definition.begin
            )));
        }
        if definition.end - definition.begin > MAX_SECONDS {
            return Err(wrong(format!(
                "end is {}, more than a year ({MAX_SECONDS} s) after begin, {}; times are in seconds",
                definition.end, definition.begin
            )));
        }
        match (&definition.net, definition.routes.as_slice(), &definition.generate) {
            (Some(_), [_, ..], None) => {}
            (None, [], Some(generate)) => {
                generate.grid.validate().map_err(|error| wrong(error.to_string()))?;
            }
            _ => return Err(wrong(definition.missing_files().to_owned())),
        }
        Ok(definition)
    }

    /// What is wrong where neither files nor `[generate]` stand alone.
    pub(super) fn missing_files(&self) -> &'static str {
        match (&self.net, &self.generate) {
            (_, Some(_)) => "[generate] makes net and routes; take out either it or them",
            (None, None) => "net is missing; name a net, or add a [generate] table",
            (Some(_), None) => "routes is empty; name at least one route file",
        }
    }
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
