//! The committed inputs.

use crate::Target;
use std::io;
use std::path::{Path, PathBuf};

/// Where the inputs of all targets are, each in a folder of its name.
#[must_use]
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

/// The inputs that a target begins with, in a fixed order: those of our own writers, then the files.
///
/// # Errors
/// Any of reading the files; a target without a folder has none.
pub fn inputs(target: &Target) -> io::Result<Vec<Vec<u8>>> {
    let mut inputs = (target.written)();
    let folder = folder().join(target.name);
    if folder.is_dir() {
        let mut files = std::fs::read_dir(folder)?
            .map(|entry| entry.map(|entry| entry.path()))
            .collect::<Result<Vec<_>, _>>()?;
        files.sort();
        for file in files {
            inputs.push(std::fs::read(file)?);
        }
    }
    Ok(inputs)
}
