//! A real learner and a client that behaves badly.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_config::Config;
use cross_proto::client::{LearnerClient, TrainingClient};
use cross_proto::v1::{
    EpisodeAssignment, EpisodeRequest, Fragment as WireFragment, GetStatusRequest, JoinRequest, JoinResponse,
    StreamFragmentsRequest, StreamFragmentsResponse, StreamHello, Versions, stream_fragments_request,
    stream_fragments_response,
};
use cross_sim::layout::load_layout;
use cross_sim::scenario::Scenario;
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, RecurrentState};
use cross_tests::binaries;
use cross_tests::processes::assert_none_left;
use cross_tests::runs::Run;
use cross_tests::wait;
use std::process::{Child, Stdio};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;
use tonic::{Code, Status, Streaming};
use tonic_types::StatusExt;

/// A learner without actors.
struct Learner<'a> {
    run: &'a Run,
    child: Child,
    address: String,
}

impl<'a> Learner<'a> {
    fn start(run: &'a Run) -> Self {
        std::fs::create_dir_all(run.path()).unwrap();
        let child = binaries::command("cross-learner")
            .arg("--config")
            .arg(run.config())
            .arg("--run")
            .arg(run.path())
            .args(["--listen", "127.0.0.1:0"])
            .env("CROSS_TEST_RUN", run.marker())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut learner = Self { run, child, address: String::new() };
        let file = run.path().join("learner.json");
        learner.address = wait::until("learner.json", || {
            let ended = learner.child.try_wait().unwrap();
            assert!(ended.is_none(), "the learner ended: {ended:?}");
            let value: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).ok()?).ok()?;
            Some(value["grpc"].as_str()?.trim_start_matches("http://").to_owned())
        });
        learner
    }

    async fn channel(&self) -> Channel {
        Channel::from_shared(format!("http://{}", self.address)).unwrap().connect().await.unwrap()
    }

    /// The learner is as well as before.
    async fn assert_serves(&mut self) {
        assert!(self.child.try_wait().unwrap().is_none(), "the learner ended");
        let mut training = TrainingClient::new(self.channel().await);
        training.get_status(GetStatusRequest {}).await.unwrap();
    }
}

impl Drop for Learner<'_> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        assert_none_left(&self.run.marker());
    }
}

fn join_request(actor: &str) -> JoinRequest {
    JoinRequest {
        actor_id: actor.to_owned(),
        host: "test".to_owned(),
        versions: Some(Versions {
            protocol: cross_proto::PROTOCOL_VERSION,
            cross: env!("CARGO_PKG_VERSION").to_owned(),
            sumo: "1.28.0".to_owned(),
            libtorch: "2.11.0".to_owned(),
        }),
        ..JoinRequest::default()
    }
}

/// An actor up to the point where it has an episode to simulate.
struct Actor {
    joined: JoinResponse,
    assignment: EpisodeAssignment,
    requests: mpsc::Sender<StreamFragmentsRequest>,
    responses: Streaming<StreamFragmentsResponse>,
}

impl Actor {
    async fn join(channel: Channel, name: &str) -> Self {
        let mut client = LearnerClient::new(channel);
        let joined = client.join(join_request(name)).await.unwrap().into_inner();
        let (requests, receiver) = mpsc::channel(8);
        let hello = StreamHello { actor_id: name.to_owned(), session_epoch: joined.session_epoch };
        send(&requests, stream_fragments_request::Message::Hello(hello)).await;
        send(&requests, stream_fragments_request::Message::EpisodeRequest(EpisodeRequest {})).await;
        let mut responses =
            client.stream_fragments(ReceiverStream::new(receiver)).await.unwrap().into_inner();
        let assignment = loop {
            let response = responses.message().await.unwrap().unwrap();
            if let Some(stream_fragments_response::Message::Assignment(assignment)) = response.message {
                break assignment;
            }
        };
        Self { joined, assignment, requests, responses }
    }

    /// A sound fragment of the assigned episode: nothing on the streets, first phases.
    fn fragment(&self, name: &str) -> WireFragment {
        const STEPS: usize = 5;
        let config = Config::from_json(&self.joined.config_json, "the learner").unwrap();
        let scenario = Scenario::load(&self.assignment.scenario).unwrap();
        let layout = load_layout(&scenario, &config.env).unwrap();
        let counts = layout.lane_rows() * config.env.detection.bands();
        let agents = layout.agents();
        WireFragment::from(&Fragment {
            id: FragmentId {
                actor: name.to_owned(),
                session_epoch: self.joined.session_epoch,
                episode: self.assignment.episode,
                sequence: 0,
            },
            scenario: self.assignment.scenario.clone(),
            layout_hash: layout.hash(),
            policy_version: self.joined.policy_version,
            first_step: 0,
            steps: u32::try_from(STEPS).unwrap(),
            counts: vec![0; (STEPS + 1) * counts],
            phases: vec![0; (STEPS + 1) * agents],
            actions: vec![0; STEPS * agents],
            log_probs: vec![-2.0; STEPS * agents],
            rewards: vec![0.0; STEPS * agents],
            recurrent: RecurrentState::default(),
            end: FragmentEnd::Continues,
        })
    }

    async fn send(&self, fragment: WireFragment) {
        send(&self.requests, stream_fragments_request::Message::Fragment(fragment)).await;
    }

    /// The next acknowledgement, or the error that ended the stream.
    async fn answer(&mut self) -> Result<cross_proto::v1::Ack, Status> {
        loop {
            match self.responses.message().await?.and_then(|response| response.message) {
                Some(stream_fragments_response::Message::Ack(ack)) => return Ok(ack),
                Some(_) => {}
                None => panic!("the stream ended without an answer"),
            }
        }
    }
}

async fn send(requests: &mpsc::Sender<StreamFragmentsRequest>, message: stream_fragments_request::Message) {
    requests.send(StreamFragmentsRequest { message: Some(message) }).await.unwrap();
}

#[tokio::test]
async fn a_fragment_with_nan_is_refused_by_field_and_disturbs_nobody_else() {
    let run = Run::new();
    let mut learner = Learner::start(&run);
    let mut good = Actor::join(learner.channel().await, "good").await;

    type Spoil = fn(&mut WireFragment);
    let cases: [(&str, Spoil); 5] = [
        ("rewards", |f| f.rewards[3] = f32::NAN),
        ("log_probs", |f| f.log_probs[0] = f32::NEG_INFINITY),
        ("actions", |f| f.actions = vec![200; f.actions.len()].into()),
        ("counts", |f| f.counts = vec![0xff; 3].into()),
        ("layout_hash", |f| f.layout_hash = "0123456789abcdef".to_owned()),
    ];
    for (field, spoil) in cases {
        let mut bad = Actor::join(learner.channel().await, "bad").await;
        let mut fragment = bad.fragment("bad");
        spoil(&mut fragment);
        bad.send(fragment).await;
        let status = bad.answer().await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "{field}: {status:?}");
        let violations = status.get_details_bad_request().unwrap().field_violations;
        assert!(
            violations.iter().any(|violation| violation.field.contains(field)),
            "{field}: {violations:?}"
        );
        learner.assert_serves().await;
    }

    let fragment = good.fragment("good");
    good.send(fragment.clone()).await;
    let ack = good.answer().await.unwrap();
    assert_eq!(ack.outcome(), cross_proto::v1::Outcome::Accepted);
    // A replay is recognised and does no harm.
    good.send(fragment).await;
    assert_eq!(good.answer().await.unwrap().outcome(), cross_proto::v1::Outcome::Duplicate);
}

#[tokio::test]
async fn an_actor_that_does_not_fit_is_refused_by_name() {
    let run = Run::new();
    let learner = Learner::start(&run);
    let mut client = LearnerClient::new(learner.channel().await);

    let mut other = join_request("other");
    other.versions.as_mut().unwrap().protocol = 99;
    let status = client.join(other).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert_eq!(status.get_details_error_info().unwrap().reason, "PROTOCOL_MISMATCH");

    let other = JoinRequest { config_hash: "0123456789abcdef".to_owned(), ..join_request("other") };
    let status = client.join(other).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert_eq!(status.get_details_error_info().unwrap().reason, "CONFIG_MISMATCH");

    let status = client.join(join_request("not a name")).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
}
