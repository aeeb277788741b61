//! Scenarios: a net, its demand, a time of day, and the SUMO options its numbers depend on.
//!
//! A scenario is a directory with a `scenario.toml`. Paths in it are relative to that directory, or begin with `@deps/` for
//! files that the set-up fetched into `.deps`. Instead of files it may hold a `[generate]` table, from which they are built on
//! first use. A `[pin]` says what net and demand must hash to.

mod arrivals;
mod definition;
mod demand;
mod error;
mod search;

pub use arrivals::Arrivals;
pub use definition::{
    Benchmark, Reference, ReferenceMaxPressure, ReferenceOutgoing, ReferenceRange, SumoOptions,
};
pub use error::{PinMismatch, ScenarioError};
pub use search::{DEFINITION_FILE, SCENARIOS_VARIABLE, ScenarioEntry, ScenarioPath, place_for};

use definition::{Definition, Import, Pin};
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
        let definition = Definition::parse(&text, &path)?;
        let wrong = |message: String| ScenarioError::Parse { path: path.clone(), message };
        let name = match &definition.name {
            Some(name) => name.clone(),
            None => directory_name(directory).ok_or_else(|| {
                wrong("the directory has no name to call the scenario by; add name = \"...\"".into())
            })?,
        };
        let import = definition.import.as_ref();
        let resolve = |file: &String| resolve(&name, directory, file, import);
        let (net, routes) = match (&definition.net, definition.routes.as_slice(), &definition.generate) {
            (Some(net), routes @ [_, ..], None) => {
                (resolve(net)?, routes.iter().map(resolve).collect::<Result<Vec<_>, _>>()?)
            }
            (None, [], Some(generate)) => {
                let files = crate::generate::cached(&generate.grid, &search::generated(directory)).map_err(
                    |source| ScenarioError::Generate { scenario: name.clone(), source: Box::new(source) },
                )?;
                (files.net, vec![files.routes])
            }
            _ => return Err(wrong(definition.missing_files().to_owned())),
        };
        let additional = definition.additional.iter().map(resolve).collect::<Result<Vec<_>, _>>()?;
        let scenario = Self {
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
        };
        scenario.check(&definition.pin, definition.generate.is_some(), import.is_some())?;
        Ok(scenario)
    }

    fn check(&self, pin: &Pin, generated: bool, imported: bool) -> Result<(), ScenarioError> {
        let demand = self.routes.iter().chain(&self.additional).map(|path| path.display().to_string());
        let demand = demand.collect::<Vec<_>>().join(" and ");
        for (what, expected, found, files) in [
            ("net", &pin.net, &self.net_hash, self.net.display().to_string()),
            ("demand", &pin.demand, &self.demand_hash, demand),
        ] {
            let Some(expected) = expected.as_ref().filter(|expected| *expected != found) else { continue };
            return Err(ScenarioError::Pinned(Box::new(PinMismatch {
                scenario: self.name.clone(),
                what,
                files,
                expected: expected.clone(),
                found: found.clone(),
                remedy: match (generated, imported) {
                    (true, _) => "remove that folder and build it with the SUMO that `make build` installs",
                    (_, true) => {
                        "import it again from the published files, with the SUMO that `make build` installs"
                    }
                    _ => "restore the file",
                },
            })));
        }
        Ok(())
    }

    /// How many vehicles the demand sends in each minute from begin to end.
    ///
    /// # Errors
    /// [`ScenarioError::Read`] for a route file that cannot be read or is not XML.
    pub fn arrivals(&self) -> Result<Arrivals, ScenarioError> {
        Arrivals::count(&self.routes, self.begin, self.end)
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

/// Checks the text of a `scenario.toml` alone, without looking at the files that it names; `path` is how errors call it.
///
/// # Errors
/// [`ScenarioError::Parse`] names the line or key at fault.
pub fn check_definition(text: &str, path: &Path) -> Result<(), ScenarioError> {
    Definition::parse(text, path).map(drop)
}

/// All scenarios that [`Scenario::load`] knows by name.
#[must_use]
pub fn list() -> Vec<ScenarioEntry> {
    ScenarioPath::locate(None).list()
}

/// All scenarios that [`Scenario::load`] knows by name, and those that it would know after an import.
#[must_use]
pub fn catalogue() -> Vec<ScenarioEntry> {
    ScenarioPath::locate(None).catalogue()
}

/// Whether this is the definition of an import whose files are not there.
fn awaits_import(directory: &Path) -> bool {
    // A definition that cannot be read is a problem of its own, and is shown as one.
    let text = std::fs::read_to_string(directory.join(DEFINITION_FILE)).unwrap_or_default();
    let Ok(definition) = toml::from_str::<Definition>(&text) else { return false };
    let there = |file: &String| match file.strip_prefix(DEPS_PREFIX) {
        Some(relative) => search::in_deps(relative).is_some(),
        None => directory.join(file).is_file(),
    };
    definition.import.is_some() && !definition.net.iter().chain(&definition.routes).all(there)
}

fn directory_name(directory: &Path) -> Option<String> {
    let named = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    // `.` and `..` have no name of their own; the folder they mean has.
    named(directory).or_else(|| named(&directory.canonicalize().ok()?))
}

fn resolve(
    scenario: &str,
    directory: &Path,
    file: &str,
    import: Option<&Import>,
) -> Result<PathBuf, ScenarioError> {
    let in_deps = file.strip_prefix(DEPS_PREFIX);
    let path = match in_deps {
        Some(relative) => search::in_deps(relative),
        None => Some(directory.join(file)).filter(|path| path.is_file()),
    };
    path.ok_or_else(|| ScenarioError::MissingFile {
        scenario: scenario.to_owned(),
        file: in_deps.map_or_else(
            || directory.join(file).display().to_string(),
            |relative| format!(".deps/{relative}"),
        ),
        remedy: match (import, in_deps) {
            (Some(Import { cityflow }), _) => format!(
                "its data may not be passed on with the project: get {} and {} from their publishers and run `cross scenario \
                 import cityflow --roadnet {} --flow {} --name {scenario}`",
                cityflow.roadnet, cityflow.flow, cityflow.roadnet, cityflow.flow
            ),
            (None, Some(_)) => "run make build, which fetches it".to_owned(),
            (None, None) => "correct its scenario.toml or restore the file".to_owned(),
        },
    })
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
