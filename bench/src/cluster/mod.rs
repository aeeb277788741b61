//! What the benchmarks of real processes share: a learner, a bare server, a whole training, and simulated actors.
//!
//! ```text
//!   recording ── an episode, recorded once with SUMO ──> actor ── gRPC ──> learner   the program cross-learner
//!                                                          └───── gRPC ──> bare      tonic alone, in a process too
//!   learner, bare ── pid ──> sampler: their memory while something happens
//! ```
//! Both servers speak `cross.v1.Learner`, so that the clients are the same code, message for message, and only what
//! answers them differs.

pub(crate) mod actor;
pub mod bare;
pub(crate) mod client;
pub(crate) mod learner;
pub(crate) mod limits;
pub(crate) mod recording;
pub(crate) mod sampler;

use crate::error::BenchError;
use crate::progress::Progress;
use cross_config::Config;
use cross_sim::scenario::Scenario;
use cross_support::child::Process;
use cross_traci::SumoHome;
use recording::Recording;
use std::ffi::OsString;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::Instant;

/// How long a server may take from its start until it serves, and from being told to stop until it has ended.
const READY: Duration = Duration::from_secs(120);
/// Between two looks whether it does.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The programs that are started.
#[derive(Debug, Clone)]
pub struct Programs {
    /// `cross-learner`.
    pub learner: PathBuf,
    /// A program that calls [`bare::serve`], and the arguments that have it do so; a folder is added.
    pub bare: (PathBuf, Vec<OsString>),
}

/// What the benchmarks of the wire are made with.
#[derive(Debug)]
pub struct Setup {
    /// What is started.
    pub programs: Programs,
    /// SUMO, for the one episode that is recorded.
    pub home: SumoHome,
    /// Its network, as the configuration names it.
    pub name: String,
    /// The same, loaded.
    pub scenario: Scenario,
}

impl Setup {
    /// The episode, on a network that the configuration names.
    pub(crate) fn record(
        &self,
        config: &Config,
        progress: Progress<'_>,
    ) -> Result<Arc<Recording>, BenchError> {
        progress(&format!("recording an episode of {} with SUMO", self.scenario.name));
        Ok(Arc::new(Recording::new(&self.home, &self.scenario, config, 1)?))
    }
}

/// A server in a process and a folder of its own; both are gone when this is dropped.
#[derive(Debug)]
pub(crate) struct Server {
    // Dropped in this order: the process must not write into a folder that is being removed.
    process: Process,
    folder: TempDir,
    name: &'static str,
}

impl Server {
    /// Starts `program`; `arguments` gets the folder.
    ///
    /// The process dies with the calling thread.
    pub(crate) fn start(
        name: &'static str,
        program: &Path,
        folder: TempDir,
        arguments: &[OsString],
    ) -> Result<Self, BenchError> {
        let process = Process::start(program, arguments, &folder.path().join("log"))?;
        Ok(Self { process, folder, name })
    }

    pub(crate) fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// Waits until `found` finds what the server writes once it serves.
    async fn ready<T>(&mut self, found: impl Fn(&Path, u32) -> Option<T>) -> Result<T, BenchError> {
        let end = Instant::now() + READY;
        loop {
            if let Some(found) = found(self.folder.path(), self.pid()) {
                return Ok(found);
            }
            self.alive()?;
            if Instant::now() >= end {
                return Err(BenchError::NotReady { server: self.name, seconds: READY.as_secs() });
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }

    /// Has the process end in order, and waits for it.
    pub(crate) async fn stop(mut self) -> Result<(), BenchError> {
        self.process.terminate();
        let end = Instant::now() + READY;
        while self.process.ended().is_none() {
            if Instant::now() >= end {
                return Err(BenchError::NotEnded { server: self.name, seconds: READY.as_secs() });
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
        Ok(())
    }

    /// An error if the process has ended: whatever its clients complain of follows from that.
    pub(crate) fn alive(&mut self) -> Result<(), BenchError> {
        let Some(exit) = self.process.ended() else { return Ok(()) };
        let said = self.process.last_words().unwrap_or_else(|| "nothing".to_owned());
        Err(BenchError::ServerEnded { server: self.name, exit, said })
    }
}

/// Runs a benchmark on this thread, until it ends or somebody asks to stop. Whatever it started or made is then gone.
pub(crate) fn run<T>(work: impl Future<Output = Result<T, BenchError>>) -> Result<T, BenchError> {
    let runtime = |source| BenchError::Runtime { source };
    let threads = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(runtime)?;
    let result = threads.block_on(async {
        tokio::select! {
            result = work => result,
            stopped = stop_asked() => Err(stopped.map_or_else(runtime, |()| BenchError::Stopped)),
        }
    });
    // Clients that are still at it have nobody to tell.
    threads.shutdown_background();
    result
}

async fn stop_asked() -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
    Ok(())
}
