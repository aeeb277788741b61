//! A whole learner: model thread, coordinator, gRPC and admin servers, from start to end.

use crate::admin::Admin;
use crate::admission::{Admission, ScenarioSettings, Settings};
use crate::checkpoint::remote::{self, Fetched, Remote};
use crate::checkpoint::{CheckpointError, Resumed, Store, reader};
use crate::coordinator::{Channels, Coordinator, Ending, Handle, Life, REQUEST_QUEUE};
use crate::metrics_log::MetricsLog;
use crate::mirror::{Mirror, MirrorSetup};
use crate::run_dir::RunDir;
use crate::service::{self, Shared};
use crate::telemetry::Telemetry;
use crate::trainer::{self, TrainerSetup};
use anyhow::Context;
use cross_config::Config;
use cross_proto::fragment::FragmentSpec;
use cross_proto::v1;
use cross_sim::SimError;
use cross_sim::layout::{NetworkLayout, load_layout};
use cross_sim::scenario::ScenarioPath;
use cross_support::server::{Protocol, ServerSecurity};
use cross_support::{admin, open_files};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

/// How long clients may take to end their connections once every stream has been ended.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// A scenario's name and intersections.
pub type ScenarioLayout = (String, Arc<NetworkLayout>);

/// What a learner starts from.
#[derive(Debug)]
pub struct Setup {
    /// Configuration of the run.
    pub config: Config,
    /// Its scenarios, in its order.
    pub scenarios: Vec<ScenarioLayout>,
    /// Run directory.
    pub run: PathBuf,
    /// Identity of the run.
    pub run_id: String,
    /// Checkpoint to go on from.
    pub resumed: Option<Resumed>,
    /// Where checkpoints are copied besides the run directory.
    pub mirror: Option<MirrorSetup>,
    /// How its ports are protected.
    pub security: ServerSecurity,
}

/// Why a learner cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Data of one could not be told from the other's.
    #[error("two scenarios of this run are called {name}; give one another name in its scenario.toml")]
    SameName {
        /// The name.
        name: String,
    },
    /// The folder of the checkpoints cannot be used.
    #[error(transparent)]
    Checkpoints(#[from] CheckpointError),
    /// `metrics.jsonl` cannot be used.
    #[error("cannot open {}: {source}", path.display())]
    MetricsLog {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A socket cannot be used.
    #[error("cannot use a listening socket: {0}")]
    Socket(std::io::Error),
    /// The system is out of threads.
    #[error("cannot start the trainer thread: {0}")]
    Thread(std::io::Error),
}

impl StartError {
    /// Whether a person has to change the scenarios or the run directory; otherwise a later try may do.
    #[must_use]
    pub fn is_input(&self) -> bool {
        !matches!(self, Self::Thread(_) | Self::Socket(_))
    }
}

/// A running learner.
#[derive(Debug)]
pub struct Learner {
    session_epoch: u64,
    life: watch::Receiver<Life>,
    drain: CancellationToken,
    closing: CancellationToken,
    telemetry: Telemetry,
    coordinator: tokio::task::JoinHandle<Ending>,
    servers: tokio::task::JoinHandle<anyhow::Result<()>>,
    trainer: std::thread::JoinHandle<()>,
    mirror: Option<Mirror>,
}

/// Loads the scenarios that a configuration names; no SUMO is needed.
///
/// # Errors
/// [`SimError`] names the scenario and what is wrong with it.
pub fn load_scenarios(config: &Config, directory: Option<&Path>) -> Result<Vec<ScenarioLayout>, SimError> {
    let path = ScenarioPath::locate(directory);
    config
        .scenarios
        .iter()
        .map(|name| {
            let scenario = path.load(name)?;
            Ok((scenario.name.clone(), load_layout(&scenario, &config.env)?))
        })
        .collect()
}

/// The newest usable checkpoint of a run, for [`Setup::resumed`].
///
/// # Errors
/// [`CheckpointError`] if there are checkpoints and none can be used.
pub fn find_checkpoint(run: &Path, config: &Config) -> Result<Option<Resumed>, CheckpointError> {
    reader::resume(run, &config.compatibility_hash())
}

/// The same, where checkpoints are copied to an object store too.
///
/// # Errors
/// [`CheckpointError`] as there, or if the store cannot be read and nothing else is there to go on from.
pub async fn fetch_checkpoint(
    run: &RunDir,
    remote: &Remote,
    config: &Config,
) -> Result<Fetched, CheckpointError> {
    remote::resume(run.path(), run.known_identity().as_deref(), remote, &config.compatibility_hash()).await
}

/// The connections that the operating system leaves room for, of those wanted.
fn places(wanted: usize) -> usize {
    let limit = open_files::most();
    let connections = open_files::connections(wanted, limit);
    if connections < wanted {
        let files = limit.unwrap_or_default();
        tracing::warn!(
            "this process may have {files} open files, which leaves room for {connections} connections and not for \
             learner.max_connections = {wanted}; raise the hard limit (ulimit -Hn, LimitNOFILE) or lower the key"
        );
    }
    connections
}

impl Learner {
    /// Starts everything. The learner serves once [`ready`](Self::ready) returns.
    ///
    /// # Errors
    /// If the run directory cannot be written or the thread not started.
    pub fn start(setup: Setup, grpc: TcpListener, metrics: TcpListener) -> Result<Self, StartError> {
        let Setup { config, scenarios, run, run_id, resumed, mirror, security } = setup;
        let mut names: Vec<&str> = scenarios.iter().map(|(name, _)| name.as_str()).collect();
        names.sort_unstable();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(StartError::SameName { name: pair[0].to_owned() });
        }
        let sizes: Vec<(String, usize)> =
            scenarios.iter().map(|(name, layout)| (name.clone(), layout.agents())).collect();
        let telemetry = Telemetry::new(&sizes);
        let store = Store::open(&run, config.learner.keep_checkpoints)?;
        let (resumed, latest) = go_on_from(resumed, &store, &telemetry)?;
        let progress = resumed.as_ref().map(|c| c.metadata.progress.clone()).unwrap_or_default();
        let policy_version = resumed.as_ref().map_or(1, |c| c.metadata.policy_version);
        let log = MetricsLog::open(&run, progress.updates)
            .map_err(|source| StartError::MetricsLog { path: run.join(crate::metrics_log::FILE), source })?;

        let connections = places(config.learner.max_connections);
        let grpc = security.incoming(grpc, Protocol::Grpc, connections).map_err(StartError::Socket)?;
        let metrics =
            security.incoming(metrics, Protocol::Http, admin::CONNECTIONS).map_err(StartError::Socket)?;
        let session_epoch = epoch_now();
        let settings = settings(&config, &scenarios, session_epoch);
        let unacked_fragments = settings.unacked_fragments;
        let specs: Arc<[FragmentSpec]> = scenarios
            .iter()
            .map(|(name, layout)| FragmentSpec::new(name, Arc::clone(layout), &config))
            .collect();

        let (life_sender, life) = watch::channel(Life::Starting);
        let (newest_sender, newest) = watch::channel(None);
        let (status_sender, status) = watch::channel(v1::TrainingStatus::default());
        let (request_sender, requests) = mpsc::channel(REQUEST_QUEUE);
        // One update and a checkpoint of each kind at most are under way.
        let (work_sender, work) = mpsc::channel(4);
        let (report_sender, reports) = mpsc::channel(4);
        let (drain, closing) = (CancellationToken::new(), CancellationToken::new());

        let (mirror, copies) = mirror
            .map(|setup| {
                let (run, id, telemetry) = (run.clone(), run_id.clone(), telemetry.clone());
                Mirror::start(setup, run, id, latest.clone(), &config.learner, telemetry)
            })
            .unzip();
        let trainer_setup = TrainerSetup {
            config: config.clone(),
            run_id: run_id.clone(),
            layouts: scenarios,
            resumed,
            store,
            mirror: copies,
            log,
            telemetry: telemetry.clone(),
        };
        let trainer = trainer::spawn(trainer_setup, work, report_sender).map_err(StartError::Thread)?;
        let admission = Admission::new(settings, policy_version, progress);
        let task = Coordinator::new(
            admission,
            run_id.clone(),
            latest,
            work_sender,
            telemetry.clone(),
            Channels { life: life_sender, status: status_sender, newest: newest_sender },
        );
        let coordinator = tokio::spawn(task.run(requests, reports, drain.clone()));
        let shared = Shared {
            config: Arc::new(config),
            run,
            run_id,
            session_epoch,
            specs,
            unacked_fragments,
            coordinator: Handle::new(request_sender),
            life: life.clone(),
            newest,
            status,
            closing: closing.clone(),
        };
        let subject = Admin { telemetry: telemetry.clone(), life: life.clone() };
        let admin = admin::serve(metrics, security.clone(), subject, closing.clone().cancelled_owned());
        let servers = tokio::spawn(async move {
            let (services, ()) = tokio::join!(service::serve(shared, grpc, security), admin);
            services.context("the gRPC server failed")
        });
        Ok(Self { session_epoch, life, drain, closing, telemetry, coordinator, servers, trainer, mirror })
    }

    /// Session of this learner.
    #[must_use]
    pub fn session_epoch(&self) -> u64 {
        self.session_epoch
    }

    /// Its metrics.
    #[must_use]
    pub fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }

    /// Waits until actors may join; false if the learner has ended, or is about to, instead.
    pub async fn ready(&self) -> bool {
        let mut life = self.life.clone();
        life.wait_for(|life| *life != Life::Starting).await.is_ok_and(|life| *life == Life::Serving)
    }

    /// Cancel it to have the learner finish its update, write a checkpoint, say goodbye and end.
    #[must_use]
    pub fn drain(&self) -> CancellationToken {
        self.drain.clone()
    }

    /// Waits for the end of training, of the servers, and of the last copy to an object store.
    pub async fn finished(mut self) -> Ending {
        let ending = tokio::select! {
            ending = &mut self.coordinator => {
                ending.unwrap_or_else(|error| Ending::Failed(format!("the coordinator failed: {error}")))
            }
            served = &mut self.servers => {
                // Without its servers the learner is deaf; the state of training is still worth a checkpoint.
                let problem = match served {
                    Ok(Ok(())) => "the servers ended by themselves".to_owned(),
                    Ok(Err(error)) => format!("{error:#}"),
                    Err(error) => format!("the servers failed: {error}"),
                };
                self.drain.cancel();
                let ending = match self.coordinator.await {
                    Ok(Ending::Complete) => Ending::Complete,
                    _ => Ending::Failed(problem),
                };
                return last_copy(self.mirror, ending).await;
            }
        };
        self.closing.cancel();
        // Clients that keep a connection open, such as a health watch, must not hold the process.
        if tokio::time::timeout(LAST_WORDS, &mut self.servers).await.is_err() {
            tracing::debug!("a client kept its connection open");
            self.servers.abort();
        }
        // Its work ended with the coordinator. Waited for, so that libtorch is not torn down under it at exit.
        let trainer = tokio::task::spawn_blocking(|| self.trainer.join());
        if tokio::time::timeout(LAST_WORDS, trainer).await.is_err() {
            tracing::warn!("the trainer thread is still busy");
        }
        last_copy(self.mirror, ending).await
    }
}

/// Waits for the last copy. A run that promised copies and did not make the last one has not ended well, even if all else
/// did: whoever started it may throw the run directory away.
async fn last_copy(mirror: Option<Mirror>, ending: Ending) -> Ending {
    let Some(mirror) = mirror else { return ending };
    match (mirror.finish().await, ending) {
        (Err(problem), Ending::Complete | Ending::Drained) => Ending::Failed(problem),
        (_, ending) => ending,
    }
}

/// Takes the checkpoint out of a resumption, loudly if it is not the newest.
fn go_on_from(
    resumed: Option<Resumed>,
    store: &Store,
    telemetry: &Telemetry,
) -> Result<(Option<reader::Checkpoint>, String), CheckpointError> {
    let Some(Resumed { checkpoint, skipped }) = resumed else { return Ok((None, String::new())) };
    let id = checkpoint.metadata.id.clone();
    if !skipped.is_empty() {
        for problem in &skipped {
            tracing::error!("{problem}");
        }
        tracing::error!(
            damaged = skipped.len(),
            "falling back to checkpoint {id}; later updates are lost, the damaged checkpoints are renamed to damaged-*"
        );
        telemetry.fell_back(skipped.len());
    }
    store.go_on_from(&id)?;
    tracing::info!(checkpoint = %id, updates = checkpoint.metadata.updates, "resuming");
    Ok((Some(checkpoint), id))
}

fn settings(config: &Config, scenarios: &[ScenarioLayout], session_epoch: u64) -> Settings {
    let round_steps = u64::from(config.ppo.round_steps);
    Settings {
        seed: config.seed,
        session_epoch,
        scenarios: scenarios
            .iter()
            .map(|(name, layout)| ScenarioSettings {
                name: name.clone(),
                agents: layout.agents(),
                incoming_lanes: layout.intersections.iter().map(|i| i.incoming.len()).sum(),
            })
            .collect(),
        round_steps,
        buffered_steps: round_steps * u64::from(config.learner.buffered_rounds),
        episode_steps: config.env.steps_per_episode(),
        fragment_steps: config.actor.fragment_steps,
        // In lock step every fragment is answered before the next one is begun.
        unacked_fragments: if config.learner.serial { 1 } else { config.actor.unacked_fragments },
        max_policy_lag: config.learner.max_policy_lag,
        serial: config.learner.serial,
        max_actors: config.learner.max_actors,
        lease: Duration::from_secs(config.learner.lease_seconds),
        updates: config.updates,
    }
}

/// Grows with every start on one machine; microseconds, so that it stays exact in JSON.
fn epoch_now() -> u64 {
    let micros = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_micros();
    u64::try_from(micros).unwrap_or(u64::MAX)
}
