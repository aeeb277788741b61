//! What can be wrong with a configuration.

use std::path::PathBuf;

/// A configuration that cannot be used, in one sentence for the person who wrote it.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("cannot read the configuration {}: {source}; check the path given with --config", path.display())]
    Read {
        /// File that was asked for.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Syntax error, unknown key, or a value of the wrong type.
    #[error("the configuration {origin} is not valid: {message}; every key is in docs/configuration.md")]
    Parse {
        /// File or source of the text.
        origin: String,
        /// The parser's message, with line and key.
        message: String,
    },
    /// A value that cannot work.
    #[error("{} {key} {problem}", place(origin.as_deref()))]
    Invalid {
        /// File or source of the text; none of a configuration that was not read.
        origin: Option<String>,
        /// Dotted key, as in the file.
        key: &'static str,
        /// What is wrong and what to do.
        problem: String,
    },
}

impl ConfigError {
    /// An [`ConfigError::Invalid`].
    pub(crate) fn invalid(key: &'static str, problem: impl Into<String>) -> Self {
        Self::Invalid { origin: None, key, problem: problem.into() }
    }

    /// The same, of a text with a name.
    pub(crate) fn of(self, text: &str) -> Self {
        match self {
            Self::Invalid { key, problem, .. } => {
                Self::Invalid { origin: Some(text.to_owned()), key, problem }
            }
            other => other,
        }
    }
}

fn place(origin: Option<&str>) -> String {
    match origin {
        Some(origin) => format!("in the configuration {origin} the key"),
        None => "the configuration key".to_owned(),
    }
}

/// `Ok` if the value lies in the closed range, else an error that names the key and the range.
pub(crate) fn in_range<T>(key: &'static str, value: T, low: T, high: T) -> Result<(), ConfigError>
where
    T: PartialOrd + std::fmt::Display + Copy,
{
    // Written so that NaN fails.
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(ConfigError::invalid(key, format!("is {value}; it must lie between {low} and {high}")))
    }
}
