//! Writing files so that a reader, or a crash, never meets half of one.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

/// Prefix of files and directories that are being written or removed; what still bears it at a start is half of something.
pub const ASIDE: &str = ".aside-";

/// Writes a new file and has the disk keep it before returning.
///
/// # Errors
/// As the operating system says.
pub fn write_synced(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// Replaces a file in one step: readers see the old content or the new one, after a crash too.
///
/// # Errors
/// As the operating system says; then the old content is still there.
pub fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut aside = tempfile::Builder::new().prefix(ASIDE).tempfile_in(folder)?;
    aside.write_all(bytes)?;
    aside.as_file().sync_all()?;
    // A temporary file is its owner's alone; what replaces an ordinary file is for everyone who may read the folder.
    set_readable(aside.as_file())?;
    aside.persist(path).map_err(|error| error.error)?;
    sync_directory(folder)
}

/// Removes a file, or a directory with all that is in it, if there is one.
///
/// # Errors
/// As the operating system says.
pub fn remove_any(path: &Path) -> io::Result<()> {
    let removed = match std::fs::symlink_metadata(path) {
        Ok(found) if found.is_dir() => std::fs::remove_dir_all(path),
        Ok(_) => std::fs::remove_file(path),
        Err(error) => Err(error),
    };
    match removed {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

fn set_readable(file: &File) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(std::fs::Permissions::from_mode(0o644))
}

/// Has the disk keep a directory's entries.
///
/// # Errors
/// As the operating system says.
pub fn sync_directory(path: &Path) -> io::Result<()> {
    File::open(path)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.json");
        replace_file(&path, b"old").unwrap();
        replace_file(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_that_cannot_be_written_stays_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("there");
        std::fs::create_dir_all(path.join("in the way")).unwrap();
        assert!(replace_file(&path, b"new").is_err());
        assert!(path.join("in the way").is_dir());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_is_not_there_is_removed_too() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("a/b")).unwrap();
        for _ in 0..2 {
            remove_any(&folder.path().join("a")).unwrap();
        }
        assert!(!folder.path().join("a").exists());
    }
}
