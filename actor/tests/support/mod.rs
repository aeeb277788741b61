//! A learner whose every word the test decides; the actor, its SUMO, its policy and the wire between them are real.
#![allow(dead_code, reason = "each test file uses its own part of this")]

use bytes::Bytes;
use cross_config::{Config, Gfe};
use cross_model::Trainer;
use cross_proto::server::{Learner, LearnerServer};
use cross_proto::v1::stream_fragments_request::Message;
use cross_proto::v1::stream_fragments_response::Message as Answer;
use cross_proto::{v1, weights};
use cross_sim::layout::{NetworkLayout, load_layout};
use cross_sim::scenario::Scenario;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream};
use tonic::{Request, Response, Status, Streaming};

/// The scenario of these tests.
pub(crate) const SCENARIO: &str = "grid4x4";

/// A small network and episodes of ten decisions in fragments of four.
pub(crate) fn small_config() -> Config {
    let mut config = Config { scenarios: vec![SCENARIO.to_owned()], ..Config::default() };
    config.env.episode_seconds = 100;
    config.ppo.sequence_steps = 5;
    config.ppo.round_steps = 10;
    config.model.gfe = Gfe::Movement;
    config.model.hidden = 32;
    config.actor.fragment_steps = 4;
    // A whole episode, so that it can be sent before anything is acknowledged.
    config.actor.unacked_fragments = 3;
    config.validate().unwrap();
    config
}

/// What a learner of that configuration would send.
pub(crate) struct World {
    pub(crate) config: Config,
    pub(crate) layout: Arc<NetworkLayout>,
    pub(crate) weights: Bytes,
}

impl World {
    pub(crate) fn new(config: Config) -> Self {
        let scenario = Scenario::load(SCENARIO).expect("run `make build` first: it fetches the maps");
        let layout = load_layout(&scenario, &config.env).unwrap();
        let trainer = Trainer::new(&config, vec![(SCENARIO.to_owned(), Arc::clone(&layout))]).unwrap();
        let weights = Bytes::from(trainer.snapshot().unwrap());
        Self { config, layout, weights }
    }

    pub(crate) fn small() -> Self {
        Self::new(small_config())
    }

    pub(crate) fn snapshot(&self, policy_version: u64) -> Vec<v1::WatchWeightsResponse> {
        weights::split(&weights::Snapshot { policy_version, bytes: self.weights.clone() })
    }

    pub(crate) fn admission(&self, session_epoch: u64) -> v1::JoinResponse {
        v1::JoinResponse {
            run_id: "test".to_owned(),
            session_epoch,
            config_json: self.config.to_json(),
            config_hash: self.config.compatibility_hash(),
            scenarios: vec![v1::ScenarioInfo {
                name: SCENARIO.to_owned(),
                layout_hash: self.layout.hash(),
                agents: 16,
            }],
            limits: Some(v1::Limits {
                unacked_fragments: self.config.actor.unacked_fragments as u32,
                fragment_steps: self.config.actor.fragment_steps,
                max_message_bytes: self.config.learner.max_message_bytes as u64,
                lease_seconds: self.config.learner.lease_seconds as u32,
            }),
            versions: None,
            policy_version: 1,
        }
    }

    pub(crate) fn assignment(&self, episode: u64) -> v1::EpisodeAssignment {
        v1::EpisodeAssignment {
            episode,
            scenario: SCENARIO.to_owned(),
            sumo_seed: 1_000_007,
            action_seed: 11,
            min_policy_version: 0,
        }
    }
}

/// The learner's end of one fragment stream.
pub(crate) struct Conversation {
    inbound: Streaming<v1::StreamFragmentsRequest>,
    outbound: mpsc::Sender<Result<v1::StreamFragmentsResponse, Status>>,
}

impl Conversation {
    /// The next message that is not a heartbeat; `None` once the actor has closed its side.
    pub(crate) async fn heard(&mut self) -> Option<Message> {
        loop {
            match self.inbound.message().await.ok().flatten()?.message.unwrap() {
                Message::Heartbeat(_) => {}
                message => return Some(message),
            }
        }
    }

    pub(crate) async fn hello(&mut self) -> u64 {
        match self.heard().await {
            Some(Message::Hello(hello)) => hello.session_epoch,
            other => panic!("expected a hello, got {other:?}"),
        }
    }

    pub(crate) async fn request(&mut self) {
        let heard = self.heard().await;
        assert!(matches!(heard, Some(Message::EpisodeRequest(_))), "expected a request, got {heard:?}");
    }

    pub(crate) async fn fragment(&mut self) -> v1::Fragment {
        match self.heard().await {
            Some(Message::Fragment(fragment)) => fragment,
            other => panic!("expected a fragment, got {other:?}"),
        }
    }

    pub(crate) async fn aborted(&mut self) -> (u64, String) {
        match self.heard().await {
            Some(Message::EpisodeAborted(aborted)) => (aborted.episode, aborted.reason),
            other => panic!("expected an abort, got {other:?}"),
        }
    }

    pub(crate) async fn say(&self, answer: Answer) {
        // An actor that has left hears no more.
        let _ = self.outbound.send(Ok(v1::StreamFragmentsResponse { message: Some(answer) })).await;
    }

    pub(crate) async fn acknowledge(&self, fragment: &v1::Fragment, outcome: v1::Outcome) {
        self.say(Answer::Ack(v1::Ack {
            episode: fragment.episode,
            sequence: fragment.sequence,
            outcome: outcome.into(),
            min_policy_version: 0,
        }))
        .await;
    }

    pub(crate) async fn fail(self, status: Status) {
        let _ = self.outbound.send(Err(status)).await;
    }
}

struct State {
    admission: Mutex<Result<v1::JoinResponse, Status>>,
    snapshot: watch::Receiver<Vec<v1::WatchWeightsResponse>>,
    joins: mpsc::Sender<v1::JoinRequest>,
    conversations: mpsc::Sender<Conversation>,
}

/// A scripted learner that listens.
pub(crate) struct Scripted {
    pub(crate) address: SocketAddr,
    pub(crate) joins: mpsc::Receiver<v1::JoinRequest>,
    pub(crate) conversations: mpsc::Receiver<Conversation>,
    snapshot: watch::Sender<Vec<v1::WatchWeightsResponse>>,
    state: Arc<State>,
}

impl Scripted {
    pub(crate) async fn start(
        admission: Result<v1::JoinResponse, Status>,
        snapshot: Vec<v1::WatchWeightsResponse>,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (join, joins) = mpsc::channel(64);
        let (conversation, conversations) = mpsc::channel(64);
        let (snapshot, published) = watch::channel(snapshot);
        let admission = Mutex::new(admission);
        let state =
            Arc::new(State { admission, snapshot: published, joins: join, conversations: conversation });
        let service = LearnerServer::from_arc(Arc::clone(&state));
        tokio::spawn(
            tonic::transport::Server::builder()
                .add_service(service)
                .serve_with_incoming(TcpListenerStream::new(listener)),
        );
        Self { address, joins, conversations, snapshot, state }
    }

    /// A learner of `world` in session 1 with weights of version 1.
    pub(crate) async fn of(world: &World) -> Self {
        Self::start(Ok(world.admission(1)), world.snapshot(1)).await
    }

    pub(crate) fn admit(&self, admission: Result<v1::JoinResponse, Status>) {
        *self.state.admission.lock().unwrap() = admission;
    }

    pub(crate) fn publish(&self, snapshot: Vec<v1::WatchWeightsResponse>) {
        self.snapshot.send_replace(snapshot);
    }

    /// The next fragment stream.
    pub(crate) async fn conversation(&mut self) -> Conversation {
        self.conversations.recv().await.unwrap()
    }

    /// The next fragment stream after its hello and request of an episode.
    pub(crate) async fn ready(&mut self, epoch: u64) -> Conversation {
        let mut conversation = self.conversation().await;
        assert_eq!(conversation.hello().await, epoch);
        conversation.request().await;
        conversation
    }
}

#[tonic::async_trait]
impl Learner for State {
    type StreamFragmentsStream = ReceiverStream<Result<v1::StreamFragmentsResponse, Status>>;
    type WatchWeightsStream = ReceiverStream<Result<v1::WatchWeightsResponse, Status>>;

    async fn join(&self, request: Request<v1::JoinRequest>) -> Result<Response<v1::JoinResponse>, Status> {
        let _ = self.joins.send(request.into_inner()).await;
        self.admission.lock().unwrap().clone().map(Response::new)
    }

    async fn stream_fragments(
        &self,
        request: Request<Streaming<v1::StreamFragmentsRequest>>,
    ) -> Result<Response<Self::StreamFragmentsStream>, Status> {
        let (outbound, answers) = mpsc::channel(16);
        let conversation = Conversation { inbound: request.into_inner(), outbound };
        let _ = self.conversations.send(conversation).await;
        Ok(Response::new(ReceiverStream::new(answers)))
    }

    async fn watch_weights(
        &self,
        _: Request<v1::WatchWeightsRequest>,
    ) -> Result<Response<Self::WatchWeightsStream>, Status> {
        let (sender, chunks) = mpsc::channel(4);
        let mut published = self.snapshot.clone();
        published.mark_changed();
        tokio::spawn(async move {
            while published.changed().await.is_ok() {
                let snapshot = published.borrow_and_update().clone();
                for chunk in snapshot {
                    if sender.send(Ok(chunk)).await.is_err() {
                        return;
                    }
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(chunks)))
    }
}
