//! Copies every checkpoint to an object store, besides the training and never in its way.
//!
//! ```text
//!   trainer thread ── id of the newest checkpoint (newest wins) ──> mirror task ── objects ──> store
//! ```
//! The checkpoint is on the disk already, so a store that is slow, down or full costs nothing but its copies. A copy that
//! failed is tried again after a pause, or with the next checkpoint; what came in between is skipped, because a run goes on
//! from the newest.

use crate::checkpoint::remote::{Fetched, Remote};
use crate::checkpoint::{CheckpointError, FOLDER, reader};
use crate::telemetry::Telemetry;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Longest that one try to copy a checkpoint may take, all its requests together.
const TRY: Duration = Duration::from_secs(120);
/// Between a failure and the next try, unless a new checkpoint comes first.
const PAUSE: Duration = Duration::from_secs(30);
/// Longest that the end of the process waits for the last copy, of half the time that a drain may take.
const LAST_COPY: Duration = Duration::from_secs(30);

/// Where to copy checkpoints, and what is known of the place.
#[derive(Debug)]
pub struct MirrorSetup {
    /// The place.
    pub remote: Remote,
    /// Checkpoints there that were found damaged.
    damaged: Vec<String>,
}

impl MirrorSetup {
    /// A place, and what was found there.
    #[must_use]
    pub fn new(remote: Remote, fetched: &Fetched) -> Self {
        Self { remote, damaged: fetched.damaged.clone() }
    }
}

/// The task that copies.
#[derive(Debug)]
pub(crate) struct Mirror {
    task: JoinHandle<Result<(), String>>,
    url: String,
    patience: Duration,
}

impl Mirror {
    /// Starts the task, and gives the place where ids of new checkpoints go; it ends once that is dropped. `resumed` is the
    /// checkpoint that the run goes on from, which the store may lack; empty if there is none.
    pub(crate) fn start(
        setup: MirrorSetup,
        run: PathBuf,
        run_id: String,
        resumed: String,
        config: &cross_config::LearnerConfig,
        telemetry: Telemetry,
    ) -> (Self, watch::Sender<String>) {
        let (sender, wanted) = watch::channel(resumed);
        let (url, keep) = (setup.remote.url().to_owned(), config.keep_checkpoints);
        let copier = Copier { setup, run, run_id, keep, telemetry, claimed: false };
        let patience = LAST_COPY.min(Duration::from_secs(config.drain_seconds) / 2);
        (Self { task: tokio::spawn(copier.run(wanted)), url, patience }, sender)
    }

    /// Waits for the last copy, not for ever.
    ///
    /// # Errors
    /// A sentence: the newest checkpoint is on the disk alone.
    pub(crate) async fn finish(mut self) -> Result<(), String> {
        let lost = |why: &str| {
            format!(
                "the last checkpoint is in the run directory and not in {}: {why}; \
                 start again with --resume to copy it there",
                self.url
            )
        };
        match tokio::time::timeout(self.patience, &mut self.task).await {
            Ok(Ok(result)) => result.map_err(|why| lost(&why)),
            Ok(Err(error)) => Err(lost(&format!("copying failed ({error})"))),
            Err(_) => {
                self.task.abort();
                Err(lost(&format!("copying took longer than {} s", self.patience.as_secs())))
            }
        }
    }
}

struct Copier {
    setup: MirrorSetup,
    run: PathBuf,
    run_id: String,
    keep: usize,
    telemetry: Telemetry,
    /// The place is known to be this run's.
    claimed: bool,
}

impl Copier {
    /// Copies until nobody makes checkpoints any more; an error if the last one could not be copied.
    async fn run(mut self, mut wanted: watch::Receiver<String>) -> Result<(), String> {
        let mut open = true;
        // Nothing yet: the first try claims the place even if there is no checkpoint to copy, so that what is wrong with it
        // shows at once.
        let mut copied = None;
        loop {
            let id = wanted.borrow_and_update().clone();
            if copied.as_ref() == Some(&id) {
                if !open {
                    return Ok(());
                }
                open = wanted.changed().await.is_ok();
                continue;
            }
            match self.try_to_copy(&id).await {
                Ok(()) => copied = Some(id),
                // The last try was begun when all was said.
                Err(error) if !open => return Err(error),
                Err(_) => {
                    if let Ok(changed) = tokio::time::timeout(PAUSE, wanted.changed()).await {
                        open = changed.is_ok();
                    }
                }
            }
        }
    }

    async fn try_to_copy(&mut self, id: &str) -> Result<(), String> {
        let begun = Instant::now();
        let (error, reason) = match tokio::time::timeout(TRY, self.copy(id)).await {
            Ok(Ok(None)) => return Ok(()),
            Ok(Ok(Some(written))) => {
                let seconds = begun.elapsed().as_secs_f64();
                self.telemetry.uploaded(seconds, written);
                tracing::info!(checkpoint = id, seconds, url = self.setup.remote.url(), "checkpoint copied");
                self.prune(id).await;
                return Ok(());
            }
            Ok(Err(error)) => {
                let reason = match &error {
                    CheckpointError::Store { trouble, .. } => trouble.label(),
                    _ => "other",
                };
                (error.to_string(), reason)
            }
            Err(_) => (format!("it took longer than {} s", TRY.as_secs()), "unreachable"),
        };
        self.telemetry.upload_failed(reason);
        tracing::error!(
            checkpoint = id,
            "no copy of the checkpoint: {error}; it is in the run directory, training goes on, and it is tried again"
        );
        Err(error)
    }

    /// Copies a checkpoint, if there is one; when it was written, seconds since 1970.
    async fn copy(&mut self, id: &str) -> Result<Option<f64>, CheckpointError> {
        let remote = &self.setup.remote;
        if !self.claimed {
            remote.claim(&self.run_id).await?;
            self.claimed = true;
        }
        while let Some(damaged) = self.setup.damaged.last() {
            remote.set_aside(damaged).await?;
            self.setup.damaged.pop();
        }
        if id.is_empty() {
            return Ok(None);
        }
        let path = self.run.join(FOLDER).join(id);
        let parcel = match tokio::task::spawn_blocking(move || reader::parcel(&path)).await {
            Ok(parcel) => parcel?,
            Err(error) => std::panic::resume_unwind(error.into_panic()),
        };
        remote.upload(&parcel).await?;
        Ok(Some(parcel.metadata.created_unix_ms as f64 / 1e3))
    }

    /// Retention. A failure costs space and nothing else, so it is only logged.
    async fn prune(&self, id: &str) {
        match tokio::time::timeout(TRY, self.setup.remote.prune(self.keep, id)).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!("cannot remove an old checkpoint: {error}"),
            Err(_) => tracing::warn!("removing old checkpoints took longer than {} s", TRY.as_secs()),
        }
    }
}
