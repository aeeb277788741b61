//! The run directory: one learner at a time, its identity, and where it listens.

use cross_support::files::replace_file;
use rustix::fs::FlockOperation;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Where the learner listens, for whoever started it.
pub const LEARNER_FILE: &str = "learner.json";
/// Identity of the run.
pub const RUN_FILE: &str = "run.json";
const LOCK_FILE: &str = "learner.lock";

/// Why a run directory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RunDirError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was being done.
        action: &'static str,
        /// To what.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// Another learner runs there.
    #[error("another learner uses the run directory {}; stop it first, or name another directory with --run", path.display())]
    InUse {
        /// The directory.
        path: PathBuf,
    },
}

/// A run directory that is this process's alone until it is dropped.
#[derive(Debug)]
pub struct RunDir {
    path: PathBuf,
    /// The lock lasts as long as the file is open, so that even SIGKILL frees it.
    _lock: File,
}

/// `learner.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listening {
    /// Process id.
    pub pid: u32,
    /// Address of the gRPC services.
    pub grpc: SocketAddr,
    /// Address of `/metrics`, `/ready` and `/live`.
    pub metrics: SocketAddr,
    /// Session of this process.
    pub session_epoch: u64,
    /// Identity of the run.
    pub run_id: String,
}

/// `run.json`.
#[derive(Debug, Serialize, Deserialize)]
struct Identity {
    run_id: String,
}

impl RunDir {
    /// Creates the directory if need be, locks it, and removes the address that an earlier process left there.
    ///
    /// # Errors
    /// [`RunDirError`] with what to do.
    pub fn open(path: &Path) -> Result<Self, RunDirError> {
        std::fs::create_dir_all(path).map_err(failed("create", path))?;
        let lock_path = path.join(LOCK_FILE);
        let lock = File::create(&lock_path).map_err(failed("create", &lock_path))?;
        match rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {}
            Err(rustix::io::Errno::WOULDBLOCK) => return Err(RunDirError::InUse { path: path.to_owned() }),
            Err(error) => return Err(failed("lock", &lock_path)(error.into())),
        }
        let run = Self { path: path.to_owned(), _lock: lock };
        run.withdraw()?;
        Ok(run)
    }

    /// The directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What `run.json` says, if it is there and says anything.
    #[must_use]
    pub fn known_identity(&self) -> Option<String> {
        let text = std::fs::read_to_string(self.path.join(RUN_FILE)).ok()?;
        Some(serde_json::from_str::<Identity>(&text).ok()?.run_id)
    }

    /// The run's identity: what `run.json` says, else `known` (from a checkpoint), else a new one, which is then written.
    ///
    /// # Errors
    /// [`RunDirError::Io`] if the file cannot be read or written.
    pub fn identity(&self, known: Option<&str>) -> Result<String, RunDirError> {
        let path = self.path.join(RUN_FILE);
        match std::fs::read_to_string(&path) {
            Ok(text) => {
                if let Ok(identity) = serde_json::from_str::<Identity>(&text) {
                    return Ok(identity.run_id);
                }
                tracing::warn!(file = %path.display(), "names no run_id; it is left as it is");
                Ok(known.map_or_else(|| new_id(&self.path), str::to_owned))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                let run_id = known.map_or_else(|| new_id(&self.path), str::to_owned);
                // Plain data serialises.
                let text = serde_json::json!({
                    "run_id": run_id,
                    "created": crate::checkpoint::rfc3339(SystemTime::now()),
                    "cross": env!("CARGO_PKG_VERSION"),
                });
                replace_file(&path, format!("{text}\n").as_bytes()).map_err(failed("write", &path))?;
                Ok(run_id)
            }
            Err(error) => Err(failed("read", &path)(error)),
        }
    }

    /// Tells where this process listens, in one step.
    ///
    /// # Errors
    /// [`RunDirError::Io`].
    pub fn announce(&self, listening: &Listening) -> Result<(), RunDirError> {
        let path = self.path.join(LEARNER_FILE);
        let text = serde_json::to_string(listening).map_err(|error| failed("write", &path)(error.into()))?;
        replace_file(&path, format!("{text}\n").as_bytes()).map_err(failed("write", &path))
    }

    /// Takes [`announce`](Self::announce) back: nobody listens.
    ///
    /// # Errors
    /// [`RunDirError::Io`].
    pub fn withdraw(&self) -> Result<(), RunDirError> {
        let path = self.path.join(LEARNER_FILE);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(failed("remove", &path)(error)),
            _ => Ok(()),
        }
    }
}

fn failed(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> RunDirError {
    let path = path.to_owned();
    move |source| RunDirError::Io { action, path, source }
}

/// Different for every run: time to the nanosecond, process and place.
fn new_id(path: &Path) -> String {
    let nanos = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
    let mut hash = Sha256::new();
    hash.update(nanos.to_le_bytes());
    hash.update(std::process::id().to_le_bytes());
    hash.update(path.as_os_str().as_encoded_bytes());
    hex::encode(&hash.finalize()[..8])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_directory_has_one_learner_at_a_time() {
        let directory = tempfile::tempdir().unwrap();
        let run = RunDir::open(&directory.path().join("new/run")).unwrap();
        let error = RunDir::open(run.path()).unwrap_err().to_string();
        assert!(error.contains("another learner") && error.contains("new/run"), "{error}");
        let path = run.path().to_owned();
        drop(run);
        RunDir::open(&path).unwrap();
    }

    #[test]
    fn identity_is_kept_and_an_old_address_is_not() {
        let directory = tempfile::tempdir().unwrap();
        let run = RunDir::open(directory.path()).unwrap();
        let id = run.identity(None).unwrap();
        assert_eq!(id.len(), 16);
        assert_eq!(run.identity(Some("other")).unwrap(), id);
        let address = "127.0.0.1:1".parse().unwrap();
        let listening = Listening { pid: 1, grpc: address, metrics: address, session_epoch: 2, run_id: id };
        run.announce(&listening).unwrap();
        let file = directory.path().join(LEARNER_FILE);
        let text = std::fs::read_to_string(&file).unwrap();
        assert_eq!(serde_json::from_str::<Listening>(&text).unwrap(), listening);
        drop(run);
        RunDir::open(directory.path()).unwrap();
        assert!(!file.exists());
    }
}
