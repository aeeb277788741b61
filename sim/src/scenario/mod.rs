//! Scenarios: a net, its demand, a time of day, and the SUMO options its numbers depend on.
//!
//! A scenario is a directory with a `scenario.toml`. Paths in it are relative to that directory, or begin with `@deps/` for
//! files that the set-up fetched into `.deps`.

mod definition;
mod demand;
mod error;
mod search;

pub use definition::{Reference, ReferenceMaxPressure, ReferenceOutgoing, ReferenceRange, SumoOptions};
pub use error::ScenarioError;
pub use search::{DEFINITION_FILE, SCENARIOS_VARIABLE, ScenarioEntry, ScenarioPath};

use definition::Definition;
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::{Path, PathBuf};

const DEPS_PREFIX: &str = "@deps/";

/// A scenario, its files resolved and hashed.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Its name.
    pub name: String,
    /// One sentence about it.
    pub description: String,
    /// Where its files come from.
    pub source: String,
    /// Directory of its definition.
    pub directory: PathBuf,
    /// SUMO net.
    pub net: PathBuf,
    /// SUMO route files.
    pub routes: Vec<PathBuf>,
    /// Further SUMO input files.
    pub additional: Vec<PathBuf>,
    /// Time at which an episode begins, seconds.
    pub begin: u32,
    /// Time until which there is demand, seconds.
    pub end: u32,
    /// SUMO options.
    pub sumo: SumoOptions,
    /// How published results were made.
    pub reference: Reference,
    /// SHA-256 of the net, 64 hex digits.
    pub net_hash: String,
    /// SHA-256 over the SHA-256 of each route file and then each additional file, 64 hex digits.
    pub demand_hash: String,
}

impl Scenario {
    /// Loads a scenario by name, from the places of [`ScenarioPath::locate`], or by directory.
    ///
    /// # Errors
    /// [`ScenarioError`]: unknown name, unreadable or wrong definition, missing files.
    pub fn load(name_or_directory: &str) -> Result<Self, ScenarioError> {
        ScenarioPath::locate(None).load(name_or_directory)
    }

    /// Loads the scenario in a directory.
    ///
    /// # Errors
    /// [`ScenarioError`]: unreadable or wrong definition, missing files.
    pub fn from_directory(directory: &Path) -> Result<Self, ScenarioError> {
        let path = directory.join(DEFINITION_FILE);
        let text = std::fs::read_to_string(&path)
            .map_err(|source| ScenarioError::Read { path: path.clone(), source })?;
        let wrong = |message: String| ScenarioError::Parse { path: path.clone(), message };
        let definition: Definition = toml::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        let name = match definition.name {
            Some(name) => name,
            None => directory_name(directory).ok_or_else(|| {
                wrong("the directory has no name to call the scenario by; add name = \"...\"".into())
            })?,
        };
        if definition.routes.is_empty() {
            return Err(wrong("routes is empty; name at least one route file".to_owned()));
        }
        if definition.end <= definition.begin {
            return Err(wrong(format!(
                "end is {}, which is not after begin, {}",
                definition.end, definition.begin
            )));
        }
        let resolve = |file: &String| resolve(&name, directory, file);
        let net = resolve(&definition.net)?;
        let routes = definition.routes.iter().map(resolve).collect::<Result<Vec<_>, _>>()?;
        let additional = definition.additional.iter().map(resolve).collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            net_hash: hex::encode(file_hash(&net)?),
            demand_hash: demand_hash(routes.iter().chain(&additional))?,
            name,
            description: definition.description,
            source: definition.source,
            directory: directory.to_owned(),
            net,
            routes,
            additional,
            begin: definition.begin,
            end: definition.end,
            sumo: definition.sumo,
            reference: definition.reference,
        })
    }

    /// Vehicles that the demand defines, counted in the route files: single vehicles and trips, plus what flows will
    /// send on average.
    ///
    /// # Errors
    /// [`ScenarioError::Read`] for a route file that cannot be read or is not XML.
    pub fn vehicles(&self) -> Result<u64, ScenarioError> {
        demand::vehicles(&self.routes, f64::from(self.begin), f64::from(self.end))
    }
}

/// All scenarios that [`Scenario::load`] knows by name.
#[must_use]
pub fn list() -> Vec<ScenarioEntry> {
    ScenarioPath::locate(None).list()
}

fn directory_name(directory: &Path) -> Option<String> {
    let named = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    // `.` and `..` have no name of their own; the folder they mean has.
    named(directory).or_else(|| named(&directory.canonicalize().ok()?))
}

fn resolve(scenario: &str, directory: &Path, file: &str) -> Result<PathBuf, ScenarioError> {
    let missing =
        |file: String, remedy| ScenarioError::MissingFile { scenario: scenario.to_owned(), file, remedy };
    if let Some(relative) = file.strip_prefix(DEPS_PREFIX) {
        return search::in_deps(relative)
            .ok_or_else(|| missing(format!(".deps/{relative}"), "run make build, which fetches it"));
    }
    let path = directory.join(file);
    if path.is_file() {
        Ok(path)
    } else {
        Err(missing(path.display().to_string(), "correct its scenario.toml or restore the file"))
    }
}

fn demand_hash<'a>(files: impl Iterator<Item = &'a PathBuf>) -> Result<String, ScenarioError> {
    let mut hasher = Sha256::new();
    for file in files {
        hasher.update(file_hash(file)?);
    }
    Ok(hex::encode(hasher.finalize()))
}

fn file_hash(path: &Path) -> Result<[u8; 32], ScenarioError> {
    let unreadable = |source| ScenarioError::Read { path: path.to_owned(), source };
    let mut file = std::fs::File::open(path).map_err(unreadable)?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok(hasher.finalize().into()),
            Ok(read) => hasher.update(&buffer[..read]),
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(unreadable(error)),
        }
    }
}
