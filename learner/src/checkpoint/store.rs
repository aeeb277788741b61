//! Writing checkpoints so that no crash, at any moment, leaves half of one.

use super::error::CheckpointError;
use super::metadata::{FileInfo, Metadata};
use super::parcel::Parcel;
use super::{FOLDER, LATEST_FILE, METADATA_FILE, MODEL_FILE, OPTIMIZER_FILE, id, updates_of};
use cross_model::TrainerFiles;
use cross_support::files::{ASIDE, remove_any, replace_file, sync_directory, write_synced};
use std::io;
use std::path::{Path, PathBuf};

/// The checkpoints of one run, for the one process that writes them.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    keep: usize,
    /// Writes and synchronises a file. A field so that tests can fill the disk.
    write: fn(&Path, &[u8]) -> io::Result<()>,
}

impl Store {
    /// Opens the folder in a run directory, and clears away what an earlier process left half-written.
    ///
    /// # Errors
    /// [`CheckpointError::Io`].
    pub fn open(run: &Path, keep: usize) -> Result<Self, CheckpointError> {
        let folder = run.join(FOLDER);
        std::fs::create_dir_all(&folder).map_err(CheckpointError::io("create", &folder))?;
        let store = Self { folder, keep: keep.max(1), write: write_synced };
        for name in store.names()? {
            if name.starts_with(ASIDE) {
                let path = store.folder.join(name);
                remove_any(&path).map_err(CheckpointError::io("remove", &path))?;
            }
        }
        Ok(store)
    }

    /// As it is, with another way to write files.
    #[cfg(test)]
    pub(super) fn writing_with(mut self, write: fn(&Path, &[u8]) -> io::Result<()>) -> Self {
        self.write = write;
        self
    }

    /// Writes a checkpoint, points `latest` at it, and removes the oldest beyond those to keep. `metadata.id` and
    /// `metadata.files` are filled in here.
    ///
    /// # Errors
    /// [`CheckpointError::Io`]; all earlier checkpoints are then as they were, and readable.
    pub fn write(&self, files: &TrainerFiles, mut metadata: Metadata) -> Result<String, CheckpointError> {
        let id = id(metadata.updates);
        metadata.id.clone_from(&id);
        metadata.files = [(MODEL_FILE, &files.model), (OPTIMIZER_FILE, &files.optimizer)]
            .into_iter()
            .map(|(name, bytes)| (name.to_owned(), FileInfo::of(bytes)))
            .collect();
        // Plain data serialises.
        let description = serde_json::to_vec_pretty(&metadata).expect("metadata serialises");
        self.place(
            &id,
            [
                (MODEL_FILE, &files.model[..]),
                (OPTIMIZER_FILE, &files.optimizer),
                (METADATA_FILE, &description),
            ],
        )?;
        self.point_latest(&id)?;
        self.prune(&id);
        Ok(id)
    }

    /// Puts a checkpoint that came from elsewhere into the folder, as it is. `latest` stays where it is, until
    /// [`go_on_from`](Self::go_on_from) moves it.
    ///
    /// # Errors
    /// [`CheckpointError::Io`]; all other checkpoints are then as they were.
    pub(super) fn install(&self, parcel: &Parcel) -> Result<PathBuf, CheckpointError> {
        let id = id(parcel.metadata.updates);
        let files = parcel.files.iter().map(|(name, bytes)| (name.as_str(), &bytes[..]));
        self.place(&id, files.chain([(METADATA_FILE, &parcel.description[..])]))?;
        Ok(self.folder.join(id))
    }

    /// Writes a checkpoint's files aside and gives them their name in one step.
    fn place<'a>(
        &self,
        id: &str,
        files: impl IntoIterator<Item = (&'a str, &'a [u8])>,
    ) -> Result<(), CheckpointError> {
        let aside = self.folder.join(format!("{ASIDE}{id}"));
        let written = self.fill(&aside, files).and_then(|()| self.move_in(&aside, id));
        if written.is_err() {
            // The failure that matters is the first one; what stays is cleared away at the next start.
            let _ = std::fs::remove_dir_all(&aside);
        }
        written
    }

    fn fill<'a>(
        &self,
        aside: &Path,
        files: impl IntoIterator<Item = (&'a str, &'a [u8])>,
    ) -> Result<(), CheckpointError> {
        remove_any(aside).map_err(CheckpointError::io("remove", aside))?;
        std::fs::create_dir(aside).map_err(CheckpointError::io("create", aside))?;
        for (name, bytes) in files {
            let path = aside.join(name);
            (self.write)(&path, bytes).map_err(CheckpointError::io("write", &path))?;
        }
        sync_directory(aside).map_err(CheckpointError::io("synchronise", aside))
    }

    /// Gives the written directory its name. One of that name can only be there if the run went back to an earlier
    /// checkpoint, which is done only when this one was of no use.
    fn move_in(&self, aside: &Path, id: &str) -> Result<(), CheckpointError> {
        let path = self.folder.join(id);
        let replaced = self.folder.join(format!("{ASIDE}{id}-replaced"));
        if path.exists() {
            std::fs::rename(&path, &replaced).map_err(CheckpointError::io("rename", &path))?;
        }
        std::fs::rename(aside, &path).map_err(CheckpointError::io("rename", aside))?;
        sync_directory(&self.folder).map_err(CheckpointError::io("synchronise", &self.folder))?;
        remove_any(&replaced).map_err(CheckpointError::io("remove", &replaced))
    }

    /// After a resumption from `id`: renames the newer checkpoints, which were damaged and passed over, so that nobody trips
    /// over them and a person can still look, and has `latest` name the one in use. It may name another one even if none was
    /// damaged: a process can be killed between the two steps of writing a checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError::Io`].
    pub fn go_on_from(&self, id: &str) -> Result<(), CheckpointError> {
        for name in self.names()? {
            if updates_of(&name) > updates_of(id) {
                let path = self.folder.join(&name);
                let damaged = self.folder.join(format!("damaged-{name}"));
                remove_any(&damaged).map_err(CheckpointError::io("remove", &damaged))?;
                std::fs::rename(&path, &damaged).map_err(CheckpointError::io("rename", &path))?;
            }
        }
        // Looked at first, so that a run on a full disk can still be resumed.
        match std::fs::read_to_string(self.folder.join(LATEST_FILE)) {
            Ok(latest) if latest.trim() == id => Ok(()),
            _ => self.point_latest(id),
        }
    }

    fn point_latest(&self, id: &str) -> Result<(), CheckpointError> {
        let latest = self.folder.join(LATEST_FILE);
        replace_file(&latest, format!("{id}\n").as_bytes()).map_err(CheckpointError::io("write", &latest))
    }

    /// Removes the oldest checkpoints. A failure costs disk space and nothing else, so it is only logged.
    fn prune(&self, latest: &str) {
        let Ok(names) = self.names() else { return };
        let mut ids: Vec<(u64, String)> =
            names.into_iter().filter_map(|name| Some((updates_of(&name)?, name))).collect();
        ids.sort();
        let surplus = ids.len().saturating_sub(self.keep);
        for (_, id) in ids.into_iter().filter(|(_, id)| id != latest).take(surplus) {
            let (path, aside) = (self.folder.join(&id), self.folder.join(format!("{ASIDE}{id}")));
            // Renamed first: a checkpoint that is half removed must not look like one.
            let removed = std::fs::rename(&path, &aside).and_then(|()| std::fs::remove_dir_all(&aside));
            if let Err(error) = removed {
                tracing::warn!(checkpoint = %path.display(), "cannot remove an old checkpoint: {error}");
            }
        }
    }

    fn names(&self) -> Result<Vec<String>, CheckpointError> {
        let io = || CheckpointError::io("list", &self.folder);
        let mut names = Vec::new();
        for entry in std::fs::read_dir(&self.folder).map_err(io())? {
            names.push(entry.map_err(io())?.file_name().to_string_lossy().into_owned());
        }
        Ok(names)
    }
}
