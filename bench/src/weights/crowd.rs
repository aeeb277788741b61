//! Watchers: real clients of `WatchWeights`, each putting its snapshots together and checking them.

use crate::cluster::client::{self, failed};
use crate::error::BenchError;
use bytes::Bytes;
use cross_proto::v1;
use cross_proto::weights::Assembler;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::sync::{Semaphore, mpsc};
use tokio::task::JoinSet;
use tonic::Status;

/// Watchers that connect at the same time.
const CONNECTING: usize = 64;
/// Largest snapshot, bytes.
const MOST_BYTES: usize = 1 << 30;
/// How long all watchers may take to get a version.
const PATIENCE: Duration = Duration::from_secs(120);
/// Snapshots that wait to be counted.
const ARRIVALS: usize = 1024;

/// A snapshot that a watcher has whole and checked.
#[derive(Debug)]
struct Arrival {
    version: u64,
    /// Unix time, seconds: the server's clock, which is this machine's.
    at: f64,
    bytes: Bytes,
}

/// Watchers, each a task.
#[derive(Debug)]
pub(super) struct Crowd {
    arrivals: mpsc::Receiver<Arrival>,
    tasks: JoinSet<Result<(), BenchError>>,
    snapshot: Bytes,
    watchers: usize,
}

impl Crowd {
    /// Starts the watchers.
    pub(super) fn open(address: &str, watchers: usize) -> Self {
        let (sender, arrivals) = mpsc::channel(ARRIVALS);
        let places = Arc::new(Semaphore::new(CONNECTING));
        let mut tasks = JoinSet::new();
        for number in 0..watchers {
            let (address, places, sender) = (address.to_owned(), Arc::clone(&places), sender.clone());
            tasks.spawn(async move {
                // Nobody closes the semaphore.
                let place = places.acquire_owned().await.ok();
                let mut learner = client::learner(client::connect(&address).await?);
                let request =
                    v1::WatchWeightsRequest { actor_id: format!("watcher-{number}"), known_version: 0 };
                let chunks = learner.watch_weights(request).await.map_err(failed("WatchWeights"))?;
                drop(place);
                watch(chunks.into_inner(), &sender).await
            });
        }
        Self { arrivals, tasks, snapshot: Bytes::new(), watchers }
    }

    /// Waits until every watcher has `version`; when the last had it, Unix time in seconds.
    pub(super) async fn all_have(&mut self, version: u64) -> Result<f64, BenchError> {
        let (mut have, mut last) = (0, 0.0_f64);
        while have < self.watchers {
            let arrival = tokio::select! {
                arrival = self.arrivals.recv() => arrival,
                // One that ends has failed.
                Some(ended) = self.tasks.join_next() => {
                    ended.map_err(|error| BenchError::Runtime { source: std::io::Error::other(error) })??;
                    None
                }
                () = tokio::time::sleep(PATIENCE) => None,
            };
            let Some(arrival) = arrival else {
                let (waiting, seconds) = (self.watchers - have, PATIENCE.as_secs());
                let what = "a new version";
                return Err(BenchError::Unserved { waiting, clients: self.watchers, what, seconds });
            };
            if arrival.version == version {
                have += 1;
                last = last.max(arrival.at);
                self.snapshot = arrival.bytes;
            }
        }
        Ok(last)
    }

    /// Ends the watchers; the newest snapshot.
    pub(super) fn close(self) -> Vec<u8> {
        self.snapshot.to_vec()
    }
}

/// Tells of every snapshot, until nobody listens.
async fn watch(
    mut chunks: tonic::Streaming<v1::WatchWeightsResponse>,
    arrivals: &mpsc::Sender<Arrival>,
) -> Result<(), BenchError> {
    let mut assembler = Assembler::new(MOST_BYTES);
    loop {
        let message = chunks.message().await.map_err(failed("WatchWeights"))?;
        let Some(chunk) = message else {
            return Err(failed("WatchWeights")(Status::unavailable("the stream ended")));
        };
        let whole = assembler
            .push(&chunk)
            .map_err(|violation| BenchError::Snapshot { problem: violation.to_string() })?;
        let Some(snapshot) = whole else { continue };
        let at = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        let arrival = Arrival { version: snapshot.policy_version, at, bytes: snapshot.bytes };
        if arrivals.send(arrival).await.is_err() {
            return Ok(());
        }
    }
}
