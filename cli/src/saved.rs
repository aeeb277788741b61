//! Checkpoints wherever they are: in a run directory, or in an object store by URL.

use crate::failure::{Failure, OrBadInput, Outcome};
use anyhow::Context;
use cross_learner::checkpoint::remote::{self, Named, Remote, named};
use cross_learner::checkpoint::{Checkpoint, CheckpointError, Entry, LATEST_FILE, Metadata, reader};
use cross_support::files::replace_file;
use std::path::{Path, PathBuf};

/// A run, for its checkpoints.
#[derive(Debug)]
pub(crate) enum Saved {
    Disk(PathBuf),
    Store(Remote),
}

/// One checkpoint.
#[derive(Debug)]
pub(crate) enum Chosen {
    Disk(PathBuf),
    Store { remote: Remote, id: String },
}

impl Saved {
    /// A run in a store, if this is a URL.
    pub(crate) fn by_url(text: &Path) -> Outcome<Option<Self>> {
        match text.to_str().and_then(named) {
            None => Ok(None),
            Some(Named::Run(url)) => Ok(Some(Self::Store(Remote::open(&url).or_bad_input()?))),
            Some(Named::Checkpoint(place, _) | Named::File(place, _)) => {
                may_be_repeated(&place)?;
                Err(Failure::input(format!(
                    "{} names one checkpoint; --run wants the URL of a run, the part before /checkpoints",
                    text.display()
                )))
            }
        }
    }

    /// What people and documents call it.
    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Disk(run) => run,
            Self::Store(remote) => Path::new(remote.url()),
        }
    }

    /// Every checkpoint, newest first, and which of them `latest` names.
    pub(crate) fn list(&self) -> Outcome<(Vec<Entry>, Option<PathBuf>)> {
        match self {
            Self::Disk(run) => Ok((reader::list(run)?, reader::find(run, LATEST_FILE).ok())),
            Self::Store(remote) => wait(async {
                let entries = remote.list().await?;
                match remote.find(LATEST_FILE).await {
                    Ok(id) => Ok((entries, Some(remote.path_of(&id)))),
                    Err(CheckpointError::NotFound { .. }) => Ok((entries, None)),
                    Err(error) => Err(error),
                }
            }),
        }
    }

    /// The checkpoint of an id or `latest`.
    pub(crate) fn find(&self, id: &str) -> Outcome<Chosen> {
        match self {
            Self::Disk(run) => Ok(Chosen::Disk(reader::find(run, id).or_bad_input()?)),
            Self::Store(remote) => {
                let id = wait(remote.find(id))?;
                Ok(Chosen::Store { remote: remote.clone(), id })
            }
        }
    }
}

impl Chosen {
    /// The checkpoint of a URL, if this is one.
    pub(crate) fn by_url(text: &str) -> Outcome<Option<Self>> {
        let (run, id) = match named(text) {
            None => return Ok(None),
            Some(Named::Checkpoint(run, id)) => (run, id),
            Some(Named::Run(run)) => (run, LATEST_FILE.to_owned()),
            Some(Named::File(place, _)) => {
                may_be_repeated(&place)?;
                return Err(Failure::input(format!("{text} is a policy file; name a checkpoint, or a run")));
            }
        };
        Saved::Store(Remote::open(&run).or_bad_input()?).find(&id).map(Some)
    }

    /// What people and documents call it.
    pub(crate) fn path(&self) -> PathBuf {
        match self {
            Self::Disk(path) => path.clone(),
            Self::Store { remote, id } => remote.path_of(id),
        }
    }

    /// Its description, and the checked bytes of its policy.
    pub(crate) fn model(&self) -> Outcome<(Metadata, Vec<u8>)> {
        match self {
            Self::Disk(path) => reader::model(path).or_bad_input(),
            Self::Store { remote, id } => wait(remote.model(id)),
        }
    }

    /// All of it: every file compared with its recorded size and hash, and well-formed.
    pub(crate) fn verify(&self) -> Outcome<Checkpoint> {
        match self {
            Self::Disk(path) => reader::read(path).and_then(Checkpoint::well_formed).or_bad_input(),
            Self::Store { remote, id } => wait(async { remote.read(id).await?.well_formed() }),
        }
    }

    /// Writes its policy to a file, in one step.
    pub(crate) fn export(&self, out: &Path) -> Outcome<Metadata> {
        if let Self::Disk(path) = self {
            return reader::export(path, out).or_bad_input();
        }
        let (metadata, model) = self.model()?;
        replace_file(out, &model)
            .with_context(|| format!("cannot write {}", out.display()))
            .or_bad_input()?;
        Ok(metadata)
    }
}

/// Refuses a URL that must not be shown, before it is: it may hold a password.
fn may_be_repeated(place: &str) -> Outcome<()> {
    cross_config::checkpoint_url(place)
        .map_err(|reason| Failure::input(format!("cannot use the URL for checkpoints: it {reason}")))
}

/// The policy that a URL stands for, with its checkpoint's metadata if it is one's; `None` for what is no URL.
pub(crate) fn policy_by_url(text: &str) -> Outcome<Option<(Option<Metadata>, Vec<u8>)>> {
    named(text).map(|url| wait(remote::load_policy(&url))).transpose()
}

/// Waits for a store. One that cannot be reached is nobody's bad input.
fn wait<T>(work: impl Future<Output = Result<T, CheckpointError>>) -> Outcome<T> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime
        .block_on(work)
        .map_err(|error| if error.is_passing() { Failure::from(error) } else { Failure::bad_input(error) })
}
