//! The thread that owns the model: updates, snapshots, `metrics.jsonl`, checkpoints.
//!
//! libtorch and the disk block, so they live here; the asynchronous side talks to this thread through two bounded channels.
//! ```text
//!   Update(round) ──> PPO ──> snapshot ──> Updated ──> metrics.jsonl ──> checkpoint, if due ──> Checkpoint
//! ```

use crate::admission::{Progress, Round};
use crate::checkpoint::{Checkpoint, FORMAT, FORMAT_VERSION, Metadata, Store, Versions, id, rfc3339};
use crate::metrics_log::{Line, MetricsLog, Timing};
use crate::publish::Published;
use crate::telemetry::Telemetry;
use cross_config::Config;
use cross_model::{ModelError, Trainer, UpdateStats};
use cross_proto::fragment::Checked;
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::Fragment;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::{mpsc, watch};

/// Work for the thread.
#[derive(Debug)]
pub(crate) enum Work {
    /// Train on a round.
    Update {
        round: Box<Round>,
        /// SUMO's version at the actors, for the records.
        sumo: String,
    },
    /// Write a checkpoint of the present state, unless there is one.
    Checkpoint {
        /// The process ends after this one.
        last: bool,
    },
}

/// What the thread reports.
#[derive(Debug)]
pub(crate) enum Report {
    /// The model stands, restored if asked; its weights are to be published.
    Ready(Arc<Published>),
    /// The model cannot be set up.
    Unusable(ModelError),
    /// An update is done; its weights are to be published.
    Updated(Box<Updated>),
    /// An update failed; the weights are as before.
    UpdateFailed(ModelError),
    /// A checkpoint was written (its id), or could not be (a sentence).
    Checkpoint { result: Result<String, String>, last: bool },
}

/// A finished update.
#[derive(Debug)]
pub(crate) struct Updated {
    pub(crate) published: Arc<Published>,
    pub(crate) stats: UpdateStats,
    pub(crate) seconds: f64,
}

/// What the thread needs to start.
pub(crate) struct TrainerSetup {
    pub(crate) config: Config,
    pub(crate) run_id: String,
    pub(crate) layouts: Vec<(String, Arc<NetworkLayout>)>,
    pub(crate) resumed: Option<Checkpoint>,
    pub(crate) store: Store,
    /// Told the id of every checkpoint, to copy it elsewhere.
    pub(crate) mirror: Option<watch::Sender<String>>,
    pub(crate) log: MetricsLog,
    pub(crate) telemetry: Telemetry,
}

/// Starts the thread; it ends when `work` closes or nobody listens to its reports.
pub(crate) fn spawn(
    setup: TrainerSetup,
    work: mpsc::Receiver<Work>,
    reports: mpsc::Sender<Report>,
) -> std::io::Result<std::thread::JoinHandle<()>> {
    std::thread::Builder::new().name("trainer".to_owned()).spawn(move || run(setup, work, &reports))
}

fn run(mut setup: TrainerSetup, mut work: mpsc::Receiver<Work>, reports: &mpsc::Sender<Report>) {
    let trainer = match build(&setup.config, &setup.layouts, setup.resumed.as_ref()) {
        Ok(trainer) => trainer,
        // Whoever listened to reports is gone if this fails, and so is the need for them: here and below.
        Err(error) => return drop(reports.blocking_send(Report::Unusable(error))),
    };
    announce(&trainer, &setup);
    let resumed = setup.resumed.take();
    let mut worker = Worker {
        written: resumed.as_ref().map(|checkpoint| checkpoint.metadata.updates),
        progress: resumed.as_ref().map(|checkpoint| checkpoint.metadata.progress.clone()).unwrap_or_default(),
        sumo: resumed.map(|checkpoint| checkpoint.metadata.versions.sumo).unwrap_or_default(),
        trainer,
        started: Instant::now(),
        idle_since: Instant::now(),
        setup,
    };
    let ready = worker.snapshot().map(Report::Ready);
    if reports.blocking_send(ready.unwrap_or_else(Report::Unusable)).is_err() {
        return;
    }
    while let Some(work) = work.blocking_recv() {
        let sent = match work {
            Work::Update { round, sumo } => worker.update(*round, sumo, reports),
            Work::Checkpoint { last } => reports.blocking_send(worker.checkpoint(last)),
        };
        if sent.is_err() {
            return;
        }
    }
}

fn build(
    config: &Config,
    layouts: &[(String, Arc<NetworkLayout>)],
    resumed: Option<&Checkpoint>,
) -> Result<Trainer, ModelError> {
    cross_model::set_single_threaded();
    let mut trainer = Trainer::new(config, layouts.to_vec())?;
    if let Some(checkpoint) = resumed {
        trainer.restore(&checkpoint.files.model, &checkpoint.files.optimizer)?;
    }
    Ok(trainer)
}

/// Says where updates are computed, and what that means where it is not plain; and when the newest checkpoint is from.
fn announce(trainer: &Trainer, setup: &TrainerSetup) {
    let placement = trainer.placement();
    if setup.config.learner.serial && placement.device.is_cuda() {
        tracing::warn!(
            "on a GPU sums differ in their last digits from run to run: serial mode does not repeat bit for bit"
        );
    }
    setup.telemetry.placed(placement);
    if let Some(checkpoint) = &setup.resumed {
        setup.telemetry.checkpoint_from(checkpoint.metadata.created_unix_ms as f64 / 1e3);
    }
}

struct Worker {
    setup: TrainerSetup,
    trainer: Trainer,
    /// Counters of the newest update: what a checkpoint records. Data collected since is not in it, and is collected again
    /// by whoever resumes.
    progress: Progress,
    sumo: String,
    /// Update of the newest checkpoint.
    written: Option<u64>,
    started: Instant,
    idle_since: Instant,
}

type Sent = Result<(), mpsc::error::SendError<Report>>;

impl Worker {
    fn update(&mut self, round: Round, sumo: String, reports: &mpsc::Sender<Report>) -> Sent {
        let begun = Instant::now();
        let collect_seconds = (begun - self.idle_since).as_secs_f64();
        // Here and not before: while they wait their counts are packed.
        let fragments: Vec<Fragment> = round.fragments.into_iter().map(Checked::unpack).collect();
        let result = self
            .trainer
            .update(&fragments)
            .and_then(|stats| self.snapshot().map(|published| (stats, published)));
        let update_seconds = begun.elapsed().as_secs_f64();
        self.idle_since = Instant::now();
        let (stats, published) = match result {
            Ok(done) => done,
            Err(error) => return reports.blocking_send(Report::UpdateFailed(error)),
        };
        self.progress = round.progress;
        self.sumo = sumo;
        let policy_version = self.trainer.policy_version();
        let placement = self.trainer.placement();
        self.setup.telemetry.updated(update_seconds, &stats);
        self.setup.telemetry.lag(&round.lag);
        let timing =
            Timing { collect_seconds, update_seconds, uptime_seconds: self.started.elapsed().as_secs_f64() };
        let line = Line {
            update: self.trainer.updates(),
            policy_version,
            decisions: self.progress.decisions,
            episodes: self.progress.episodes,
            scenarios: Line::scenarios(&self.progress, &stats),
            losses: stats.losses.clone(),
            diagnostics: stats.diagnostics.clone(),
            expert_usage: stats.expert_usage.clone(),
            cluster_usage: stats.cluster_usage.clone(),
            lag: round.lag,
            device: placement.device_name(),
            precision: placement.precision_name().to_owned(),
            time: unix_time().as_secs_f64(),
            timing,
        };
        // Actors go on while the disk is busy.
        let updated = Updated { published, stats, seconds: update_seconds };
        reports.blocking_send(Report::Updated(Box::new(updated)))?;
        if let Err(error) = self.setup.log.append(&line) {
            self.setup.telemetry.log_failed();
            tracing::error!("cannot write {}: {error}; training goes on", crate::metrics_log::FILE);
        }
        self.look_at_the_disk();
        if self.is_due() { reports.blocking_send(self.checkpoint(false)) } else { Ok(()) }
    }

    fn is_due(&self) -> bool {
        let updates = self.trainer.updates();
        updates.is_multiple_of(self.setup.config.learner.checkpoint_updates)
            || updates >= self.setup.config.updates
    }

    /// The present weights, encoded for all watchers. The coordinator publishes them, not this thread: an actor must not
    /// hold a version that admission has not heard of.
    fn snapshot(&self) -> Result<Arc<Published>, ModelError> {
        let published = Published::new(self.trainer.policy_version(), self.trainer.snapshot()?);
        self.setup.telemetry.encoded();
        Ok(published)
    }

    fn checkpoint(&mut self, last: bool) -> Report {
        let updates = self.trainer.updates();
        if self.written == Some(updates) {
            return Report::Checkpoint { result: Ok(id(updates)), last };
        }
        let begun = Instant::now();
        let result = self.write();
        match &result {
            Ok(id) => {
                self.written = Some(updates);
                let seconds = begun.elapsed().as_secs_f64();
                self.setup.telemetry.checkpointed(seconds);
                self.setup.telemetry.checkpoint_from(unix_time().as_secs_f64());
                tracing::info!(checkpoint = id, updates, seconds, "checkpoint written");
                if let Some(mirror) = &self.setup.mirror {
                    mirror.send_replace(id.clone());
                }
            }
            Err(error) => {
                self.setup.telemetry.checkpoint_failed();
                tracing::error!(updates, "no checkpoint: {error}; the previous ones are untouched");
            }
        }
        self.look_at_the_disk();
        Report::Checkpoint { result, last }
    }

    fn look_at_the_disk(&self) {
        match self.setup.log.disk_available() {
            Ok(bytes) => self.setup.telemetry.disk_available(bytes),
            Err(error) => tracing::debug!("the run directory's file system does not tell its space: {error}"),
        }
    }

    fn write(&self) -> Result<String, String> {
        let files = self.trainer.save().map_err(|error| error.to_string())?;
        self.setup.store.write(&files, self.metadata()).map_err(|error| error.to_string())
    }

    fn metadata(&self) -> Metadata {
        let config = &self.setup.config;
        let now = unix_time();
        let returns = |(name, s): (&String, &crate::admission::ScenarioProgress)| {
            Some((name.clone(), s.episode_return?))
        };
        Metadata {
            format: FORMAT.to_owned(),
            format_version: FORMAT_VERSION,
            id: String::new(),
            run_id: self.setup.run_id.clone(),
            created: rfc3339(UNIX_EPOCH + now),
            // Good for half a billion years.
            created_unix_ms: u64::try_from(now.as_millis()).unwrap_or(u64::MAX),
            updates: self.trainer.updates(),
            policy_version: self.trainer.policy_version(),
            decisions: self.progress.decisions,
            episodes: self.progress.episodes,
            seed: config.seed,
            episode_return: self.progress.scenarios.iter().filter_map(returns).collect(),
            config_hash: config.hash(),
            compatibility_hash: config.compatibility_hash(),
            layouts: self.setup.layouts.iter().map(|(name, layout)| (name.clone(), layout.hash())).collect(),
            versions: Versions {
                cross: env!("CARGO_PKG_VERSION").to_owned(),
                sumo: self.sumo.clone(),
                libtorch: cross_model::libtorch_version().to_owned(),
            },
            device: self.trainer.placement().device_name(),
            averaged: Vec::new(),
            files: BTreeMap::new(),
            progress: self.progress.clone(),
            config: serde_json::to_value(config).unwrap_or_default(),
        }
    }
}

fn unix_time() -> std::time::Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}
