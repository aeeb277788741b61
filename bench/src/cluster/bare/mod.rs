//! The baseline: tonic alone. The same settings and messages as the learner's server, and nothing behind them.
//!
//! `StreamFragments` reads each message as bytes, without looking into it, and acknowledges it; told to, it also keeps them, as
//! whoever is to learn from them must, and `episodes` of `GetStatus` is how many it has. `WatchWeights` sends the same
//! snapshot as messages that tonic encodes for every stream, as a service does that leaves this to tonic. `Training` steers
//! it: `Resume` publishes the snapshot under the next version; in `GetStatus`, `updates` is how many messages were encoded and
//! `uptime_seconds` when the newest version was published, Unix time.

mod raw;

use super::{Programs, Server};
use crate::error::BenchError;
use crate::folder::folder;
use bytes::Bytes;
use cross_config::Config;
use cross_proto::server::{Learner, LearnerServer, Training, TrainingServer};
use cross_proto::v1;
use cross_proto::weights::{Snapshot, split};
use cross_support::files::replace_file;
use futures::stream::{BoxStream, StreamExt, unfold};
use raw::{Kept, Raw};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::transport::Server as Tonic;
use tonic::{Request, Response, Status, Streaming};

/// File in the server's folder that tells `host:port`.
const ADDRESS: &str = "address";
/// File in the server's folder with the bytes that are published as weights.
const SNAPSHOT: &str = "snapshot";
/// File in the server's folder whose presence has it keep the fragments that come.
const KEEP: &str = "keep";
/// As the learner's.
const CALLS_A_CONNECTION: u32 = 100;

/// The server, as the process that measures sees it.
#[derive(Debug)]
pub(crate) struct BareServer {
    pub(crate) server: Server,
    /// `host:port`.
    pub(crate) address: String,
}

/// What the server does with a fragment that it has read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fragments {
    /// Nothing: its memory is used again at once.
    Dropped,
    /// Kept until the server ends.
    Kept,
}

impl BareServer {
    /// Starts one that has these bytes for weights.
    pub(crate) async fn start(
        programs: &Programs,
        snapshot: &[u8],
        fragments: Fragments,
    ) -> Result<Self, BenchError> {
        let folder = folder()?;
        let write = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).map_err(|source| BenchError::Write { path, source })
        };
        write(SNAPSHOT, snapshot)?;
        if fragments == Fragments::Kept {
            write(KEEP, b"")?;
        }
        let (program, arguments) = &programs.bare;
        let mut arguments = arguments.clone();
        arguments.push(folder.path().into());
        let mut server = Server::start("the bare server", program, folder, &arguments)?;
        let address = server.ready(|folder, _| std::fs::read_to_string(folder.join(ADDRESS)).ok()).await?;
        Ok(Self { server, address })
    }
}

/// Serves what lies in `folder`, until the process is ended.
///
/// # Errors
/// [`BenchError`] if the snapshot cannot be read or nothing be listened to.
pub fn serve(folder: &Path) -> Result<(), BenchError> {
    let path = folder.join(SNAPSHOT);
    let snapshot = std::fs::read(&path).map_err(|source| BenchError::Read { path, source })?;
    cross_support::open_files::raise();
    let runtime = |source| BenchError::Runtime { source };
    let threads = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(runtime)?;
    threads.block_on(async {
        let listener = TcpListener::bind("127.0.0.1:0").await.map_err(runtime)?;
        let address = listener.local_addr().map_err(runtime)?.to_string();
        let path = folder.join(ADDRESS);
        replace_file(&path, address.as_bytes()).map_err(|source| BenchError::Write { path, source })?;
        let incoming = TcpListenerStream::new(listener).map(|stream| {
            stream.inspect(|stream| {
                // As the learner; one without is slower and works.
                let _ = stream.set_nodelay(true);
            })
        });
        let config = Config::default().learner;
        let keepalive = Duration::from_secs(config.lease_seconds).div_f64(3.0);
        let kept = folder.join(KEEP).exists().then(Kept::default);
        let bare = Bare::new(snapshot.into(), kept.clone());
        let learner = LearnerServer::new(bare.clone()).max_encoding_message_size(config.max_message_bytes);
        Tonic::builder()
            .http2_keepalive_interval(Some(keepalive))
            .http2_keepalive_timeout(Some(keepalive))
            .max_concurrent_streams(CALLS_A_CONNECTION)
            .add_service(Raw::new(learner, config.max_message_bytes, kept))
            .add_service(TrainingServer::new(bare))
            .serve_with_incoming(incoming)
            .await
            .map_err(|source| BenchError::BareServer { source })
    })
}

/// Weights, and nothing else.
#[derive(Debug, Clone)]
struct Bare {
    snapshot: Bytes,
    newest: watch::Sender<Arc<Vec<v1::WatchWeightsResponse>>>,
    /// Messages that were handed to tonic, each of which it encodes.
    encoded: Arc<AtomicU64>,
    /// When the newest was published, microseconds since 1970.
    published: Arc<AtomicU64>,
    kept: Option<Kept>,
}

impl Bare {
    fn new(snapshot: Bytes, kept: Option<Kept>) -> Self {
        let newest = watch::channel(Arc::new(cut(1, &snapshot))).0;
        Self { snapshot, newest, encoded: Arc::default(), published: Arc::default(), kept }
    }
}

fn cut(policy_version: u64, bytes: &Bytes) -> Vec<v1::WatchWeightsResponse> {
    split(&Snapshot { policy_version, bytes: bytes.clone() })
}

type Stream<T> = BoxStream<'static, Result<T, Status>>;

#[tonic::async_trait]
impl Learner for Bare {
    type StreamFragmentsStream = Stream<v1::StreamFragmentsResponse>;
    type WatchWeightsStream = Stream<v1::WatchWeightsResponse>;

    async fn join(&self, _: Request<v1::JoinRequest>) -> Result<Response<v1::JoinResponse>, Status> {
        Err(Status::unimplemented("there is nothing to join"))
    }

    async fn stream_fragments(
        &self,
        _: Request<Streaming<v1::StreamFragmentsRequest>>,
    ) -> Result<Response<Self::StreamFragmentsStream>, Status> {
        Err(Status::unimplemented("fragments are taken as bytes"))
    }

    async fn watch_weights(
        &self,
        request: Request<v1::WatchWeightsRequest>,
    ) -> Result<Response<Self::WatchWeightsStream>, Status> {
        let (mut newest, encoded) = (self.newest.subscribe(), Arc::clone(&self.encoded));
        let known = request.into_inner().known_version;
        if newest.borrow().first().is_none_or(|first| first.policy_version != known) {
            newest.mark_changed();
        } else {
            newest.mark_unchanged();
        }
        let state = (newest, Arc::new(Vec::new()), 0, encoded);
        let stream = unfold(state, |(mut newest, mut sending, mut at, encoded)| async move {
            loop {
                if let Some(message) = sending.get(at).cloned() {
                    encoded.fetch_add(1, Ordering::Relaxed);
                    return Some((Ok(message), (newest, sending, at + 1, encoded)));
                }
                newest.changed().await.ok()?;
                sending = newest.borrow_and_update().clone();
                at = 0;
            }
        });
        Ok(Response::new(stream.boxed()))
    }
}

#[tonic::async_trait]
impl Training for Bare {
    type WatchProgressStream = Stream<v1::WatchProgressResponse>;

    async fn get_status(
        &self,
        _: Request<v1::GetStatusRequest>,
    ) -> Result<Response<v1::GetStatusResponse>, Status> {
        let version = self.newest.borrow().first().map_or(0, |first| first.policy_version);
        let status = v1::TrainingStatus {
            policy_version: version,
            updates: self.encoded.load(Ordering::Relaxed),
            episodes: self.kept.as_ref().map_or(0, raw::kept),
            uptime_seconds: self.published.load(Ordering::Relaxed) as f64 / 1e6,
            ..v1::TrainingStatus::default()
        };
        Ok(Response::new(v1::GetStatusResponse { status: Some(status) }))
    }

    async fn resume(&self, _: Request<v1::ResumeRequest>) -> Result<Response<v1::ResumeResponse>, Status> {
        let version = self.newest.borrow().first().map_or(0, |first| first.policy_version);
        let next = Arc::new(cut(version + 1, &self.snapshot));
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_micros();
        self.published.store(u64::try_from(now).unwrap_or(u64::MAX), Ordering::Relaxed);
        self.newest.send_replace(next);
        Ok(Response::new(v1::ResumeResponse {}))
    }

    async fn watch_progress(
        &self,
        _: Request<v1::WatchProgressRequest>,
    ) -> Result<Response<Self::WatchProgressStream>, Status> {
        Err(Status::unimplemented("there is no progress"))
    }

    async fn pause(&self, _: Request<v1::PauseRequest>) -> Result<Response<v1::PauseResponse>, Status> {
        Err(Status::unimplemented("there is nothing to pause"))
    }

    async fn checkpoint_now(
        &self,
        _: Request<v1::CheckpointNowRequest>,
    ) -> Result<Response<v1::CheckpointNowResponse>, Status> {
        Err(Status::unimplemented("there is nothing to keep"))
    }
}
