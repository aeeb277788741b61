//! Finding, checking and reading checkpoints; what `cross checkpoint`, evaluation and `--resume` use.

use super::error::CheckpointError;
use super::metadata::{FileInfo, Metadata};
use super::parcel::Parcel;
use super::{FOLDER, LATEST_FILE, METADATA_FILE, MODEL_FILE, OPTIMIZER_FILE, updates_of};
use cross_model::TrainerFiles;
use cross_support::files::replace_file;
use safetensors::SafeTensors;
use std::io;
use std::path::{Path, PathBuf};

/// A checkpoint that was found; its description may still be unreadable.
#[derive(Debug)]
pub struct Entry {
    /// Its id.
    pub id: String,
    /// Its directory.
    pub path: PathBuf,
    /// Its description.
    pub metadata: Result<Metadata, CheckpointError>,
}

/// A checkpoint, read and checked.
#[derive(Debug)]
pub struct Checkpoint {
    /// Its directory.
    pub path: PathBuf,
    /// Its description.
    pub metadata: Metadata,
    /// Weights and optimiser state.
    pub files: TrainerFiles,
}

impl Checkpoint {
    /// The same, if both its files are well-formed safetensors files besides matching their hashes.
    ///
    /// # Errors
    /// [`CheckpointError::Foreign`] names the file at fault.
    pub fn well_formed(self) -> Result<Self, CheckpointError> {
        tensors_of(&self.files.model, &self.path.join(MODEL_FILE))?;
        tensors_of(&self.files.optimizer, &self.path.join(OPTIMIZER_FILE))?;
        Ok(self)
    }
}

/// What `--resume` found.
#[derive(Debug)]
pub struct Resumed {
    /// The newest checkpoint that can be used.
    pub checkpoint: Checkpoint,
    /// Newer ones that cannot, with what is wrong, newest first.
    pub skipped: Vec<CheckpointError>,
}

/// A tensor of a model file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tensor {
    /// Its name.
    pub name: String,
    /// Type of its elements, as safetensors writes it.
    pub dtype: String,
    /// Its shape.
    pub shape: Vec<usize>,
}

/// The checkpoints of a run directory, newest first. A run without any has an empty list.
///
/// # Errors
/// [`CheckpointError::Io`] if the folder cannot be listed.
pub fn list(run: &Path) -> Result<Vec<Entry>, CheckpointError> {
    let mut ids = ids(&run.join(FOLDER))?;
    ids.reverse();
    Ok(ids
        .into_iter()
        .map(|(_, id)| {
            let path = run.join(FOLDER).join(&id);
            Entry { metadata: metadata(&path), id, path }
        })
        .collect())
}

/// Ids in a folder with their updates, oldest first.
fn ids(folder: &Path) -> Result<Vec<(u64, String)>, CheckpointError> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(CheckpointError::io("list", folder)(error)),
    };
    let mut ids = Vec::new();
    for entry in entries {
        let name = entry.map_err(CheckpointError::io("list", folder))?.file_name();
        let name = name.to_string_lossy().into_owned();
        if let Some(updates) = updates_of(&name) {
            ids.push((updates, name));
        }
    }
    ids.sort();
    Ok(ids)
}

/// The directory of a run's checkpoint by id; `latest` means the one that was written last.
///
/// # Errors
/// [`CheckpointError::NotFound`] or [`CheckpointError::Io`].
pub fn find(run: &Path, id: &str) -> Result<PathBuf, CheckpointError> {
    let folder = run.join(FOLDER);
    let not_found = || CheckpointError::NotFound { id: id.to_owned(), folder: folder.clone() };
    let id = if id == LATEST_FILE {
        let path = folder.join(LATEST_FILE);
        match std::fs::read_to_string(&path) {
            Ok(text) => text.trim().to_owned(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(not_found()),
            Err(error) => return Err(CheckpointError::io("read", &path)(error)),
        }
    } else {
        id.to_owned()
    };
    // Only digits pass, so that no id can lead out of the folder.
    let path = folder.join(&id);
    if updates_of(&id).is_some() && path.is_dir() { Ok(path) } else { Err(not_found()) }
}

/// The description of the checkpoint in this directory, without a look at its large files.
///
/// # Errors
/// [`CheckpointError`] names the file at fault.
pub fn metadata(checkpoint: &Path) -> Result<Metadata, CheckpointError> {
    described(&read_file(checkpoint, METADATA_FILE)?, checkpoint)
}

/// The description that these bytes are.
pub(super) fn described(bytes: &[u8], checkpoint: &Path) -> Result<Metadata, CheckpointError> {
    let path = checkpoint.join(METADATA_FILE);
    let text = std::str::from_utf8(bytes)
        .map_err(|_| CheckpointError::Foreign { path: path.clone(), reason: "it is not text".to_owned() })?;
    Metadata::parse(text, &path)
}

/// A checkpoint's files as they lie there, checked.
///
/// # Errors
/// [`CheckpointError`] names the file at fault.
pub(crate) fn parcel(checkpoint: &Path) -> Result<Parcel, CheckpointError> {
    let description = read_file(checkpoint, METADATA_FILE)?;
    let metadata = described(&description, checkpoint)?;
    let files = Parcel::names(&metadata, checkpoint)?
        .into_iter()
        .map(|name| Ok((name.clone(), checked(checkpoint, &name, &metadata)?)))
        .collect::<Result<_, CheckpointError>>()?;
    Ok(Parcel { metadata, description, files })
}

/// Reads a checkpoint and compares every file with its recorded size and hash.
///
/// # Errors
/// [`CheckpointError`] names the file at fault.
pub fn read(checkpoint: &Path) -> Result<Checkpoint, CheckpointError> {
    let metadata = metadata(checkpoint)?;
    let model = checked(checkpoint, MODEL_FILE, &metadata)?;
    let optimizer = checked(checkpoint, OPTIMIZER_FILE, &metadata)?;
    Ok(Checkpoint { path: checkpoint.to_owned(), metadata, files: TrainerFiles { model, optimizer } })
}

/// Checks a checkpoint as [`read`] does, and that both its files are well-formed safetensors files.
///
/// # Errors
/// [`CheckpointError`] names the file at fault.
pub fn verify(checkpoint: &Path) -> Result<Metadata, CheckpointError> {
    Ok(read(checkpoint)?.well_formed()?.metadata)
}

/// The checked bytes of a checkpoint's model file.
///
/// # Errors
/// [`CheckpointError`] names the file at fault.
pub fn model(checkpoint: &Path) -> Result<(Metadata, Vec<u8>), CheckpointError> {
    let metadata = metadata(checkpoint)?;
    let model = checked(checkpoint, MODEL_FILE, &metadata)?;
    Ok((metadata, model))
}

/// The tensors of a checkpoint's model file, by name.
///
/// # Errors
/// [`CheckpointError`] names the file at fault.
pub fn tensors(checkpoint: &Path) -> Result<Vec<Tensor>, CheckpointError> {
    let (_, model) = model(checkpoint)?;
    tensors_of(&model, &checkpoint.join(MODEL_FILE))
}

/// Writes a checkpoint's checked model file to `out`, in one step.
///
/// # Errors
/// [`CheckpointError`] names the file at fault; `out` is then as it was.
pub fn export(checkpoint: &Path, out: &Path) -> Result<Metadata, CheckpointError> {
    let (metadata, model) = model(checkpoint)?;
    replace_file(out, &model).map_err(CheckpointError::io("write", out))?;
    Ok(metadata)
}

/// The policy bytes that `path` stands for, for `Policy::from_snapshot`: a run directory (its latest checkpoint), that run's
/// `checkpoints/latest`, a checkpoint directory, or an exported safetensors file.
///
/// # Errors
/// [`CheckpointError`] names the file at fault.
pub fn load_policy(path: &Path) -> Result<(Option<Metadata>, Vec<u8>), CheckpointError> {
    // It looks like one more checkpoint, and whoever names it means the one it names.
    if path.ends_with(Path::new(FOLDER).join(LATEST_FILE))
        && let Some(run) = path.ancestors().nth(2)
    {
        return model(&find(run, LATEST_FILE)?).map(|(metadata, bytes)| (Some(metadata), bytes));
    }
    if path.is_file() {
        let bytes = std::fs::read(path).map_err(CheckpointError::io("read", path))?;
        tensors_of(&bytes, path)?;
        return Ok((None, bytes));
    }
    let checkpoint = if path.join(FOLDER).is_dir() { find(path, LATEST_FILE)? } else { path.to_owned() };
    model(&checkpoint).map(|(metadata, bytes)| (Some(metadata), bytes))
}

/// The newest usable checkpoint of a run, `None` if it has none at all.
///
/// A damaged one is passed over for the one before it: losing some updates is better than losing the run. What was passed
/// over is returned, for the caller to be loud about. One that is not damaged, but cannot be used now, is never passed over:
/// a person can mend that and lose nothing.
///
/// # Errors
/// [`CheckpointError::Incompatible`] if the configuration is another one, [`CheckpointError::NoneUsable`] if all are damaged,
/// [`CheckpointError::Io`] or [`CheckpointError::FormatVersion`] if the newest undamaged one cannot be read.
pub fn resume(run: &Path, compatibility_hash: &str) -> Result<Option<Resumed>, CheckpointError> {
    let folder = run.join(FOLDER);
    let ids = ids(&folder)?;
    let count = ids.len();
    let mut skipped = Vec::new();
    for (_, id) in ids.into_iter().rev() {
        match read(&folder.join(id)) {
            Ok(checkpoint) => {
                let got = &checkpoint.metadata.compatibility_hash;
                if got != compatibility_hash {
                    let (got, expected) = (got.clone(), compatibility_hash.to_owned());
                    return Err(CheckpointError::Incompatible { path: checkpoint.path, got, expected });
                }
                return Ok(Some(Resumed { checkpoint, skipped }));
            }
            Err(error) if error.is_corrupt() => skipped.push(error),
            Err(error) => return Err(error),
        }
    }
    match skipped.into_iter().next() {
        Some(newest) => Err(CheckpointError::NoneUsable { count, folder, newest: Box::new(newest) }),
        None => Ok(None),
    }
}

fn read_file(checkpoint: &Path, name: &str) -> Result<Vec<u8>, CheckpointError> {
    let path = checkpoint.join(name);
    std::fs::read(&path).map_err(|error| match error.kind() {
        // The second: a file lies where the checkpoint's directory should be.
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
            CheckpointError::Missing { path: checkpoint.to_owned(), file: name.to_owned() }
        }
        _ => CheckpointError::io("read", &path)(error),
    })
}

fn checked(checkpoint: &Path, name: &str, metadata: &Metadata) -> Result<Vec<u8>, CheckpointError> {
    let bytes = read_file(checkpoint, name)?;
    check(&bytes, name, metadata, checkpoint)?;
    Ok(bytes)
}

/// Compares a file's bytes with the size and hash that the description records.
pub(super) fn check(
    bytes: &[u8],
    name: &str,
    metadata: &Metadata,
    checkpoint: &Path,
) -> Result<(), CheckpointError> {
    let expected = metadata.files.get(name).ok_or_else(|| CheckpointError::Foreign {
        path: checkpoint.join(METADATA_FILE),
        reason: format!("it has no hash of {name}"),
    })?;
    let path = checkpoint.join(name);
    if bytes.len() as u64 != expected.bytes {
        return Err(CheckpointError::Truncated { path, got: bytes.len() as u64, expected: expected.bytes });
    }
    if FileInfo::of(bytes) != *expected {
        return Err(CheckpointError::Damaged { path });
    }
    Ok(())
}

/// The tensors of a safetensors file's bytes, by name; `path` is how errors call it.
///
/// # Errors
/// [`CheckpointError::Foreign`] if it is no such file.
pub fn tensors_of(bytes: &[u8], path: &Path) -> Result<Vec<Tensor>, CheckpointError> {
    let foreign = |error: safetensors::SafeTensorError| CheckpointError::Foreign {
        path: path.to_owned(),
        reason: format!("it is not a safetensors file ({error})"),
    };
    let file = SafeTensors::deserialize(bytes).map_err(foreign)?;
    let mut tensors: Vec<Tensor> = file
        .iter()
        .map(|(name, view)| Tensor {
            name: name.to_owned(),
            dtype: view.dtype().to_string(),
            shape: view.shape().to_vec(),
        })
        .collect();
    tensors.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(tensors)
}
