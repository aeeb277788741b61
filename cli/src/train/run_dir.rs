//! The run directory: what a training run leaves on disk, and who may use it.
//!
//! ```text
//!   DIR/config.toml      the effective configuration
//!   DIR/run.json         identity of the run (written by the learner)
//!   DIR/learner.json     where the learner listens now (written by the learner)
//!   DIR/checkpoints/     numbered checkpoints and `latest`
//!   DIR/metrics.jsonl    one line per update
//!   DIR/logs/            one log per process
//!   DIR/curves.svg       learning curves        } written at the end
//!   DIR/result.json      the closing evaluation }
//!   DIR/evaluation/      the same with details  }
//! ```

use crate::failure::{Failure, Outcome};
use anyhow::Context;
use cross_learner::checkpoint::{FOLDER, LATEST_FILE, Metadata, reader, rfc3339};
use cross_support::files::replace_file;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Where runs go unless told otherwise.
pub(crate) const RUNS: &str = "runs";
/// Folder of the closing evaluation's reports.
pub(crate) const EVALUATION: &str = "evaluation";

/// A run directory that this process alone uses until it is dropped.
#[derive(Debug)]
pub(crate) struct RunDir {
    path: PathBuf,
    _lock: File,
}

impl RunDir {
    /// A new run. `given` must not hold a run yet; without it a name is made of the time.
    pub(crate) fn create(given: Option<&Path>) -> Outcome<Self> {
        let path = match given {
            Some(path) => path.to_owned(),
            None => fresh(Path::new(RUNS), SystemTime::now())?,
        };
        if path.is_file() {
            return Err(Failure::input(format!("{} is a file; name a directory with --run", path.display())));
        }
        // Before anything is written into it, and once more when nobody else can begin a run there.
        refuse_run(&path)?;
        std::fs::create_dir_all(path.join("logs"))
            .with_context(|| format!("cannot create the run directory {}", path.display()))?;
        let run = Self::lock(path)?;
        refuse_run(&run.path)?;
        Ok(run)
    }

    /// A run that is there. Without `given` the newest one under [`RUNS`]. `elsewhere` if its checkpoints are in a store too:
    /// then the directory may have lost everything.
    pub(crate) fn open(given: Option<&Path>, elsewhere: bool) -> Outcome<Self> {
        let path = match given {
            Some(path) => path.to_owned(),
            None => newest(Path::new(RUNS)).ok_or_else(|| {
                Failure::input(format!("there is no run under {RUNS}/ in this folder to resume; go where you trained, or name one with --run DIR"))
            })?,
        };
        let may_be_empty = elsewhere && given.is_some();
        if !may_be_empty && !holds_run(&path) {
            return Err(Failure::input(format!(
                "{} holds no run to resume; leave out --resume to start one there",
                path.display()
            )));
        }
        std::fs::create_dir_all(path.join("logs"))
            .with_context(|| format!("cannot write into the run directory {}", path.display()))?;
        Self::lock(path)
    }

    fn lock(path: PathBuf) -> Outcome<Self> {
        let file = path.join(".lock");
        let lock = File::create(&file).with_context(|| format!("cannot write {}", file.display()))?;
        match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => Ok(Self { path, _lock: lock }),
            Err(Errno::WOULDBLOCK) => Err(Failure::input(format!(
                "another `cross train` is using {}; wait for it or name another directory with --run",
                path.display()
            ))),
            Err(error) => {
                Err(anyhow::Error::new(error).context(format!("cannot lock {}", file.display())).into())
            }
        }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn config(&self) -> PathBuf {
        self.path.join("config.toml")
    }

    pub(crate) fn learner_json(&self) -> PathBuf {
        self.path.join("learner.json")
    }

    pub(crate) fn metrics(&self) -> PathBuf {
        self.path.join("metrics.jsonl")
    }

    pub(crate) fn curves(&self) -> PathBuf {
        self.path.join("curves.svg")
    }

    pub(crate) fn result(&self) -> PathBuf {
        self.path.join("result.json")
    }

    pub(crate) fn log(&self, process: &str) -> PathBuf {
        self.path.join("logs").join(format!("{process}.log"))
    }

    /// The checkpoint that was written last, if there is one that can be read.
    pub(crate) fn newest_checkpoint(&self) -> Option<(PathBuf, Metadata)> {
        let path = reader::find(&self.path, LATEST_FILE).ok()?;
        let metadata = reader::metadata(&path).ok()?;
        Some((path, metadata))
    }

    /// Whether there is anything to go on from, sound or not: which it is, the learner finds out and says.
    pub(crate) fn has_checkpoints(&self) -> bool {
        reader::list(&self.path).map_or(true, |list| !list.is_empty())
    }
}

/// Writes a whole file or leaves the old one.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Outcome<()> {
    replace_file(path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(())
}

fn holds_run(path: &Path) -> bool {
    path.join("config.toml").exists() || path.join(FOLDER).exists()
}

fn refuse_run(path: &Path) -> Outcome<()> {
    if holds_run(path) {
        return Err(Failure::input(format!(
            "{} already holds a run; continue it with --resume or name another directory with --run",
            path.display()
        )));
    }
    Ok(())
}

/// Makes `runs/20260131-235959`, with a number after it where that is taken. Two runs that begin in one second get two.
fn fresh(parent: &Path, now: SystemTime) -> Outcome<PathBuf> {
    let stamp = stamp(now);
    let mut path = parent.join(&stamp);
    let mut number = 2;
    std::fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display()))?;
    loop {
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                path = parent.join(format!("{stamp}-{number}"));
                number += 1;
            }
            Err(error) => {
                let context = format!("cannot create the run directory {}", path.display());
                return Err(anyhow::Error::new(error).context(context).into());
            }
        }
    }
}

/// The newest run by the time its configuration was written.
pub(crate) fn newest(parent: &Path) -> Option<PathBuf> {
    std::fs::read_dir(parent)
        .ok()?
        .flatten()
        .filter_map(|entry| {
            let written = entry.path().join("config.toml").metadata().ok()?.modified().ok()?;
            Some((written, entry.path()))
        })
        .max()
        .map(|(_, path)| path)
}

/// UTC date and time as `YYYYMMDD-HHMMSS`.
fn stamp(time: SystemTime) -> String {
    rfc3339(time)
        .chars()
        .filter_map(|c| match c {
            'T' => Some('-'),
            digit if digit.is_ascii_digit() => Some(digit),
            _ => None,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_without_a_name_are_called_after_their_time() {
        let time = std::time::UNIX_EPOCH + std::time::Duration::from_secs(951_868_799);
        let directory = tempfile::tempdir().unwrap();
        for name in ["20000229-235959", "20000229-235959-2", "20000229-235959-3"] {
            let path = fresh(directory.path(), time).unwrap();
            assert!(path.ends_with(name) && path.is_dir(), "{path:?}");
        }
    }

    #[test]
    fn a_second_user_is_refused_and_a_later_one_is_not() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run");
        let first = RunDir::create(Some(&path)).unwrap();
        std::fs::write(first.config(), "").unwrap();
        let error = RunDir::open(Some(&path), false).unwrap_err();
        assert!(error.to_string().contains("another"), "{error}");
        assert_eq!(error.code(), crate::failure::BAD_INPUT);
        drop(first);
        RunDir::open(Some(&path), false).unwrap();
        let error = RunDir::create(Some(&path)).unwrap_err();
        assert!(error.to_string().contains("--resume"), "{error}");
    }

    #[test]
    fn there_must_be_something_to_resume() {
        let directory = tempfile::tempdir().unwrap();
        let error = RunDir::open(Some(directory.path()), false).unwrap_err();
        assert!(error.to_string().contains("no run to resume"), "{error}");
    }
}
