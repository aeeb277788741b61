//! A learner in this process, and an actor whose street network is arithmetic instead of SUMO: same protocol, same policy.

#![allow(dead_code, reason = "each test program uses its part")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking, in their helpers too")]

use cross_config::Config;
use cross_learner::{Ending, Learner, Setup, find_checkpoint};
use cross_model::{ActMode, Policy};
use cross_proto::client::LearnerClient;
use cross_proto::v1::{self, stream_fragments_request as up, stream_fragments_response as down};
use cross_proto::weights::{Assembler, Snapshot};
use cross_sim::layout::{Intersection, Lane, Movement, NetworkLayout, Phase, Road};
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, Observation, RecurrentState};
use cross_support::server::ServerSecurity;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::transport::Channel;
use tonic::{Status, Streaming};

/// Nothing in these tests takes long; this only turns a hang into a failure.
const HANG: Duration = Duration::from_secs(60);

/// Waits, but not for ever.
pub(crate) async fn soon<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(HANG, future).await.unwrap_or_else(|_| panic!("{what} did not happen"))
}

/// An intersection with that many incoming lanes (and as many outgoing ones), each with a phase of its own.
fn intersection(id: &str, lanes: usize) -> Intersection {
    let lane = |side: &str, i: usize| Lane::new(format!("{id}_{side}_{i}"), 200.0, 13.9);
    let road = |side: &str, i: usize| Road {
        id: format!("{id}_{side}_{i}"),
        length: 200.0,
        speed: 13.9,
        lanes: 1,
        movements: 1,
    };
    let phase = |green: usize| Phase {
        state: (0..lanes).map(|i| if i == green { 'G' } else { 'r' }).collect(),
        green: (0..lanes).map(|i| if i == green { 1.0 } else { 0.0 }).collect(),
    };
    Intersection {
        id: id.to_owned(),
        position: (0.0, 0.0),
        incoming: (0..lanes).map(|i| lane("in", i)).collect(),
        outgoing: (0..lanes).map(|i| lane("out", i)).collect(),
        movements: (0..lanes).map(|i| Movement::new(i, i)).collect(),
        phases: (0..lanes).map(phase).collect(),
        roads_in: (0..lanes).map(|i| road("in", i)).collect(),
        roads_out: (0..lanes).map(|i| road("out", i)).collect(),
    }
}

/// Two intersections of different size.
pub(crate) fn layout() -> Arc<NetworkLayout> {
    Arc::new(NetworkLayout { intersections: vec![intersection("north", 4), intersection("south", 3)] })
}

/// Episodes of ten steps in two fragments, and an update after each, in milliseconds.
pub(crate) fn config(scenarios: &[&str], updates: u64) -> Config {
    let mut config = Config {
        seed: 7,
        scenarios: scenarios.iter().map(|name| (*name).to_owned()).collect(),
        updates,
        ..Config::default()
    };
    config.env.episode_seconds = 100;
    config.model.hidden = 16;
    config.model.latent = 8;
    config.model.heads = 2;
    config.model.clusters = 3;
    config.model.experts = 3;
    config.ppo.round_steps = 10;
    config.ppo.epochs = 2;
    config.ppo.sequence_steps = 5;
    config.ppo.minibatch_decisions = 10;
    config.actor.fragment_steps = 5;
    config.learner.checkpoint_updates = 1;
    config.validate().unwrap();
    config
}

/// A learner in this process.
pub(crate) struct TestLearner {
    learner: Learner,
    pub(crate) grpc: SocketAddr,
    pub(crate) metrics: SocketAddr,
    pub(crate) run: PathBuf,
    pub(crate) config: Config,
}

impl TestLearner {
    /// Starts a learner on free ports, resuming what is in `run`, and waits until it serves.
    pub(crate) async fn start(config: Config, run: &Path) -> Self {
        Self::start_with(config, run, ServerSecurity::default()).await
    }

    /// As [`start`](Self::start), with protected ports.
    pub(crate) async fn start_with(config: Config, run: &Path, security: ServerSecurity) -> Self {
        let learner = Self::launch(config, run, security).await;
        assert!(soon("ready", learner.learner.ready()).await);
        learner
    }

    /// As [`start`](Self::start), without waiting.
    pub(crate) async fn launch(config: Config, run: &Path, security: ServerSecurity) -> Self {
        let any = "127.0.0.1:0";
        let (grpc, metrics) = (TcpListener::bind(any).await.unwrap(), TcpListener::bind(any).await.unwrap());
        let addresses = (grpc.local_addr().unwrap(), metrics.local_addr().unwrap());
        let setup = Setup {
            scenarios: config.scenarios.iter().map(|name| (name.clone(), layout())).collect(),
            run: run.to_owned(),
            run_id: "test".to_owned(),
            resumed: find_checkpoint(run, &config).unwrap(),
            mirror: None,
            config: config.clone(),
            security,
        };
        let learner = Learner::start(setup, grpc, metrics).unwrap();
        Self { learner, grpc: addresses.0, metrics: addresses.1, run: run.to_owned(), config }
    }

    pub(crate) fn epoch(&self) -> u64 {
        self.learner.session_epoch()
    }

    pub(crate) fn drain(&self) -> CancellationToken {
        self.learner.drain()
    }

    pub(crate) async fn ended(self) -> Ending {
        soon("the end", self.learner.finished()).await
    }

    pub(crate) async fn channel(&self) -> Channel {
        Channel::from_shared(format!("http://{}", self.grpc)).unwrap().connect().await.unwrap()
    }

    /// Lines of `metrics.jsonl` without what depends on the clock.
    pub(crate) fn metrics_lines(run: &Path) -> Vec<serde_json::Value> {
        let text = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap_or_default();
        let timeless = |line: &str| {
            let mut line: serde_json::Value = serde_json::from_str(line).unwrap();
            let fields = line.as_object_mut().unwrap();
            assert!(fields.remove("time").is_some() && fields.remove("timing").is_some());
            line
        };
        text.lines().map(timeless).collect()
    }
}

/// A join request that agrees with the learner.
pub(crate) fn join_request(actor: &str) -> v1::JoinRequest {
    v1::JoinRequest {
        actor_id: actor.to_owned(),
        host: "test".to_owned(),
        versions: Some(v1::Versions {
            protocol: cross_proto::PROTOCOL_VERSION,
            cross: "test".to_owned(),
            sumo: "1.28.0".to_owned(),
            libtorch: String::new(),
        }),
        scenarios: Vec::new(),
        config_hash: String::new(),
    }
}

/// An actor with an open fragment stream.
pub(crate) struct TestActor {
    pub(crate) client: LearnerClient<Channel>,
    pub(crate) id: String,
    pub(crate) epoch: u64,
    pub(crate) joined: v1::JoinResponse,
    requests: mpsc::Sender<v1::StreamFragmentsRequest>,
    answers: Streaming<v1::StreamFragmentsResponse>,
    weights: Streaming<v1::WatchWeightsResponse>,
    policy: Option<Policy>,
}

impl TestActor {
    pub(crate) async fn join(learner: &TestLearner, id: &str) -> Self {
        let mut client = LearnerClient::new(learner.channel().await);
        let joined = client.join(join_request(id)).await.unwrap().into_inner();
        let request = v1::WatchWeightsRequest { actor_id: id.to_owned(), known_version: 0 };
        let weights = client.watch_weights(request).await.unwrap().into_inner();
        let epoch = joined.session_epoch;
        let (requests, answers) = open(&mut client, id, epoch).await.unwrap();
        Self { client, id: id.to_owned(), epoch, joined, requests, answers, weights, policy: None }
    }

    /// Opens another stream under the same lease.
    pub(crate) async fn reconnect(&mut self) {
        (self.requests, self.answers) = open(&mut self.client, &self.id, self.epoch).await.unwrap();
    }

    pub(crate) async fn say(&self, message: up::Message) {
        let request = v1::StreamFragmentsRequest { message: Some(message) };
        soon("sending", self.requests.send(request)).await.unwrap();
    }

    /// Closes this side of the stream.
    pub(crate) fn hang_up(&mut self) {
        self.requests = mpsc::channel(1).0;
    }

    pub(crate) async fn hear(&mut self) -> Result<Option<down::Message>, Status> {
        let answer = soon("an answer", self.answers.message()).await?;
        Ok(answer.and_then(|answer| answer.message))
    }

    pub(crate) async fn ask_for_episode(&mut self) -> v1::EpisodeAssignment {
        self.say(up::Message::EpisodeRequest(v1::EpisodeRequest {})).await;
        match self.hear().await.unwrap() {
            Some(down::Message::Assignment(assignment)) => assignment,
            other => panic!("{other:?}"),
        }
    }

    pub(crate) async fn ack(&mut self) -> v1::Ack {
        match self.hear().await.unwrap() {
            Some(down::Message::Ack(ack)) => ack,
            other => panic!("{other:?}"),
        }
    }

    pub(crate) async fn send(&mut self, fragment: v1::Fragment) -> v1::Ack {
        self.say(up::Message::Fragment(fragment)).await;
        self.ack().await
    }

    /// The next whole snapshot.
    pub(crate) async fn snapshot(&mut self) -> Snapshot {
        let mut assembler = Assembler::new(1 << 30);
        loop {
            let chunk = soon("weights", self.weights.message()).await.unwrap().unwrap();
            if let Some(snapshot) = assembler.push(&chunk).unwrap() {
                return snapshot;
            }
        }
    }

    /// Holds at least this version of the policy.
    pub(crate) async fn hold_version(&mut self, version: u64) {
        while self.policy.as_ref().is_none_or(|policy| policy.version() < version) {
            let snapshot = self.snapshot().await;
            match &mut self.policy {
                Some(policy) => policy.replace_weights(&snapshot.bytes).unwrap(),
                None => self.policy = Some(Policy::from_snapshot(&snapshot.bytes).unwrap()),
            }
        }
    }

    /// The fragments of an assigned episode, acted by the policy in a network made of the episode's seeds.
    pub(crate) async fn episode(
        &mut self,
        config: &Config,
        assignment: &v1::EpisodeAssignment,
    ) -> Vec<v1::Fragment> {
        self.hold_version(assignment.min_policy_version.max(1)).await;
        let fragments = simulate(self.policy.as_mut().unwrap(), config, assignment, &self.id, self.epoch);
        fragments.iter().map(v1::Fragment::from).collect()
    }

    /// Works as an actor does until the learner says goodbye; whether training was complete.
    pub(crate) async fn work(&mut self, config: &Config) -> bool {
        loop {
            self.say(up::Message::EpisodeRequest(v1::EpisodeRequest {})).await;
            let assignment = match self.hear().await.unwrap() {
                Some(down::Message::Assignment(assignment)) => assignment,
                Some(down::Message::Goodbye(goodbye)) => return goodbye.complete,
                other => panic!("{other:?}"),
            };
            for fragment in self.episode(config, &assignment).await {
                self.say(up::Message::Fragment(fragment)).await;
                match self.hear().await.unwrap() {
                    Some(down::Message::Ack(ack)) => self.hold_version(ack.min_policy_version).await,
                    Some(down::Message::Goodbye(goodbye)) => return goodbye.complete,
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}

/// Opens a fragment stream.
pub(crate) async fn open(
    client: &mut LearnerClient<Channel>,
    id: &str,
    epoch: u64,
) -> Result<(mpsc::Sender<v1::StreamFragmentsRequest>, Streaming<v1::StreamFragmentsResponse>), Status> {
    let (requests, receiver) = mpsc::channel(8);
    let hello = up::Message::Hello(v1::StreamHello { actor_id: id.to_owned(), session_epoch: epoch });
    requests.send(v1::StreamFragmentsRequest { message: Some(hello) }).await.unwrap();
    let answers = soon("a stream", client.stream_fragments(ReceiverStream::new(receiver))).await?;
    Ok((requests, answers.into_inner()))
}

/// Vehicles come at random and leave on green: enough for a policy to have something to do.
fn simulate(
    policy: &mut Policy,
    config: &Config,
    assignment: &v1::EpisodeAssignment,
    actor: &str,
    session_epoch: u64,
) -> Vec<Fragment> {
    let layout = layout();
    let bands = config.env.detection.bands();
    let mut traffic = ChaCha8Rng::seed_from_u64(u64::from(assignment.sumo_seed));
    let mut choice = ChaCha8Rng::seed_from_u64(assignment.action_seed);
    let mut observation =
        Observation { counts: vec![0; layout.lane_rows() * bands], phases: vec![0; layout.agents()] };
    policy.begin_episode(&layout).unwrap();
    let (steps, length) = (config.env.steps_per_episode(), config.actor.fragment_steps);
    let mut fragments = Vec::new();
    for (sequence, first_step) in (0..steps).step_by(length as usize).enumerate() {
        let recurrent = if first_step == 0 { RecurrentState::default() } else { policy.recurrent_state() };
        let mut fragment = Fragment {
            id: FragmentId {
                actor: actor.to_owned(),
                session_epoch,
                episode: assignment.episode,
                sequence: u32::try_from(sequence).unwrap(),
            },
            scenario: assignment.scenario.clone(),
            layout_hash: layout.hash(),
            policy_version: policy.version(),
            first_step,
            steps: length.min(steps - first_step),
            counts: observation.counts.clone(),
            phases: observation.phases.clone(),
            actions: Vec::new(),
            log_probs: Vec::new(),
            rewards: Vec::new(),
            recurrent,
            end: FragmentEnd::Continues,
        };
        for _ in 0..fragment.steps {
            let decision = policy.act(&observation, ActMode::Sample(&mut choice)).unwrap();
            fragment.actions.extend(&decision.actions);
            fragment.log_probs.extend(&decision.log_probs);
            let mut row = 0;
            for (intersection, &action) in layout.intersections.iter().zip(&decision.actions) {
                let mut stopped = 0;
                for lane in 0..intersection.lanes() {
                    let count = &mut observation.counts[(row + lane) * bands];
                    *count += u16::from(traffic.next_u32() % 3 == 0);
                    if lane == usize::from(action) || lane >= intersection.incoming.len() {
                        *count = 0;
                    }
                    stopped += *count;
                }
                fragment.rewards.push(-f32::from(stopped));
                row += intersection.lanes();
            }
            observation.phases.clone_from(&decision.actions);
            fragment.counts.extend(&observation.counts);
            fragment.phases.extend(&observation.phases);
        }
        if first_step + fragment.steps == steps {
            fragment.end = FragmentEnd::Truncated;
        }
        fragments.push(fragment);
    }
    fragments
}
