//! Scenario folders that appear complete or not at all.

use super::GenerateError;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A folder under way; its files are in a hidden sibling until [`NewFolder::finish`].
pub(crate) struct NewFolder {
    target: PathBuf,
    draft: TempDir,
    replace: bool,
}

impl NewFolder {
    /// Starts it. What is at `target` stays until the end, and only goes then if `replace` says so.
    pub(crate) fn start(target: &Path, replace: bool) -> Result<Self, GenerateError> {
        if !replace && target.exists() {
            return Err(GenerateError::Exists { path: target.to_owned() });
        }
        let parent = match target.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        std::fs::create_dir_all(parent).map_err(GenerateError::write(parent))?;
        let draft = tempfile::Builder::new()
            .prefix(".making-")
            .tempdir_in(parent)
            .map_err(GenerateError::write(parent))?;
        Ok(Self { target: target.to_owned(), draft, replace })
    }

    /// Where its files are written.
    pub(crate) fn path(&self) -> &Path {
        self.draft.path()
    }

    /// Gives it its name.
    pub(crate) fn finish(self) -> Result<PathBuf, GenerateError> {
        let Self { target, draft, replace } = self;
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // Drafts are private; what others may read is theirs to read.
            let readable = std::fs::Permissions::from_mode(0o755);
            std::fs::set_permissions(draft.path(), readable).map_err(GenerateError::write(draft.path()))?;
        }
        let old = replace.then(|| set_aside(&target)).transpose()?.flatten();
        match std::fs::rename(draft.path(), &target) {
            Ok(()) => {
                // Its place is taken by the new name; there is nothing left to remove.
                let _ = draft.keep();
                if let Some(old) = old {
                    std::fs::remove_dir_all(&old).map_err(GenerateError::write(&old))?;
                }
                Ok(target)
            }
            Err(_) if target.exists() => Err(GenerateError::Exists { path: target }),
            Err(source) => Err(GenerateError::Write { path: target, source }),
        }
    }
}

/// Moves what is at `target` out of the way and tells where it is now.
fn set_aside(target: &Path) -> Result<Option<PathBuf>, GenerateError> {
    if !target.exists() {
        return Ok(None);
    }
    // Only what a scenario was made of is replaced: a mistyped --out must not cost a home directory.
    if !target.join(crate::scenario::DEFINITION_FILE).is_file() {
        return Err(GenerateError::Option {
            what: format!("{} is no scenario, so it is not replaced; give another --out", target.display()),
        });
    }
    let mut name = target.file_name().unwrap_or_default().to_owned();
    name.push(format!(".replaced-{}", std::process::id()));
    let aside = target.with_file_name(name);
    std::fs::rename(target, &aside).map_err(GenerateError::write(&aside))?;
    Ok(Some(aside))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_abandoned_draft_leaves_nothing() {
        let place = tempfile::tempdir().unwrap();
        drop(NewFolder::start(&place.path().join("town"), false).unwrap());
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0);
    }

    #[test]
    fn what_exists_is_only_replaced_on_request_and_only_if_it_is_a_scenario() {
        let place = tempfile::tempdir().unwrap();
        let town = place.path().join("town");
        std::fs::create_dir(&town).unwrap();
        std::fs::write(town.join("diary.txt"), "mine").unwrap();
        assert!(matches!(NewFolder::start(&town, false), Err(GenerateError::Exists { .. })));
        let error = NewFolder::start(&town, true).unwrap().finish().unwrap_err().to_string();
        assert!(error.contains("is no scenario"), "{error}");
        assert!(town.join("diary.txt").exists());
        std::fs::write(town.join("scenario.toml"), "").unwrap();
        let new = NewFolder::start(&town, true).unwrap();
        std::fs::write(new.path().join("scenario.toml"), "new").unwrap();
        new.finish().unwrap();
        assert_eq!(std::fs::read_to_string(town.join("scenario.toml")).unwrap(), "new");
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 1);
    }

    #[test]
    fn whoever_is_first_wins() {
        let place = tempfile::tempdir().unwrap();
        let town = place.path().join("town");
        let (first, second) =
            (NewFolder::start(&town, false).unwrap(), NewFolder::start(&town, false).unwrap());
        std::fs::write(first.path().join("file"), "1").unwrap();
        std::fs::write(second.path().join("file"), "2").unwrap();
        first.finish().unwrap();
        assert!(matches!(second.finish(), Err(GenerateError::Exists { .. })));
        assert_eq!(std::fs::read_to_string(town.join("file")).unwrap(), "1");
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 1);
    }
}
