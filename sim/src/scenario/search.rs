//! Where scenarios and downloaded maps are looked for.

use super::{Scenario, ScenarioError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const DEPS: &str = ".deps";
/// Name of a scenario's definition inside its directory.
pub const DEFINITION_FILE: &str = "scenario.toml";
/// Environment variable with more scenario directories, separated as in `PATH`.
pub const SCENARIOS_VARIABLE: &str = "CROSS_SCENARIOS";

/// Folder in `.deps` where scenarios go that the user made here and does not keep elsewhere.
const MADE_HERE: &str = "scenarios";
/// Folder in `.deps` for files built from `[generate]` tables.
const GENERATED: &str = "generated";

/// Directories that hold scenarios, in order of preference.
#[derive(Debug, Clone)]
pub struct ScenarioPath {
    roots: Vec<PathBuf>,
}

/// A scenario that was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScenarioEntry {
    /// What to call it.
    pub name: String,
    /// Directory of its definition.
    pub directory: PathBuf,
}

impl ScenarioPath {
    /// `option` first, then `$CROSS_SCENARIOS`, then a `scenarios` folder beside or above the running program, then one
    /// beside or above the current directory, then what was generated or imported here without saying where to.
    #[must_use]
    pub fn locate(option: Option<&Path>) -> Self {
        let mut roots: Vec<PathBuf> = option.map(Path::to_owned).into_iter().collect();
        if let Some(variable) = std::env::var_os(SCENARIOS_VARIABLE) {
            roots.extend(std::env::split_paths(&variable).filter(|path| !path.as_os_str().is_empty()));
        }
        roots.extend(ancestors().map(|folder| folder.join("scenarios")));
        roots.extend(ancestors().map(|folder| folder.join(DEPS).join(MADE_HERE)));
        roots.retain(|root| root.is_dir());
        Self { roots }
    }

    /// Loads a scenario by name or by directory.
    ///
    /// # Errors
    /// [`ScenarioError::Unknown`] lists the known names; otherwise as [`Scenario::from_directory`].
    pub fn load(&self, name_or_directory: &str) -> Result<Scenario, ScenarioError> {
        let as_path = Path::new(name_or_directory);
        // A path separator, or `.`, can only mean a directory; a bare name is looked up first, so that a folder which
        // happens to have the same name in the current directory does not shadow the scenario.
        let bare = as_path.components().count() == 1 && !name_or_directory.starts_with('.');
        if bare {
            let found = self.roots.iter().map(|root| root.join(name_or_directory));
            if let Some(directory) = found.into_iter().find(|path| path.join(DEFINITION_FILE).is_file()) {
                return Scenario::from_directory(&directory);
            }
        }
        if as_path.join(DEFINITION_FILE).is_file() || (!bare && as_path.is_dir()) {
            return Scenario::from_directory(as_path);
        }
        Err(ScenarioError::Unknown {
            name: name_or_directory.to_owned(),
            known: self.list().into_iter().map(|entry| entry.name).collect(),
        })
    }

    /// Every scenario in these directories, by name, but for those whose files the user has not imported yet; the first
    /// directory that has a name wins.
    #[must_use]
    pub fn list(&self) -> Vec<ScenarioEntry> {
        let mut entries = self.catalogue();
        entries.retain(|entry| !super::awaits_import(&entry.directory));
        entries
    }

    /// As [`ScenarioPath::list`], with those that await an import.
    #[must_use]
    pub fn catalogue(&self) -> Vec<ScenarioEntry> {
        let mut found = BTreeMap::new();
        for root in &self.roots {
            // A folder that vanished since it was located holds no scenarios.
            let Ok(entries) = std::fs::read_dir(root) else { continue };
            for entry in entries.flatten() {
                let directory = entry.path();
                if directory.join(DEFINITION_FILE).is_file() {
                    found.entry(entry.file_name().to_string_lossy().into_owned()).or_insert(directory);
                }
            }
        }
        found.into_iter().map(|(name, directory)| ScenarioEntry { name, directory }).collect()
    }
}

/// Where a scenario of this name goes that is made here: in the nearest `.deps`, or in `scenarios` below the current
/// directory where there is none.
#[must_use]
pub fn place_for(name: &str) -> PathBuf {
    deps().unwrap_or_default().join(MADE_HERE).join(name)
}

/// Where files built from a definition in `directory` go: in the nearest `.deps`, or beside the definition.
pub(super) fn generated(directory: &Path) -> PathBuf {
    deps().unwrap_or_else(|| directory.to_owned()).join(GENERATED)
}

fn deps() -> Option<PathBuf> {
    ancestors().map(|folder| folder.join(DEPS)).find(|path| path.is_dir())
}

/// The `.deps` file or folder of this relative path, in the nearest `.deps` that has it.
pub(super) fn in_deps(relative: &str) -> Option<PathBuf> {
    ancestors().map(|folder| folder.join(DEPS).join(relative)).find(|path| path.exists())
}

/// Folders above the running program, then the current directory and those above it.
fn ancestors() -> impl Iterator<Item = PathBuf> {
    let above = |path: PathBuf| path.ancestors().map(Path::to_owned).collect::<Vec<_>>();
    let program = std::env::current_exe().ok().and_then(|path| path.parent().map(Path::to_owned));
    let current = std::env::current_dir().ok();
    program.into_iter().chain(current).flat_map(above)
}
