//! Limits on calls, connections and messages: who goes beyond one is told which, and nobody else notices.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking, in their helpers too")]

mod support;

use cross_proto::client::{LearnerClient, TrainingClient};
use cross_proto::status::{self, Reason};
use cross_proto::v1::{self, stream_fragments_request as up};
use cross_support::options::ServerOptions;
use cross_support::server::ServerSecurity;
use support::{TestActor, TestLearner, config, join_request, soon};
use tonic::{Code, Request, Status};

/// Asserts the reason, the code, and details as every refusal has them.
fn assert_refused(error: &Status, reason: Reason, code: Code, retry: bool) {
    assert_eq!((status::reason(error), error.code()), (Some(reason), code), "{error:?}");
    assert_eq!(status::retry_delay(error).is_some(), retry, "{error:?}");
    assert!(!error.message().is_empty());
}

async fn ended(learner: TestLearner) {
    learner.drain().cancel();
    learner.ended().await;
}

#[tokio::test]
async fn calls_above_the_limit_are_refused_until_another_ends() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x"], 3);
    config.learner.max_streams = 2;
    let learner = TestLearner::start(config, run.path()).await;
    let mut training = TrainingClient::new(learner.channel().await);
    let watch = async || training.clone().watch_progress(v1::WatchProgressRequest {}).await;
    let mut open = vec![watch().await.unwrap().into_inner(), watch().await.unwrap().into_inner()];
    let error = watch().await.unwrap_err();
    assert_refused(&error, Reason::TooManyStreams, Code::ResourceExhausted, true);
    assert!(error.message().contains('2') && error.message().contains("learner.max_streams"), "{error}");
    // Those that are open go on, and their end makes room.
    assert!(open[0].message().await.unwrap().is_some());
    open.pop();
    soon("room for another call", async {
        while training.get_status(v1::GetStatusRequest {}).await.is_err() {
            tokio::task::yield_now().await;
        }
    })
    .await;
    drop(open);
    ended(learner).await;
}

#[tokio::test]
async fn whoever_calls_too_often_is_told_when_to_come_again() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x"], 3);
    config.learner.requests_per_second = 1;
    let learner = TestLearner::start(config, run.path()).await;
    let mut training = TrainingClient::new(learner.channel().await);
    let mut admitted = 0;
    let error = loop {
        match training.get_status(v1::GetStatusRequest {}).await {
            Ok(_) => admitted += 1,
            Err(error) => break error,
        }
    };
    // Ten seconds' worth, and what came in meanwhile.
    assert!((10..100).contains(&admitted), "{admitted}");
    assert_refused(&error, Reason::TooManyRequests, Code::ResourceExhausted, true);
    assert!(error.message().contains("learner.requests_per_second"), "{error}");
    assert!(status::retry_delay(&error).is_some_and(|delay| delay.as_secs() <= 1), "{error:?}");
    ended(learner).await;
}

#[tokio::test]
async fn a_message_above_the_limit_is_refused_with_the_limit() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x"], 3);
    config.learner.max_message_bytes = 64 * 1024;
    let learner = TestLearner::start(config, run.path()).await;
    let request = v1::JoinRequest { host: "h".repeat(100_000), ..join_request("a") };
    let error = LearnerClient::new(learner.channel().await).join(request).await.unwrap_err();
    assert_refused(&error, Reason::MessageTooLarge, Code::ResourceExhausted, false);
    assert!(error.message().contains("65536"), "{error}");

    // On a stream it ends that stream, and only that.
    let mut good = TestActor::join(&learner, "good").await;
    let mut bad = TestActor::join(&learner, "bad").await;
    bad.ask_for_episode().await;
    let aborted = v1::EpisodeAborted { episode: 0, reason: "r".repeat(100_000) };
    bad.say(up::Message::EpisodeAborted(aborted)).await;
    let error = bad.hear().await.unwrap_err();
    assert_refused(&error, Reason::MessageTooLarge, Code::ResourceExhausted, false);
    good.ask_for_episode().await;
    ended(learner).await;
}

#[tokio::test]
async fn a_connection_above_the_limit_is_closed() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x"], 3);
    config.learner.max_connections = 1;
    let learner = TestLearner::start(config, run.path()).await;
    let mut first = TrainingClient::new(learner.channel().await);
    first.get_status(v1::GetStatusRequest {}).await.unwrap();
    let address = format!("http://{}", learner.grpc);
    let answer = async {
        let channel = tonic::transport::Endpoint::from_shared(address).unwrap().connect().await.ok()?;
        TrainingClient::new(channel).get_status(v1::GetStatusRequest {}).await.ok()
    };
    assert!(answer.await.is_none());
    first.get_status(v1::GetStatusRequest {}).await.unwrap();
    ended(learner).await;
}

#[tokio::test]
async fn every_service_asks_for_the_token() {
    const TOKEN: &str = "0123456789abcdef-test";
    let run = tempfile::tempdir().unwrap();
    let security = ServerSecurity::load(&ServerOptions::default(), Some(TOKEN.to_owned())).unwrap();
    let learner = TestLearner::start_with(config(&["x"], 3), run.path(), security).await;
    let channel = learner.channel().await;
    let call = |token: Option<&str>| {
        let mut request = Request::new(v1::GetStatusRequest {});
        if let Some(token) = token {
            let value = format!("Bearer {token}").parse().unwrap();
            request.metadata_mut().insert("authorization", value);
        }
        request
    };
    let mut training = TrainingClient::new(channel.clone());
    for wrong in [None, Some("0123456789abcdef-tesT"), Some("0123456789abcdef-test-and-more"), Some("")] {
        let error = training.get_status(call(wrong)).await.unwrap_err();
        assert_refused(&error, Reason::Unauthenticated, Code::Unauthenticated, false);
        assert!(!format!("{error:?}").contains(TOKEN), "{error:?}");
    }
    training.get_status(call(Some(TOKEN))).await.unwrap();

    let error = LearnerClient::new(channel.clone()).join(join_request("a")).await.unwrap_err();
    assert_refused(&error, Reason::Unauthenticated, Code::Unauthenticated, false);
    let mut checkpoints = cross_proto::client::CheckpointsClient::new(channel.clone());
    let error = checkpoints.list_checkpoints(v1::ListCheckpointsRequest::default()).await.unwrap_err();
    assert_refused(&error, Reason::Unauthenticated, Code::Unauthenticated, false);
    let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
    let error = health.check(tonic_health::pb::HealthCheckRequest::default()).await.unwrap_err();
    assert_refused(&error, Reason::Unauthenticated, Code::Unauthenticated, false);
    ended(learner).await;
}
