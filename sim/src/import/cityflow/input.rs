//! Opening files that may be larger than memory.

use super::ImportError;
use std::fs::File;
use std::io::{BufReader, Read, Take};
use std::path::Path;

/// A reader that ends at the limit, for a file that was not longer when it was opened.
pub(super) fn open(path: &Path, limit: u64) -> Result<BufReader<Take<File>>, ImportError> {
    let unreadable = |source| ImportError::Read { path: path.to_owned(), source };
    let file = File::open(path).map_err(unreadable)?;
    let about = file.metadata().map_err(unreadable)?;
    if about.is_dir() {
        return Err(unreadable(std::io::ErrorKind::IsADirectory.into()));
    }
    if about.len() > limit {
        return Err(ImportError::TooLarge { path: path.to_owned(), limit });
    }
    // A pipe has no length; one that never ends is cut off here and refused as such.
    Ok(BufReader::with_capacity(1 << 16, file.take(limit)))
}
