//! Whole trainings over real gRPC: what an actor sees, what is left on the disk, and that nothing depends on a restart.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking, in their helpers too")]

mod support;

use cross_learner::Ending;
use cross_learner::checkpoint::reader;
use cross_proto::client::TrainingClient;
use cross_proto::v1::training_status::Phase;
use cross_proto::v1::{self, Outcome, stream_fragments_request as up, stream_fragments_response as down};
use support::{TestActor, TestLearner, config, soon};

#[tokio::test]
async fn fragments_become_an_update_new_weights_a_line_and_a_checkpoint() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 3), run.path()).await;
    let mut actor = TestActor::join(&learner, "a").await;
    assert_eq!(actor.joined.policy_version, 1);
    assert_eq!(actor.joined.scenarios[0].layout_hash, support::layout().hash());
    let mut training = TrainingClient::new(learner.channel().await);
    let status = training.get_status(v1::GetStatusRequest {}).await.unwrap().into_inner().status.unwrap();
    let scenario = &status.scenarios[0];
    assert_eq!((scenario.episode_return, scenario.queue_length), (None, None), "no episode has finished");

    let assignment = actor.ask_for_episode().await;
    assert!(assignment.sumo_seed >= 1_000_000);
    for fragment in actor.episode(&learner.config, &assignment).await {
        assert_eq!(actor.send(fragment).await.outcome(), Outcome::Accepted);
    }
    let snapshot = actor.snapshot().await;
    assert_eq!(snapshot.policy_version, 2);

    let id = training.checkpoint_now(v1::CheckpointNowRequest {}).await.unwrap().into_inner().id;
    assert_eq!(id, "000001");
    let status = training.get_status(v1::GetStatusRequest {}).await.unwrap().into_inner().status.unwrap();
    assert_eq!((status.updates, status.updates_wanted, status.policy_version), (1, 3, 2));
    assert_eq!((status.decisions, status.episodes, status.actors), (20, 1, 1));
    let scenario = &status.scenarios[0];
    assert!(scenario.episode_return.is_some_and(|sum| sum < 0.0), "{scenario:?}");
    assert!(scenario.queue_length.is_some_and(|queue| queue > 0.0), "{scenario:?}");
    assert!(status.losses.contains_key("actor_total"));
    assert_eq!(status.latest_checkpoint, "000001");

    let lines = TestLearner::metrics_lines(run.path());
    assert_eq!(lines.len(), 1);
    assert_eq!((lines[0]["update"].as_u64(), lines[0]["decisions"].as_u64()), (Some(1), Some(20)));
    assert!(lines[0]["scenarios"]["x"]["queue_length"].as_f64().unwrap() > 0.0);
    let metadata = reader::verify(&reader::find(run.path(), "latest").unwrap()).unwrap();
    assert_eq!((metadata.updates, metadata.policy_version, metadata.progress.next_episode), (1, 2, 1));
    assert_eq!(metadata.versions.sumo, "1.28.0");
    learner.drain().cancel();
    assert_eq!(learner.ended().await, Ending::Drained);
}

#[tokio::test]
async fn training_ends_with_a_goodbye_and_the_last_checkpoint() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x", "y"], 3);
    config.learner.checkpoint_updates = 100;
    let learner = TestLearner::start(config.clone(), run.path()).await;
    let mut progress = TrainingClient::new(learner.channel().await)
        .watch_progress(v1::WatchProgressRequest {})
        .await
        .unwrap()
        .into_inner();
    let mut actor = TestActor::join(&learner, "a").await;
    assert!(soon("goodbye", actor.work(&config)).await);
    assert_eq!(learner.ended().await, Ending::Complete);
    assert!(reader::find(run.path(), "latest").unwrap().ends_with("000003"));
    let mut seen = Vec::new();
    while let Some(response) = progress.message().await.unwrap() {
        let status = response.status.unwrap();
        seen.push((status.updates, status.phase()));
    }
    assert_eq!(seen.first().map(|s| s.0), Some(0));
    assert_eq!(seen.last(), Some(&(3, Phase::Complete)));
    // A complete run that is started again has nothing to do.
    let again = TestLearner::launch(config, run.path(), Default::default()).await;
    assert_eq!(again.ended().await, Ending::Complete);
}

#[tokio::test]
async fn one_actor_feeds_all_scenarios_with_the_smallest_buffers() {
    let run = tempfile::tempdir().unwrap();
    let mut config = config(&["x", "y", "z"], 4);
    config.ppo.round_steps = 3;
    config.learner.buffered_rounds = 1;
    config.learner.max_policy_lag = 1;
    config.actor.fragment_steps = 2;
    config.actor.unacked_fragments = 1;
    config.ppo.sequence_steps = 2;
    let learner = TestLearner::start(config.clone(), run.path()).await;
    let mut actor = TestActor::join(&learner, "a").await;
    assert!(soon("goodbye", actor.work(&config)).await);
    assert_eq!(learner.ended().await, Ending::Complete);
}

#[tokio::test]
async fn a_serial_run_that_is_stopped_and_resumed_equals_one_that_was_not() {
    let mut config = config(&["x", "y"], 4);
    config.learner.serial = true;
    config.ppo.round_steps = 20;
    config.validate().unwrap();

    let whole = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config.clone(), whole.path()).await;
    assert!(TestActor::join(&learner, "a").await.work(&config).await);
    assert_eq!(learner.ended().await, Ending::Complete);

    let parts = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config.clone(), parts.path()).await;
    let mut actor = TestActor::join(&learner, "a").await;
    // Stopped in the middle of the third round's second episode: six episodes and a fragment.
    for episode in 0..10 {
        let assignment = actor.ask_for_episode().await;
        assert_eq!(assignment.episode, episode);
        let fragments = actor.episode(&config, &assignment).await;
        if episode == 9 {
            actor.send(fragments[0].clone()).await;
            break;
        }
        for fragment in fragments {
            let ack = actor.send(fragment).await;
            actor.hold_version(ack.min_policy_version).await;
        }
    }
    learner.drain().cancel();
    assert!(matches!(
        actor.hear().await.unwrap(),
        Some(down::Message::Goodbye(v1::Goodbye { complete: false }))
    ));
    assert_eq!(learner.ended().await, Ending::Drained);
    assert_eq!(TestLearner::metrics_lines(parts.path()).len(), 2);

    let learner = TestLearner::start(config.clone(), parts.path()).await;
    assert!(TestActor::join(&learner, "another").await.work(&config).await);
    assert_eq!(learner.ended().await, Ending::Complete);

    assert_eq!(TestLearner::metrics_lines(parts.path()), TestLearner::metrics_lines(whole.path()));
    let last = |run: &std::path::Path| reader::read(&reader::find(run, "000004").unwrap()).unwrap();
    let (whole, parts) = (last(whole.path()), last(parts.path()));
    assert_eq!(whole.files, parts.files);
    assert_eq!(whole.metadata.progress, parts.metadata.progress);
}

#[tokio::test]
async fn a_paused_learner_updates_nothing_until_it_is_resumed() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 3), run.path()).await;
    let mut training = TrainingClient::new(learner.channel().await);
    training.pause(v1::PauseRequest {}).await.unwrap();
    let mut actor = TestActor::join(&learner, "a").await;
    let assignment = actor.ask_for_episode().await;
    for fragment in actor.episode(&learner.config, &assignment).await {
        actor.send(fragment).await;
    }
    let status = training.get_status(v1::GetStatusRequest {}).await.unwrap().into_inner().status.unwrap();
    assert_eq!((status.phase(), status.updates), (Phase::Paused, 0));
    training.resume(v1::ResumeRequest {}).await.unwrap();
    actor.hold_version(2).await;
    learner.drain().cancel();
    assert_eq!(learner.ended().await, Ending::Drained);
}

#[tokio::test]
async fn a_new_learner_has_a_new_session_and_old_fragments_are_dropped() {
    let run = tempfile::tempdir().unwrap();
    let learner = TestLearner::start(config(&["x"], 9), run.path()).await;
    let mut actor = TestActor::join(&learner, "a").await;
    let assignment = actor.ask_for_episode().await;
    let old = actor.episode(&learner.config, &assignment).await;
    let first = learner.epoch();
    learner.drain().cancel();
    learner.ended().await;

    let learner = TestLearner::start(config(&["x"], 9), run.path()).await;
    assert!(learner.epoch() > first);
    let mut actor = TestActor::join(&learner, "a").await;
    let error = support::open(&mut actor.client, "a", first).await.unwrap_err();
    assert_eq!(cross_proto::status::reason(&error), Some(cross_proto::status::Reason::OldSession));
    actor.reconnect().await;
    actor.say(up::Message::Fragment(old[0].clone())).await;
    assert_eq!(actor.ack().await.outcome(), Outcome::OldSession);
    learner.drain().cancel();
    learner.ended().await;
}
