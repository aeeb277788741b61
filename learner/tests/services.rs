//! Every refusal by its reason, and the services for people and programs.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking, in their helpers too")]

mod support;

use cross_learner::checkpoint::reader;
use cross_proto::client::{CheckpointsClient, LearnerClient};
use cross_proto::status::{self, Reason};
use cross_proto::v1::{self, Outcome, stream_fragments_request as up};
use prost::Message as _;
use sha2::{Digest, Sha256};
use support::{TestActor, TestLearner, config, join_request, soon};
use tonic::{Code, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

async fn refusal(learner: &TestLearner, change: impl FnOnce(&mut v1::JoinRequest)) -> Status {
    let mut request = join_request("b");
    change(&mut request);
    LearnerClient::new(learner.channel().await).join(request).await.unwrap_err()
}

#[tokio::test]
async fn actors_that_do_not_fit_are_refused_by_name() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x"], 3);
    config.learner.max_actors = 1;
    let learner = TestLearner::start(config, run.path()).await;

    let error = refusal(&learner, |r| r.versions.as_mut().unwrap().protocol = 99).await;
    assert_eq!(status::reason(&error), Some(Reason::ProtocolMismatch));
    assert!(error.message().contains("99"), "{error}");
    let error = refusal(&learner, |r| r.versions = None).await;
    assert_eq!(status::reason(&error), Some(Reason::ProtocolMismatch));
    let error = refusal(&learner, |r| r.config_hash = "feedfeedfeedfeed".to_owned()).await;
    assert_eq!(status::reason(&error), Some(Reason::ConfigMismatch));
    assert!(error.message().contains(&learner.config.compatibility_hash()), "{error}");
    let error = refusal(&learner, |r| r.scenarios = vec!["moon".to_owned()]).await;
    assert_eq!(status::reason(&error), Some(Reason::NoScenario));
    let error = refusal(&learner, |r| r.actor_id = "../../etc".to_owned()).await;
    assert_eq!(
        (error.code(), status::violations(&error)[0].field.as_str()),
        (Code::InvalidArgument, "actor_id")
    );

    // None of them took the one place.
    let _actor = TestActor::join(&learner, "a").await;
    let error = refusal(&learner, |_| ()).await;
    assert_eq!(
        (error.code(), status::reason(&error)),
        (Code::ResourceExhausted, Some(Reason::TooManyActors))
    );
    assert!(status::retry_delay(&error).is_some());
    learner.drain().cancel();
    learner.ended().await;
}

#[tokio::test]
async fn only_an_actor_that_says_so_leaves() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x"], 3);
    config.learner.max_actors = 1;
    let learner = TestLearner::start(config, run.path()).await;
    let mut actor = TestActor::join(&learner, "a").await;
    let episode = actor.ask_for_episode().await.episode;

    // A stream that merely ends is a lost connection: the lease goes on, and another stream needs no new join.
    actor.hang_up();
    assert_eq!(actor.hear().await.unwrap(), None);
    assert_eq!(status::reason(&refusal(&learner, |_| ()).await), Some(Reason::TooManyActors));
    actor.reconnect().await;
    let crashed = v1::EpisodeAborted { episode, reason: "SUMO_CRASHED".to_owned() };
    actor.say(up::Message::EpisodeAborted(crashed)).await;
    actor.hang_up();
    assert_eq!(actor.hear().await.unwrap(), None);
    assert_eq!(status::reason(&refusal(&learner, |_| ()).await), Some(Reason::TooManyActors));

    // One that says it shuts down frees its place.
    actor.reconnect().await;
    let episode = actor.ask_for_episode().await.episode;
    let shutdown = v1::EpisodeAborted { episode, reason: "SHUTDOWN".to_owned() };
    actor.say(up::Message::EpisodeAborted(shutdown)).await;
    actor.hang_up();
    assert_eq!(actor.hear().await.unwrap(), None);
    let _other = TestActor::join(&learner, "b").await;
    learner.drain().cancel();
    learner.ended().await;
}

#[tokio::test]
async fn a_bad_fragment_ends_its_own_stream_alone_and_names_the_field() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x", "y"], 9), run.path()).await;
    let mut good = TestActor::join(&learner, "good").await;
    let assignment = good.ask_for_episode().await;
    let fine = good.episode(&learner.config, &assignment).await;
    let mut bad = TestActor::join(&learner, "bad").await;

    type Spoil = fn(&mut v1::Fragment);
    let cases: [(&str, Spoil); 6] = [
        ("fragment.rewards", |f| f.rewards[3] = f32::NAN),
        ("fragment.log_probs", |f| f.log_probs[0] = f32::INFINITY),
        ("fragment.actions", |f| f.actions = vec![7; f.actions.len()].into()),
        ("fragment.layout_hash", |f| f.layout_hash = "0".repeat(16)),
        ("fragment.scenario", |f| f.scenario = "moon".to_owned()),
        ("fragment.policy_version", |f| f.policy_version = 99),
    ];
    for (field, spoil) in cases {
        let assignment = bad.ask_for_episode().await;
        let mut fragment = bad.episode(&learner.config, &assignment).await.remove(0);
        spoil(&mut fragment);
        bad.say(up::Message::Fragment(fragment)).await;
        let error = bad.hear().await.unwrap_err();
        assert_eq!(error.code(), Code::InvalidArgument, "{error}");
        assert_eq!(status::violations(&error)[0].field, field);
        // The same actor may go on, on a new stream, under the same lease.
        bad.reconnect().await;
    }
    // A value out of place is as clear.
    let hello = v1::StreamHello { actor_id: "bad".to_owned(), session_epoch: learner.epoch() };
    bad.say(up::Message::Hello(hello)).await;
    let error = bad.hear().await.unwrap_err();
    assert_eq!(status::reason(&error), Some(Reason::UnexpectedMessage));

    // So is one that is too large (`limits.rs` has the rest).
    bad.reconnect().await;
    let huge =
        v1::Fragment { counts: vec![0; learner.config.learner.max_message_bytes].into(), ..fine[0].clone() };
    bad.say(up::Message::Fragment(huge)).await;
    let error = bad.hear().await.unwrap_err();
    assert_eq!(status::reason(&error), Some(Reason::MessageTooLarge), "{error}");

    for fragment in fine {
        assert_eq!(good.send(fragment.clone()).await.outcome(), Outcome::Accepted);
        assert_eq!(good.send(fragment).await.outcome(), Outcome::Duplicate);
    }
    learner.drain().cancel();
    learner.ended().await;
}

#[tokio::test]
async fn a_stream_needs_a_lease_and_a_hello() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 9), run.path()).await;
    let mut client = LearnerClient::new(learner.channel().await);
    let error = support::open(&mut client, "nobody", learner.epoch()).await.unwrap_err();
    assert_eq!(status::reason(&error), Some(Reason::NotJoined));
    let first = v1::StreamFragmentsRequest { message: Some(up::Message::Heartbeat(v1::Heartbeat {})) };
    let error = client.stream_fragments(tokio_stream::iter([first])).await.unwrap_err();
    assert_eq!(status::reason(&error), Some(Reason::UnexpectedMessage));
    // A second stream of the same actor takes the place of the first.
    let mut actor = TestActor::join(&learner, "a").await;
    let mut other = TestActor::join(&learner, "a").await;
    let error = actor.hear().await.unwrap_err();
    assert_eq!(status::reason(&error), Some(Reason::Superseded));
    other.ask_for_episode().await;
    learner.drain().cancel();
    learner.ended().await;
}

#[tokio::test]
async fn checkpoints_are_listed_in_pages_described_and_downloaded() {
    let run = tempfile::tempdir().unwrap();
    let config = config(&["x"], 4);
    let learner = TestLearner::start(config.clone(), run.path()).await;
    let mut actor = TestActor::join(&learner, "a").await;
    for update in 1..=3 {
        let assignment = actor.ask_for_episode().await;
        for fragment in actor.episode(&config, &assignment).await {
            actor.send(fragment).await;
        }
        actor.hold_version(update + 1).await;
    }
    let mut training = cross_proto::client::TrainingClient::new(learner.channel().await);
    training.checkpoint_now(v1::CheckpointNowRequest {}).await.unwrap();

    let mut client = CheckpointsClient::new(learner.channel().await);
    let mut ids = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = v1::ListCheckpointsRequest { page_size: 2, page_token };
        let response = client.list_checkpoints(request).await.unwrap().into_inner();
        assert!(response.checkpoints.len() <= 2);
        ids.extend(response.checkpoints.into_iter().map(|checkpoint| checkpoint.id));
        page_token = response.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    assert_eq!(ids, ["000003", "000002", "000001"]);

    let request = v1::GetCheckpointRequest { id: "latest".to_owned() };
    let response = client.get_checkpoint(request).await.unwrap().into_inner();
    let checkpoint = response.checkpoint.unwrap();
    assert_eq!((checkpoint.id.as_str(), checkpoint.updates, checkpoint.policy_version), ("000003", 3, 4));
    assert_eq!(cross_config::Config::from_json(&checkpoint.config_json, "test").unwrap(), config);
    assert!(response.tensors.iter().any(|tensor| tensor.name.starts_with("actor")));

    let request = v1::DownloadCheckpointRequest { id: "000002".to_owned() };
    let mut stream = client.download_checkpoint(request).await.unwrap().into_inner();
    let (mut bytes, mut sha256) = (Vec::new(), Vec::new());
    while let Some(chunk) = stream.message().await.unwrap() {
        assert_eq!(chunk.offset, bytes.len() as u64);
        bytes.extend_from_slice(&chunk.chunk);
        sha256 = chunk.sha256.to_vec();
    }
    assert_eq!(sha256, Sha256::digest(&bytes).to_vec());
    assert_eq!(bytes, reader::load_policy(&run.path().join("checkpoints/000002")).unwrap().1);

    for id in ["000009", "../../../etc/passwd", ""] {
        let request = v1::GetCheckpointRequest { id: id.to_owned() };
        let error = client.get_checkpoint(request).await.unwrap_err();
        assert_eq!(status::reason(&error), Some(Reason::CheckpointNotFound), "{id}");
    }
    std::fs::write(run.path().join("checkpoints/000001/model.safetensors"), "torn").unwrap();
    let request = v1::DownloadCheckpointRequest { id: "000001".to_owned() };
    let error = client.download_checkpoint(request).await.unwrap_err();
    assert_eq!(status::reason(&error), Some(Reason::CheckpointUnusable));
    assert!(error.message().contains("000001/model.safetensors"), "{error}");
    learner.drain().cancel();
    learner.ended().await;
}

#[tokio::test]
async fn calls_that_no_service_sees_are_refused_with_a_reason_too() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 9), run.path()).await;
    let channel = learner.channel().await;
    // What a client of another release may call: a method or a service that is not here.
    for path in ["/cross.v1.Training/Stop", "/cross.v9.Training/GetStatus", "/"] {
        let error = call(&channel, path).await.unwrap_err();
        assert_eq!((status::reason(&error), error.code()), (Some(Reason::Unsupported), Code::Unimplemented));
        assert!(error.message().contains(path.trim_start_matches('/')), "{error}");
    }
    // Field 1 is a number here and a text there.
    let error = call(&channel, "/cross.v1.Checkpoints/GetCheckpoint").await.unwrap_err();
    assert_eq!(
        (status::reason(&error), error.code()),
        (Some(Reason::UnexpectedMessage), Code::InvalidArgument)
    );
    call(&channel, "/cross.v1.Checkpoints/ListCheckpoints").await.unwrap();
    let error = HealthClient::new(channel)
        .check(HealthCheckRequest { service: "cross.v1.Nothing".to_owned() })
        .await
        .unwrap_err();
    assert_eq!((status::reason(&error), error.code()), (Some(Reason::UnknownService), Code::NotFound));
    learner.drain().cancel();
    learner.ended().await;
}

/// Sends a request for a page of checkpoints to any method.
async fn call(channel: &tonic::transport::Channel, path: &'static str) -> Result<(), Status> {
    let request = tonic::Request::new(v1::ListCheckpointsRequest { page_size: 2, page_token: String::new() });
    let codec = tonic_prost::ProstCodec::<v1::ListCheckpointsRequest, v1::ListCheckpointsResponse>::default();
    let mut client = tonic::client::Grpc::new(channel.clone());
    client.ready().await.unwrap();
    let path = tonic::codegen::http::uri::PathAndQuery::from_static(path);
    client.unary(request, path, codec).await.map(drop)
}

async fn health(learner: &TestLearner, service: &str) -> ServingStatus {
    let request = HealthCheckRequest { service: service.to_owned() };
    HealthClient::new(learner.channel().await).check(request).await.unwrap().into_inner().status()
}

#[tokio::test]
async fn health_follows_the_learner_s_life() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 9), run.path()).await;
    let mut watch = HealthClient::new(learner.channel().await)
        .watch(HealthCheckRequest { service: String::new() })
        .await
        .unwrap()
        .into_inner();
    for service in ["", "cross.v1.Learner", "cross.v1.Checkpoints", "cross.v1.Training"] {
        // The reporter follows the learner's life a moment behind.
        while soon("an answer", health(&learner, service)).await != ServingStatus::Serving {
            tokio::task::yield_now().await;
        }
    }
    let mut seen = ServingStatus::Unknown;
    while seen != ServingStatus::Serving {
        seen = soon("health", watch.message()).await.unwrap().unwrap().status();
    }
    assert_eq!(get(learner.metrics, "/ready").await.0, 200);
    learner.drain().cancel();
    assert_eq!(soon("health", watch.message()).await.unwrap().unwrap().status(), ServingStatus::NotServing);
    // The open health stream holds nothing up.
    learner.ended().await;
}

/// A plain HTTP request; status and body.
async fn get(address: std::net::SocketAddr, path: &str) -> (u16, String) {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nhost: test\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut text = String::new();
    soon("a response", stream.read_to_string(&mut text)).await.unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
}

#[tokio::test]
async fn metrics_count_what_became_of_fragments() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 9), run.path()).await;
    let mut actor = TestActor::join(&learner, "a").await;
    let assignment = actor.ask_for_episode().await;
    let fragments = actor.episode(&learner.config, &assignment).await;
    actor.send(fragments[0].clone()).await;
    actor.send(fragments[0].clone()).await;
    let (code, text) = get(learner.metrics, "/metrics").await;
    assert_eq!(code, 200);
    for line in [
        "cross_learner_fragments_total{scenario=\"x\",outcome=\"accepted\"} 1",
        "cross_learner_fragments_total{scenario=\"x\",outcome=\"duplicate\"} 1",
        "cross_learner_buffer_decisions{scenario=\"x\"} 10",
        "cross_learner_actors 1",
        "cross_learner_policy_version 1",
    ] {
        assert!(text.contains(line), "{line} is missing in:\n{text}");
    }
    assert_eq!(get(learner.metrics, "/live").await.0, 200);
    assert_eq!(get(learner.metrics, "/nothing").await.0, 404);
    learner.drain().cancel();
    learner.ended().await;
}

#[tokio::test]
async fn both_reflections_describe_every_service() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 9), run.path()).await;
    let expected = [
        "cross.v1.Checkpoints",
        "cross.v1.Learner",
        "cross.v1.Training",
        "grpc.health.v1.Health",
        "grpc.reflection.v1.ServerReflection",
        "grpc.reflection.v1alpha.ServerReflection",
    ];
    // Services by their methods, and what stands in the details of errors.
    let symbols = [
        "grpc.health.v1.Health.Watch",
        "cross.v1.Learner.Join",
        "cross.v1.TrainingStatus.Phase",
        "google.rpc.ErrorInfo",
        "google.rpc.BadRequest",
        "google.rpc.RetryInfo",
    ];
    macro_rules! services {
        ($version:ident) => {{
            use pb::server_reflection_request::MessageRequest;
            use pb::server_reflection_response::MessageResponse;
            use tonic_reflection::pb::$version as pb;
            let ask =
                |message| pb::ServerReflectionRequest { host: String::new(), message_request: Some(message) };
            let (sender, requests) = tokio::sync::mpsc::channel(1);
            let requests = tokio_stream::wrappers::ReceiverStream::new(requests);
            let mut client =
                pb::server_reflection_client::ServerReflectionClient::new(learner.channel().await);
            let mut answers = client.server_reflection_info(requests).await.unwrap().into_inner();
            let mut asked = async |message| {
                sender.send(ask(message)).await.unwrap();
                soon("an answer", answers.message()).await.unwrap().unwrap().message_response.unwrap()
            };
            let MessageResponse::ListServicesResponse(list) =
                asked(MessageRequest::ListServices(String::new())).await
            else {
                panic!("no list")
            };
            let mut names: Vec<String> = list.service.into_iter().map(|service| service.name).collect();
            names.sort_unstable();
            assert_eq!(names, expected);
            // A client fetches a symbol's file, then by name what that imports, to the end.
            let mut wanted: Vec<MessageRequest> =
                symbols.map(|symbol| MessageRequest::FileContainingSymbol(symbol.to_owned())).into();
            let mut files = std::collections::BTreeSet::new();
            while let Some(request) = wanted.pop() {
                let answer = asked(request.clone()).await;
                let MessageResponse::FileDescriptorResponse(found) = answer else { panic!("{request:?}") };
                for file in found.file_descriptor_proto {
                    let file = prost_types::FileDescriptorProto::decode(file.as_slice()).unwrap();
                    if files.insert(file.name().to_owned()) {
                        wanted.extend(file.dependency.into_iter().map(MessageRequest::FileByFilename));
                    }
                }
            }
            assert!(files.contains("google/protobuf/duration.proto"), "{files:?}");
        }};
    }
    services!(v1);
    services!(v1alpha);
    learner.drain().cancel();
    learner.ended().await;
}
