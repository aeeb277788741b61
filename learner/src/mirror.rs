//! Copies every checkpoint to an object store, besides the training and never in its way.
//!
//! ```text
//!   trainer thread ── id of the newest checkpoint (newest wins) ──> mirror task ── objects ──> store
//! ```
//! The checkpoint is on the disk already, so a store that is slow, down or full costs nothing but its copies. A copy that
//! failed is tried again after a pause, or with the next checkpoint; what came in between is skipped, because a run goes on
//! from the newest.

use crate::checkpoint::remote::{Fetched, Remote};
use crate::checkpoint::{CheckpointError, FOLDER, blocking, reader};
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
/// Longest that the end of the process, and the last copy, wait for the removal of old copies. The next start removes the rest.
const LAST_REMOVAL: Duration = Duration::from_secs(5);

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
    wanted: watch::Receiver<String>,
    copied: watch::Receiver<Option<String>>,
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
        // Nothing yet: the first try claims the place even if there is no checkpoint to copy, so that what is wrong with it
        // shows at once.
        let (done, copied) = watch::channel(None);
        let copier = Copier { setup, run, run_id, keep, telemetry, claimed: false, copied: done };
        let patience = LAST_COPY.min(Duration::from_secs(config.drain_seconds) / 2);
        let task = tokio::spawn(copier.run(wanted.clone()));
        (Self { task, wanted, copied, url, patience }, sender)
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
                // The copy is there; what took so long was the removal of old ones.
                if self.copied.borrow().as_deref() == Some(self.wanted.borrow().as_str()) {
                    return Ok(());
                }
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
    /// The checkpoint that was copied last; empty if there was none to copy.
    copied: watch::Sender<Option<String>>,
}

impl Copier {
    /// Copies until nobody makes checkpoints any more; an error if the last one could not be copied.
    async fn run(mut self, mut wanted: watch::Receiver<String>) -> Result<(), String> {
        let mut open = true;
        loop {
            let id = wanted.borrow_and_update().clone();
            if self.copied.borrow().as_ref() == Some(&id) {
                if !open {
                    return Ok(());
                }
                open = wanted.changed().await.is_ok();
                continue;
            }
            match self.try_to_copy(&id).await {
                Ok(written) => {
                    // Said first: retention must not make a copy that is there count as lost.
                    self.copied.send_replace(Some(id.clone()));
                    if written {
                        tokio::select! {
                            () = self.prune(&id) => {}
                            () = long_ended(wanted.clone()) => {
                                tracing::warn!("old copies are left for the next start to remove: the store is slow");
                            }
                        }
                    }
                }
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

    /// Copies a checkpoint; whether there was one.
    async fn try_to_copy(&mut self, id: &str) -> Result<bool, String> {
        let begun = Instant::now();
        let (error, reason) = match tokio::time::timeout(TRY, self.copy(id)).await {
            Ok(Ok(None)) => return Ok(false),
            Ok(Ok(Some(written))) => {
                let seconds = begun.elapsed().as_secs_f64();
                self.telemetry.uploaded(seconds, written);
                tracing::info!(checkpoint = id, seconds, url = self.setup.remote.url(), "checkpoint copied");
                return Ok(true);
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
        let parcel = blocking(path.clone(), move || reader::parcel(&path)).await?;
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

/// Returns a while after nobody makes checkpoints any more.
async fn long_ended(mut wanted: watch::Receiver<String>) {
    while wanted.changed().await.is_ok() {}
    tokio::time::sleep(LAST_REMOVAL).await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkpoint::tests::run_with;

    /// A mirror of a run's checkpoints, of which one copy is kept, in a store that never gets done with removals.
    fn started(run: &std::path::Path) -> (Mirror, watch::Sender<String>) {
        let remote = Remote::slow_to_remove(Duration::from_secs(3600));
        let setup = MirrorSetup::new(remote, &Fetched::default());
        let config = cross_config::LearnerConfig {
            keep_checkpoints: 1,
            drain_seconds: 2,
            ..cross_config::LearnerConfig::default()
        };
        let telemetry = Telemetry::new(&[]);
        Mirror::start(setup, run.to_owned(), "run".to_owned(), "000001".to_owned(), &config, telemetry)
    }

    async fn wait_for(mirror: &mut Mirror, id: &str) {
        let seen = mirror.copied.wait_for(|copied| copied.as_deref() == Some(id));
        tokio::time::timeout(Duration::from_secs(60), seen).await.unwrap().unwrap();
    }

    #[tokio::test]
    async fn a_copy_that_is_there_is_not_lost_because_old_ones_take_long_to_remove() {
        let run = run_with(&[1, 2]);
        let (mut mirror, sender) = started(run.path());
        wait_for(&mut mirror, "000001").await;
        sender.send("000002".to_owned()).unwrap();
        wait_for(&mut mirror, "000002").await;
        drop(sender);
        mirror.finish().await.unwrap();
    }

    #[tokio::test]
    async fn a_last_checkpoint_that_cannot_be_copied_is_lost() {
        let run = run_with(&[1]);
        let (mut mirror, sender) = started(run.path());
        wait_for(&mut mirror, "000001").await;
        sender.send("000009".to_owned()).unwrap();
        drop(sender);
        let problem = mirror.finish().await.unwrap_err();
        assert!(problem.contains("in the run directory and not in memory:"), "{problem}");
    }
}
