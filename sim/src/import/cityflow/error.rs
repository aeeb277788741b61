//! What can be wrong with CityFlow's files.

use crate::generate::GenerateError;
use crate::net::NetError;
use std::path::{Path, PathBuf};

/// Files that cannot be imported. Every variant names the file.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// It cannot be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is larger than any city's.
    #[error("{} is larger than the {limit} bytes that are read of such a file; split it", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Bytes.
        limit: u64,
    },
    /// The text ends too early.
    #[error("{} is cut off in line {line}; get it again", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Where.
        line: usize,
    },
    /// It is no JSON.
    #[error("{} is not JSON: {message}", path.display())]
    NotJson {
        /// The file.
        path: PathBuf,
        /// The parser's words, with line and column.
        message: String,
    },
    /// JSON, but not of this kind.
    #[error("{} is not a CityFlow {kind} file: {message}", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// `roadnet` or `flow`.
        kind: &'static str,
        /// The parser's words, with line and column.
        message: String,
    },
    /// It contradicts itself, the other file, or what SUMO can do.
    #[error("cannot import {}: {what}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong, naming the road, lane, intersection or flow.
        what: String,
    },
    /// The scenario cannot be made.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// The net that was built cannot be read back.
    #[error(transparent)]
    Net(#[from] NetError),
}

impl ImportError {
    pub(super) fn content(path: &Path, what: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), what: what.into() }
    }

    /// What the JSON parser says, told apart.
    pub(super) fn json(path: &Path, kind: &'static str, error: &serde_json::Error) -> Self {
        let (path, message) = (path.to_owned(), error.to_string());
        match error.classify() {
            serde_json::error::Category::Io => {
                let kind = error.io_error_kind().unwrap_or(std::io::ErrorKind::Other);
                Self::Read { path, source: std::io::Error::new(kind, message) }
            }
            serde_json::error::Category::Eof => Self::Truncated { path, line: error.line() },
            serde_json::error::Category::Syntax => Self::NotJson { path, message },
            serde_json::error::Category::Data => Self::Shape { path, kind, message },
        }
    }
}
