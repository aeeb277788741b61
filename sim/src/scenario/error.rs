//! Errors of finding and reading scenarios.

use std::path::PathBuf;

/// A scenario that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// No directory holds it.
    #[error(
        "there is no scenario {name:?}; known are: {}; name one of them or a directory with a scenario.toml",
        if known.is_empty() { "none (no scenarios directory was found)".to_owned() } else { known.join(", ") }
    )]
    Unknown {
        /// As asked for.
        name: String,
        /// Names that were found.
        known: Vec<String>,
    },
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The definition is not what it should be.
    #[error("cannot use {}: {message}", path.display())]
    Parse {
        /// The scenario.toml.
        path: PathBuf,
        /// What is wrong, with line and key.
        message: String,
    },
    /// A file that the definition names does not exist.
    #[error("scenario {scenario:?} needs {file}, which does not exist; {remedy}")]
    MissingFile {
        /// Name of the scenario.
        scenario: String,
        /// The file, as written or as resolved.
        file: String,
        /// What to do.
        remedy: String,
    },
    /// A file is not the one that the definition pins.
    #[error(transparent)]
    Pinned(Box<PinMismatch>),
    /// Net and demand cannot be built.
    #[error("cannot build scenario {scenario:?}: {source}")]
    Generate {
        /// Name of the scenario.
        scenario: String,
        /// Why.
        source: Box<crate::generate::GenerateError>,
    },
}

/// A net or demand that has another hash than the definition pins.
#[derive(Debug, thiserror::Error)]
#[error(
    "the {what} of scenario {scenario:?}, {files}, has the hash {found} instead of {expected}; {remedy}, or take [pin] out of \
     its scenario.toml and compare with no published figures"
)]
pub struct PinMismatch {
    /// Name of the scenario.
    pub scenario: String,
    /// `net` or `demand`.
    pub what: &'static str,
    /// Where it was read from.
    pub files: String,
    /// Hash in the definition.
    pub expected: String,
    /// Hash of the files.
    pub found: String,
    /// What to do.
    pub remedy: &'static str,
}
