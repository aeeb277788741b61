//! Making scenarios: grids with their demand, built by SUMO's `netconvert`.
//!
//! ```text
//!   GridOptions ─┬─ grid ── nodes, edges, connections, programs ── netconvert ──> net.xml ─┐
//!                └─ demand ── flows and trips ─────────────────────────────────> rou.xml ─┴─> folder
//! ```
//! The same options give the same plain files on every machine, and the same net with the same version of netconvert.

mod cache;
mod demand;
mod error;
pub(crate) mod folder;
pub(crate) mod grid;
pub(crate) mod netconvert;
pub(crate) mod plain;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod properties;
pub(crate) mod xml;

pub use cache::GeneratedFiles;
pub(crate) use cache::cached;
pub use demand::Demand;
pub use error::GenerateError;
pub use grid::{GridOptions, MAX_LANES, MAX_SIDE, RoadOptions};

use cross_traci::sumo::SumoHome;
use folder::NewFolder;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Name of the net in a folder that was made here.
pub const NET_FILE: &str = "net.net.xml";
/// Name of the route file in a folder that was made here.
pub const ROUTES_FILE: &str = "demand.rou.xml";

/// What a new scenario is called and where it goes.
#[derive(Debug, Clone, PartialEq)]
pub struct NewScenario {
    /// Its name.
    pub name: String,
    /// One sentence about it.
    pub description: String,
    /// How it was made.
    pub source: String,
    /// Its folder, which must not exist yet.
    pub folder: PathBuf,
    /// Whether a scenario that is there already is replaced.
    pub replace: bool,
    /// Time until which it is simulated, seconds.
    pub end: u32,
    /// Seconds of standing after which SUMO moves a vehicle on; -1 never.
    pub time_to_teleport: f64,
}

/// Generates a grid as a scenario folder and returns the folder's path.
///
/// # Errors
/// [`GenerateError`]: impossible options, an existing folder, no netconvert, or a disk that cannot be written.
pub fn generate_grid(
    home: &SumoHome,
    options: &GridOptions,
    new: &NewScenario,
) -> Result<PathBuf, GenerateError> {
    options.validate()?;
    let folder = NewFolder::start(&new.folder, new.replace)?;
    build_grid(home, options, folder.path())?;
    write_definition(folder.path(), new)?;
    folder.finish()
}

/// Writes net and routes of a grid into a folder.
fn build_grid(home: &SumoHome, options: &GridOptions, folder: &Path) -> Result<(), GenerateError> {
    let network = grid::network(options);
    build_net(home, &network, folder)?;
    netconvert::write(&folder.join(ROUTES_FILE), |file| demand::write(options, file))
}

/// Builds the net of a folder; what netconvert needs and leaves goes to a temporary place.
pub(crate) fn build_net(
    home: &SumoHome,
    network: &plain::PlainNet,
    folder: &Path,
) -> Result<(), GenerateError> {
    let work = tempfile::Builder::new().prefix(".netconvert-").tempdir_in(folder);
    let work = work.map_err(GenerateError::write(folder))?;
    netconvert::build(home, network, work.path(), &folder.join(NET_FILE))?;
    work.close().map_err(GenerateError::write(folder))
}

/// The text of a `scenario.toml` for files that were made here.
#[derive(Serialize)]
struct Definition<'a> {
    name: &'a str,
    description: &'a str,
    source: &'a str,
    net: &'a str,
    routes: [&'a str; 1],
    begin: u32,
    end: u32,
    sumo: crate::scenario::SumoOptions,
}

pub(crate) fn write_definition(folder: &Path, new: &NewScenario) -> Result<(), GenerateError> {
    let definition = Definition {
        name: &new.name,
        description: &new.description,
        source: &new.source,
        net: NET_FILE,
        routes: [ROUTES_FILE],
        begin: 0,
        end: new.end,
        sumo: crate::scenario::SumoOptions {
            time_to_teleport: new.time_to_teleport,
            ..crate::scenario::SumoOptions::default()
        },
    };
    let path = folder.join(crate::scenario::DEFINITION_FILE);
    let text = toml::to_string(&definition)
        .map_err(|error| GenerateError::Write { path: path.clone(), source: std::io::Error::other(error) })?;
    std::fs::write(&path, text).map_err(GenerateError::write(&path))
}
