//! A relay between one real actor and the learner, which sends the actor's fragments twice, or the second before the first,
//! when it is told to. A gRPC stream never does that by itself; a proxy or a client of somebody else's might.

use cross_proto::client::LearnerClient;
use cross_proto::server::{Learner, LearnerServer};
use cross_proto::v1::stream_fragments_request::Message;
use cross_proto::v1::{self, StreamFragmentsRequest, StreamFragmentsResponse, WatchWeightsResponse};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::transport::{Channel, Endpoint, Server};
use tonic::{Request, Response, Status, Streaming};

/// What the relay does to fragments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Mischief {
    /// Nothing.
    None = 0,
    /// Sends each twice.
    Duplicate = 1,
    /// Sends each after the one that follows it.
    Reorder = 2,
}

/// How long a fragment is held back for its successor.
const HELD: Duration = Duration::from_millis(700);
/// Large enough for anything.
const MESSAGE: usize = 64 << 20;

#[derive(Debug, Default)]
struct State {
    mischief: AtomicU8,
    done: AtomicU64,
}

/// The relay; ended with its thread when dropped.
#[derive(Debug)]
pub(super) struct Relay {
    state: Arc<State>,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
}

impl Relay {
    /// Listens on a port of the namespace of the calling thread, for a learner that need not be there yet.
    pub(super) fn start(port: u16, learner: &str) -> Self {
        let state = Arc::new(State::default());
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let (own, learner) = (Arc::clone(&state), format!("http://{learner}"));
        std::thread::Builder::new()
            .name("relay".to_owned())
            .spawn(move || serve(port, learner, own, stopped))
            .unwrap();
        Self { state, stop: Some(stop) }
    }

    /// From now on.
    pub(super) fn set(&self, mischief: Mischief) {
        self.state.mischief.store(mischief as u8, Ordering::Relaxed);
    }

    /// How many fragments it has sent twice or out of order.
    pub(super) fn done(&self) -> u64 {
        self.state.done.load(Ordering::Relaxed)
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
    }
}

fn serve(port: u16, learner: String, state: Arc<State>, stopped: tokio::sync::oneshot::Receiver<()>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let endpoint = Endpoint::from_shared(learner).unwrap().connect_timeout(Duration::from_secs(2));
        let service = Service { learner: endpoint, state };
        let service =
            LearnerServer::new(service).max_decoding_message_size(MESSAGE).max_encoding_message_size(MESSAGE);
        let served = Server::builder().add_service(service).serve(([0, 0, 0, 0], port).into());
        tokio::select! {
            served = served => served.unwrap(),
            _ = stopped => {}
        }
    });
}

struct Service {
    learner: Endpoint,
    state: Arc<State>,
}

impl Service {
    /// A connection of its own for each call: one that broke must not be met again.
    async fn client(&self) -> Result<LearnerClient<Channel>, Status> {
        let channel = self.learner.connect().await;
        let channel =
            channel.map_err(|error| Status::unavailable(format!("no learner behind the relay: {error}")))?;
        Ok(LearnerClient::new(channel).max_decoding_message_size(MESSAGE).max_encoding_message_size(MESSAGE))
    }
}

type Boxed<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

#[tonic::async_trait]
impl Learner for Service {
    type StreamFragmentsStream = Boxed<StreamFragmentsResponse>;
    type WatchWeightsStream = Boxed<WatchWeightsResponse>;

    async fn join(&self, request: Request<v1::JoinRequest>) -> Result<Response<v1::JoinResponse>, Status> {
        let joined = self.client().await?.join(request.into_inner()).await?;
        Ok(Response::new(joined.into_inner()))
    }

    async fn stream_fragments(
        &self,
        request: Request<Streaming<StreamFragmentsRequest>>,
    ) -> Result<Response<Self::StreamFragmentsStream>, Status> {
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(forward(request.into_inner(), sender, Arc::clone(&self.state)));
        let answers = self.client().await?.stream_fragments(ReceiverStream::new(receiver)).await?;
        Ok(Response::new(Box::pin(answers.into_inner())))
    }

    async fn watch_weights(
        &self,
        request: Request<v1::WatchWeightsRequest>,
    ) -> Result<Response<Self::WatchWeightsStream>, Status> {
        let weights = self.client().await?.watch_weights(request.into_inner()).await?;
        Ok(Response::new(Box::pin(weights.into_inner())))
    }
}

/// Passes on what an actor says, with mischief.
async fn forward(
    mut actor: Streaming<StreamFragmentsRequest>,
    learner: mpsc::Sender<StreamFragmentsRequest>,
    state: Arc<State>,
) {
    let mut held: Option<StreamFragmentsRequest> = None;
    loop {
        let next = if held.is_some() {
            tokio::time::timeout(HELD, actor.next()).await
        } else {
            Ok(actor.next().await)
        };
        let mut messages = Vec::new();
        let over = match next {
            // The learner's end of the call breaks with this one.
            Ok(None | Some(Err(_))) => true,
            Ok(Some(Ok(message))) => {
                let is_fragment = matches!(message.message, Some(Message::Fragment(_)));
                let mischief = state.mischief.load(Ordering::Relaxed);
                if is_fragment && held.is_none() && mischief == Mischief::Reorder as u8 {
                    held = Some(message);
                    continue;
                }
                let twice = is_fragment && mischief == Mischief::Duplicate as u8;
                state.done.fetch_add(u64::from(twice || (is_fragment && held.is_some())), Ordering::Relaxed);
                messages.extend(twice.then(|| message.clone()));
                messages.push(message);
                messages.extend(held.take());
                false
            }
            // Nothing followed.
            Err(_) => {
                messages.extend(held.take());
                false
            }
        };
        for message in messages {
            if learner.send(message).await.is_err() {
                return;
            }
        }
        if over {
            return;
        }
    }
}
