//! Copies of a run's checkpoints in an object store, or in any directory, by URL.
//!
//! ```text
//!   URL/run.json                                  whose checkpoints they are
//!   URL/checkpoints/000120/model.safetensors      as in a run directory
//!                          optimizer.safetensors
//!                          metadata.json          written last, removed first
//!                   damaged-000110/...            was found damaged; kept for a person to look at
//!                   latest                        id of the newest, moved last
//! ```
//! An object store has no rename, so the description takes its place: without `metadata.json` there is no checkpoint, and it
//! is written when all the rest is there. What it says of sizes and hashes is compared on every read, so that even a store
//! that loses an object is noticed.

mod client;
mod environment;
mod fetch;
#[cfg(test)]
mod tests;
mod trouble;

pub use fetch::{Fetched, resume};
pub use trouble::StoreTrouble;

use super::error::CheckpointError;
use super::metadata::Metadata;
use super::parcel::Parcel;
use super::reader::{Checkpoint, Entry, check, described, tensors_of};
use super::{FOLDER, LATEST_FILE, METADATA_FILE, MODEL_FILE, OPTIMIZER_FILE, updates_of};
use client::{Client, Object};
use cross_model::TrainerFiles;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Whose checkpoints they are.
const RUN_FILE: &str = "run.json";
/// Before the id of a checkpoint that was passed over as damaged: it is none any more, and a person can still look. Neither
/// retention nor the next checkpoint of that id touches it.
const DAMAGED: &str = "damaged-";

/// The checkpoints under one URL.
#[derive(Debug, Clone)]
pub struct Remote {
    client: Client,
}

impl Remote {
    /// The checkpoints under `url`, which is a run's: `s3://BUCKET/RUN`. Nothing is asked of the store yet.
    ///
    /// # Errors
    /// [`CheckpointError::Store`] if the URL or the environment makes no sense.
    pub fn open(url: &str) -> Result<Self, CheckpointError> {
        Ok(Self { client: Client::open(url)? })
    }

    /// The URL, without a slash at its end.
    #[must_use]
    pub fn url(&self) -> &str {
        self.client.url()
    }

    /// The URL of a checkpoint, as a path: what entries and errors show.
    #[must_use]
    pub fn path_of(&self, id: &str) -> PathBuf {
        PathBuf::from(self.client.url_of(&format!("{FOLDER}/{id}")))
    }

    /// Every checkpoint with its description, newest first.
    ///
    /// # Errors
    /// [`CheckpointError::Store`].
    pub async fn list(&self) -> Result<Vec<Entry>, CheckpointError> {
        let mut entries = Vec::new();
        for id in self.ids().await? {
            let metadata = match self.metadata(&id).await {
                Err(error @ CheckpointError::Store { .. }) => return Err(error),
                // Removed since: nothing to list.
                Err(CheckpointError::Missing { .. }) => continue,
                other => other,
            };
            entries.push(Entry { path: self.path_of(&id), id, metadata });
        }
        Ok(entries)
    }

    /// Ids of the checkpoints, newest first.
    pub(crate) async fn ids(&self) -> Result<Vec<String>, CheckpointError> {
        let whole = self.folders().await?;
        let whole =
            whole.into_iter().rev().filter(|(_, files)| files.iter().any(|name| name == METADATA_FILE));
        Ok(whole.map(|((_, id), _)| id).collect())
    }

    /// The run that the place belongs to, and ids of its checkpoints, newest first; refuses those of another run than `run_id`.
    async fn of_run(&self, run_id: Option<&str>) -> Result<(Option<String>, Vec<String>), CheckpointError> {
        let owner = self.owner().await?;
        if let (Some(got), Some(expected)) = (&owner, run_id)
            && got != expected
        {
            return Err(self.other_run(got.clone(), expected));
        }
        Ok((owner, self.ids().await?))
    }

    /// Everything that looks like a checkpoint, oldest first: by updates and id, its files' names.
    async fn folders(&self) -> Result<BTreeMap<(u64, String), Vec<String>>, CheckpointError> {
        let mut folders: BTreeMap<_, Vec<String>> = BTreeMap::new();
        for Object { name, .. } in self.client.list(FOLDER).await? {
            let parts: Vec<_> = name.split('/').collect();
            if let [_, id, file] = parts[..]
                && let Some(updates) = updates_of(id)
            {
                folders.entry((updates, id.to_owned())).or_default().push(file.to_owned());
            }
        }
        Ok(folders)
    }

    /// The id of a checkpoint that is there; `latest` means the one that was written last.
    ///
    /// # Errors
    /// [`CheckpointError::NotFound`] or [`CheckpointError::Store`].
    pub async fn find(&self, id: &str) -> Result<String, CheckpointError> {
        let not_found = || CheckpointError::NotFound {
            id: id.to_owned(),
            folder: PathBuf::from(self.client.url_of(FOLDER)),
        };
        let id = if id == LATEST_FILE { self.latest().await?.ok_or_else(not_found)? } else { id.to_owned() };
        // Only digits pass, so that no id can lead out of the folder.
        if updates_of(&id).is_none() || self.description(&id).await?.is_none() {
            return Err(not_found());
        }
        Ok(id)
    }

    /// What `latest` names.
    pub(crate) async fn latest(&self) -> Result<Option<String>, CheckpointError> {
        let text = self.client.get(&format!("{FOLDER}/{LATEST_FILE}")).await?;
        Ok(text.map(|text| String::from_utf8_lossy(&text).trim().to_owned()))
    }

    /// The description of a checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError`] names the object at fault.
    pub async fn metadata(&self, id: &str) -> Result<Metadata, CheckpointError> {
        self.described(id, &self.object(id, METADATA_FILE).await?)
    }

    /// The description that these bytes are, if it is the one of this checkpoint: a store, or who copies within it, may
    /// have mixed them up.
    fn described(&self, id: &str, description: &[u8]) -> Result<Metadata, CheckpointError> {
        let metadata = described(description, &self.path_of(id))?;
        if metadata.id != id || updates_of(id) != Some(metadata.updates) {
            return Err(CheckpointError::Foreign {
                path: self.path_of(id).join(METADATA_FILE),
                reason: format!("it is of checkpoint {:?} after {} updates", metadata.id, metadata.updates),
            });
        }
        Ok(metadata)
    }

    /// The checked bytes of a checkpoint's model file.
    ///
    /// # Errors
    /// [`CheckpointError`] names the object at fault.
    pub async fn model(&self, id: &str) -> Result<(Metadata, Vec<u8>), CheckpointError> {
        let metadata = self.metadata(id).await?;
        let model = self.checked(id, MODEL_FILE, &metadata).await?;
        tensors_of(&model, &self.path_of(id).join(MODEL_FILE))?;
        Ok((metadata, model))
    }

    /// A checkpoint, every file compared with its recorded size and hash.
    ///
    /// # Errors
    /// [`CheckpointError`] names the object at fault.
    pub async fn read(&self, id: &str) -> Result<Checkpoint, CheckpointError> {
        let Parcel { metadata, files, .. } = self.parcel(id).await?;
        let mut files: BTreeMap<_, _> = files.into_iter().collect();
        // A parcel has both.
        let mut take = |name: &str| files.remove(name).unwrap_or_default();
        let files = TrainerFiles { model: take(MODEL_FILE), optimizer: take(OPTIMIZER_FILE) };
        Ok(Checkpoint { path: self.path_of(id), metadata, files })
    }

    /// An object that is no checkpoint's: an exported policy.
    ///
    /// # Errors
    /// [`CheckpointError`] names the object.
    pub async fn file(&self, name: &str) -> Result<Vec<u8>, CheckpointError> {
        let bytes = self.client.get(name).await?.ok_or_else(|| CheckpointError::Missing {
            path: PathBuf::from(self.url()),
            file: name.to_owned(),
        })?;
        tensors_of(&bytes, &PathBuf::from(self.client.url_of(name)))?;
        Ok(bytes)
    }

    pub(crate) async fn parcel(&self, id: &str) -> Result<Parcel, CheckpointError> {
        let description = self.object(id, METADATA_FILE).await?;
        let metadata = self.described(id, &description)?;
        let mut files = Vec::new();
        for name in Parcel::names(&metadata, &self.path_of(id))? {
            let bytes = self.checked(id, &name, &metadata).await?;
            files.push((name, bytes));
        }
        Ok(Parcel { metadata, description, files })
    }

    /// Refuses a place that another run uses; where nobody does, writes there whose it is.
    pub(crate) async fn claim(&self, run_id: &str) -> Result<(), CheckpointError> {
        let owner = match self.owner().await? {
            None => {
                self.refuse_copies_of_others(run_id).await?;
                let text = serde_json::json!({ "run_id": run_id, "cross": env!("CARGO_PKG_VERSION") });
                if self.client.create(RUN_FILE, format!("{text}\n").into_bytes()).await? {
                    return Ok(());
                }
                // Somebody was faster: another run, or a try of ours of which the answer was lost.
                self.owner().await?
            }
            owner => owner,
        };
        match owner {
            Some(owner) if owner == run_id => Ok(()),
            other => Err(self.other_run(other.unwrap_or_else(|| "unknown".to_owned()), run_id)),
        }
    }

    /// Of a place without [`RUN_FILE`]: checkpoints that are there may be another run's.
    async fn refuse_copies_of_others(&self, run_id: &str) -> Result<(), CheckpointError> {
        let ids = self.ids().await?;
        let mut ours = ids.is_empty();
        for id in ids {
            match self.metadata(&id).await {
                Ok(metadata) if metadata.run_id == run_id => ours = true,
                Ok(metadata) => return Err(self.other_run(metadata.run_id, run_id)),
                // It does not say whose it is.
                Err(error) if error.is_corrupt() => {}
                Err(error) => return Err(error),
            }
        }
        if ours { Ok(()) } else { Err(self.other_run("unknown".to_owned(), run_id)) }
    }

    fn other_run(&self, got: String, expected: &str) -> CheckpointError {
        CheckpointError::OtherRun { url: self.url().to_owned(), got, expected: expected.to_owned() }
    }

    /// Refuses a place where there are checkpoints, or a run that will write some.
    ///
    /// # Errors
    /// [`CheckpointError::Occupied`] or [`CheckpointError::Store`].
    pub async fn refuse_used(&self) -> Result<(), CheckpointError> {
        let occupied = |run| CheckpointError::Occupied { url: self.url().to_owned(), run };
        match self.owner().await? {
            Some(run) => Err(occupied(run)),
            None if self.ids().await?.is_empty() => Ok(()),
            None => Err(occupied("unknown".to_owned())),
        }
    }

    /// The run that the place belongs to.
    async fn owner(&self) -> Result<Option<String>, CheckpointError> {
        let Some(text) = self.client.get(RUN_FILE).await? else { return Ok(None) };
        let value: serde_json::Value = serde_json::from_slice(&text).unwrap_or_default();
        Ok(Some(value["run_id"].as_str().unwrap_or("unknown").to_owned()))
    }

    /// Copies a checkpoint there and points `latest` at it. One that is there already, the same to the byte of its
    /// description, is not sent again.
    pub(crate) async fn upload(&self, parcel: &Parcel) -> Result<(), CheckpointError> {
        let id = &parcel.metadata.id;
        let there = self.description(id).await?;
        if there.as_ref() != Some(&parcel.description) {
            if there.is_some() {
                // Of a time before the run went back: its files are about to change under it.
                self.remove(id, METADATA_FILE).await?;
            }
            for (name, bytes) in &parcel.files {
                self.client.put(&format!("{FOLDER}/{id}/{name}"), bytes.clone()).await?;
            }
            self.client.put(&format!("{FOLDER}/{id}/{METADATA_FILE}"), parcel.description.clone()).await?;
        }
        if self.latest().await?.as_ref() != Some(id) {
            self.client.put(&format!("{FOLDER}/{LATEST_FILE}"), format!("{id}\n").into_bytes()).await?;
        }
        Ok(())
    }

    /// Removes the oldest checkpoints beyond those to keep, and what an interrupted upload or removal left. `latest` stays.
    pub(crate) async fn prune(&self, keep: usize, latest: &str) -> Result<(), CheckpointError> {
        let folders = self.folders().await?;
        let is_whole = |files: &[String]| files.iter().any(|name| name == METADATA_FILE);
        let whole = folders.values().filter(|files| is_whole(files)).count();
        let mut surplus = whole.saturating_sub(keep.max(1));
        for ((updates, id), files) in &folders {
            let newer = Some(*updates) > updates_of(latest);
            if id == latest || (newer && !is_whole(files)) {
                continue;
            }
            if is_whole(files) {
                if surplus == 0 {
                    continue;
                }
                surplus -= 1;
                // First: a checkpoint that is half removed must not look like one.
                self.remove(id, METADATA_FILE).await?;
            }
            for name in files.iter().filter(|name| *name != METADATA_FILE) {
                self.remove(id, name).await?;
            }
        }
        Ok(())
    }

    /// Makes a damaged checkpoint none, so that nobody trips over it, as `Store::go_on_from` does on the disk.
    pub(crate) async fn set_aside(&self, id: &str) -> Result<(), CheckpointError> {
        let objects = self.client.list(&format!("{FOLDER}/{id}")).await?;
        let described = format!("{FOLDER}/{id}/{METADATA_FILE}");
        // Without it a try that was interrupted has copied all there was, and retention clears the rest away.
        if objects.iter().all(|object| object.name != described) {
            return Ok(());
        }
        let aside = format!("{FOLDER}/{DAMAGED}{id}");
        for Object { name, .. } in self.client.list(&aside).await? {
            self.client.delete(&name).await?;
        }
        for Object { name, .. } in &objects {
            let file = name.rsplit('/').next().unwrap_or(name);
            self.client.copy(name, &format!("{aside}/{file}")).await?;
        }
        self.client.delete(&described).await?;
        for Object { name, .. } in objects.iter().filter(|object| object.name != described) {
            self.client.delete(name).await?;
        }
        Ok(())
    }

    /// A place in a store that takes so long to remove anything.
    #[cfg(test)]
    pub(crate) fn slow_to_remove(time: std::time::Duration) -> Self {
        Self { client: Client::slow_to_remove(time) }
    }

    async fn description(&self, id: &str) -> Result<Option<Vec<u8>>, CheckpointError> {
        self.client.get(&format!("{FOLDER}/{id}/{METADATA_FILE}")).await
    }

    async fn remove(&self, id: &str, name: &str) -> Result<(), CheckpointError> {
        self.client.delete(&format!("{FOLDER}/{id}/{name}")).await
    }

    async fn object(&self, id: &str, name: &str) -> Result<Vec<u8>, CheckpointError> {
        let got = self.client.get(&format!("{FOLDER}/{id}/{name}")).await?;
        got.ok_or_else(|| CheckpointError::Missing { path: self.path_of(id), file: name.to_owned() })
    }

    async fn checked(&self, id: &str, name: &str, metadata: &Metadata) -> Result<Vec<u8>, CheckpointError> {
        let bytes = self.object(id, name).await?;
        check(&bytes, name, metadata, &self.path_of(id))?;
        Ok(bytes)
    }
}

/// What a URL of a checkpoint or a policy means.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Named {
    /// A run: its newest checkpoint.
    Run(String),
    /// A checkpoint of a run.
    Checkpoint(String, String),
    /// A policy file: the place, and its name there.
    File(String, String),
}

/// Takes `s3://BUCKET/RUN`, `s3://BUCKET/RUN/checkpoints/000120` (or `.../latest`) and `s3://BUCKET/policy.safetensors` apart;
/// `None` for what is no URL but a path.
#[must_use]
pub fn named(text: &str) -> Option<Named> {
    if !text.contains("://") {
        return None;
    }
    let text = text.trim_end_matches('/');
    Some(match text.rsplit_once('/') {
        Some((folder, id))
            if (updates_of(id).is_some() || id == LATEST_FILE) && folder.ends_with(&format!("/{FOLDER}")) =>
        {
            let run = folder.strip_suffix(FOLDER).unwrap_or(folder).trim_end_matches('/');
            Named::Checkpoint(run.to_owned(), id.to_owned())
        }
        Some((folder, file)) if file.ends_with(".safetensors") => {
            Named::File(folder.to_owned(), file.to_owned())
        }
        _ => Named::Run(text.to_owned()),
    })
}

/// The policy bytes that a URL stands for, as `reader::load_policy` gives them for a path.
///
/// # Errors
/// [`CheckpointError`] names the object at fault.
pub async fn load_policy(url: &Named) -> Result<(Option<Metadata>, Vec<u8>), CheckpointError> {
    let (run, id) = match url {
        Named::File(folder, file) => return Ok((None, Remote::open(folder)?.file(file).await?)),
        Named::Checkpoint(run, id) => (run, id.as_str()),
        Named::Run(run) => (run, LATEST_FILE),
    };
    let remote = Remote::open(run)?;
    let id = remote.find(id).await?;
    remote.model(&id).await.map(|(metadata, bytes)| (Some(metadata), bytes))
}
