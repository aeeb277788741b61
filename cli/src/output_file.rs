//! A file that a command writes its result to: found unwritable before the work, written whole after it.

use crate::failure::{Failure, Outcome};
use anyhow::Context;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A path that could be written to when it was prepared.
#[derive(Debug)]
pub(crate) struct OutputFile {
    path: PathBuf,
    /// Whether it is a file of its own, which is replaced; otherwise a device or a pipe, which is written to.
    regular: bool,
}

impl OutputFile {
    /// Checks that a file can be written here. What is there stays as it is.
    pub(crate) fn prepare(path: &Path) -> Outcome<Self> {
        let refuse = |why: String| Err(Failure::input(format!("cannot write {}: {why}", path.display())));
        // Through links, so that the file they lead to is replaced and not the link.
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let there = std::fs::metadata(&path).ok();
        if there.as_ref().is_some_and(std::fs::Metadata::is_dir) || path.file_name().is_none() {
            return refuse("it is a folder; name a file in it".to_owned());
        }
        let regular = there.as_ref().is_none_or(std::fs::Metadata::is_file);
        // Opened without truncating: the old result is worth keeping until the new one is there. A pipe is left alone: its
        // reader would take the closing for the end.
        if there.is_some()
            && regular
            && let Err(error) = std::fs::OpenOptions::new().write(true).open(&path)
        {
            return refuse(format!("{error}; name another file"));
        }
        if regular && let Err(error) = temporary(&path) {
            let folder = folder(&path);
            return match folder.is_dir() {
                true => refuse(format!("{} in its folder; name a file in another one", error.kind())),
                false => refuse(format!("the folder {} does not exist; make it first", folder.display())),
            };
        }
        Ok(Self { path, regular })
    }

    /// Where it is.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Writes all of it or, if that fails, nothing.
    pub(crate) fn write(&self, bytes: &[u8]) -> Outcome<()> {
        let written = if self.regular {
            temporary(&self.path).and_then(|mut file| {
                file.write_all(bytes)?;
                file.persist(&self.path).map_err(|error| error.error).map(drop)
            })
        } else {
            std::fs::OpenOptions::new()
                .write(true)
                .open(&self.path)
                .and_then(|mut file| file.write_all(bytes))
        };
        Ok(written.with_context(|| format!("cannot write {}", self.path.display()))?)
    }
}

/// A new file beside this one, which goes unless it is kept.
fn temporary(path: &Path) -> std::io::Result<NamedTempFile> {
    // Whoever may read other files of the user's may read this one.
    let everybody = std::fs::Permissions::from_mode(0o666);
    tempfile::Builder::new().prefix(".cross-").permissions(everybody).tempfile_in(folder(path))
}

/// The folder that a file is in.
fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure::BAD_INPUT;

    #[test]
    fn a_new_file_is_written_whole_and_alone() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("result.csv");
        let file = OutputFile::prepare(&path).unwrap();
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0, "nothing is there before the result");
        file.write(b"a,b\n").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"a,b\n");
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_old_file_stays_until_it_is_replaced() {
        let place = tempfile::tempdir().unwrap();
        let (path, link) = (place.path().join("old"), place.path().join("link"));
        std::fs::write(&path, "old and long").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let file = OutputFile::prepare(&link).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"old and long");
        file.write(b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(link.is_symlink());
    }

    #[test]
    fn a_device_is_written_to_and_not_replaced() {
        let file = OutputFile::prepare(Path::new("/dev/null")).unwrap();
        file.write(b"gone").unwrap();
        assert!(!std::fs::metadata("/dev/null").unwrap().is_file());
    }

    #[test]
    fn what_cannot_be_written_is_bad_input_with_the_reason() {
        let place = tempfile::tempdir().unwrap();
        std::fs::write(place.path().join("file"), "").unwrap();
        for (path, part) in [
            (place.path().to_owned(), "folder"),
            (place.path().join("no/such/result.csv"), "does not exist"),
            (place.path().join("file/result.csv"), "does not exist"),
            (PathBuf::from("/"), "folder"),
            (PathBuf::from("/proc/result.csv"), "another one"),
            (PathBuf::new(), "folder"),
        ] {
            let failure = OutputFile::prepare(&path).unwrap_err();
            assert_eq!(failure.code(), BAD_INPUT, "{}", path.display());
            assert!(failure.to_string().contains(part), "{failure}");
        }
    }
}
