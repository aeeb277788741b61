//! Where new versions come from: a learner that makes an update, or the bare server that is told to.

use crate::cluster::actor::{Actor, Peer};
use crate::cluster::bare::{BareServer, Fragments};
use crate::cluster::learner::Learner;
use crate::cluster::recording::Recording;
use crate::cluster::{Programs, client};
use crate::error::BenchError;
use cross_config::Config;
use cross_proto::client::TrainingClient;
use cross_proto::v1;
use cross_support::client::Connection;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Between two looks whether a version is there.
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// How long an update may take.
const PATIENCE: Duration = Duration::from_secs(60);

/// A server that publishes a version when asked.
pub(super) struct Source {
    side: Side,
    training: TrainingClient<Connection>,
    /// Newest version that was asked for.
    pub(super) version: u64,
}

enum Side {
    Learner {
        learner: Box<Learner>,
        /// Sends the data of an update.
        feeder: Box<Actor>,
    },
    Bare(BareServer),
}

impl Source {
    /// A learner, on which `recording` is learned.
    pub(super) async fn learner(
        programs: &Programs,
        config: &Config,
        recording: &Arc<Recording>,
    ) -> Result<Self, BenchError> {
        let learner = Learner::start(&programs.learner, config).await?;
        let id = "bench-feeder".to_owned();
        let feeder = Actor::open(Peer::Learner, &learner.address, id, Arc::clone(recording)).await?;
        let training = client::training(&learner.address).await?;
        let side = Side::Learner { learner: Box::new(learner), feeder: Box::new(feeder) };
        Ok(Self { side, training, version: 1 })
    }

    /// The bare server, which publishes these bytes under one version after another.
    pub(super) async fn bare(programs: &Programs, snapshot: &[u8]) -> Result<Self, BenchError> {
        let bare = BareServer::start(programs, snapshot, Fragments::Dropped).await?;
        let training = client::training(&bare.address).await?;
        Ok(Self { side: Side::Bare(bare), training, version: 1 })
    }

    pub(super) fn pid(&self) -> u32 {
        match &self.side {
            Side::Learner { learner, .. } => learner.server.pid(),
            Side::Bare(bare) => bare.server.pid(),
        }
    }

    pub(super) fn address(&self) -> &str {
        match &self.side {
            Side::Learner { learner, .. } => &learner.address,
            Side::Bare(bare) => &bare.address,
        }
    }

    /// An error if the process has ended.
    pub(super) fn alive(&mut self) -> Result<(), BenchError> {
        match &mut self.side {
            Side::Learner { learner, .. } => learner.server.alive(),
            Side::Bare(bare) => bare.server.alive(),
        }
    }

    /// Has the next version made, and waits until it is published.
    pub(super) async fn publish(&mut self) -> Result<(), BenchError> {
        match &mut self.side {
            Side::Learner { feeder, .. } => {
                feeder.acts_on(self.version);
                feed(feeder).await?;
            }
            Side::Bare(_) => {
                let resumed = self.training.resume(v1::ResumeRequest {}).await;
                resumed.map_err(client::failed("Resume"))?;
            }
        }
        self.version += 1;
        let end = Instant::now() + PATIENCE;
        while self.status().await?.policy_version < self.version {
            if Instant::now() >= end {
                let (what, seconds) = ("an update", PATIENCE.as_secs());
                return Err(BenchError::Unserved { waiting: 1, clients: 1, what, seconds });
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
        Ok(())
    }

    /// When the newest version was published, Unix time in seconds, by the server's own account.
    pub(super) async fn published_at(&mut self) -> Result<f64, BenchError> {
        match &self.side {
            Side::Learner { learner, .. } => {
                learner.metric("cross_learner_published_timestamp_seconds").await
            }
            Side::Bare(_) => Ok(self.status().await?.uptime_seconds),
        }
    }

    /// How often a snapshot, at the bare server a message of one, was encoded so far.
    pub(super) async fn encoded(&mut self) -> Result<u64, BenchError> {
        match &self.side {
            Side::Learner { learner, .. } => {
                Ok(learner.metric("cross_learner_snapshots_encoded_total").await? as u64)
            }
            Side::Bare(_) => Ok(self.status().await?.updates),
        }
    }

    /// Whether every version must be encoded once and no more.
    pub(super) fn encodes_once(&self) -> bool {
        matches!(self.side, Side::Learner { .. })
    }

    async fn status(&mut self) -> Result<v1::TrainingStatus, BenchError> {
        let status = self.training.get_status(v1::GetStatusRequest {}).await;
        Ok(status.map_err(client::failed("GetStatus"))?.into_inner().status.unwrap_or_default())
    }
}

/// Sends one fragment, which is a round; returns when it is acknowledged.
async fn feed(actor: &mut Actor) -> Result<(), BenchError> {
    let mut sent = false;
    loop {
        sent = sent || actor.offer();
        if actor.turn().await?.is_some() {
            return Ok(());
        }
    }
}
