//! Actors with the real learner, real SUMO and real updates, all in one process.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

mod support;

use clap::Parser;
use cross_actor::{ActorError, Ending, Options};
use cross_config::Config;
use cross_learner::Ending as Training;
use cross_learner::{Learner, Setup, load_scenarios};
use std::path::Path;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

async fn start_learner(config: &Config, run: &Path) -> (Learner, String) {
    let scenarios = load_scenarios(config, None).unwrap();
    let (config, run) = (config.clone(), run.to_owned());
    let setup = Setup {
        config,
        scenarios,
        run,
        run_id: "test".to_owned(),
        resumed: None,
        mirror: None,
        security: Default::default(),
    };
    let grpc = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let metrics = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://{}", grpc.local_addr().unwrap());
    let learner = Learner::start(setup, grpc, metrics).unwrap();
    assert!(learner.ready().await);
    (learner, address)
}

fn start_actor(learner: &str, id: &str) -> JoinHandle<Result<Ending, ActorError>> {
    let options = Options::parse_from(["cross-actor", "--learner", learner, "--actor-id", id]);
    tokio::spawn(cross_actor::run(options, CancellationToken::new()))
}

/// The lines of the metrics log without what depends on the clock.
fn updates(run: &Path) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn two_actors_feed_a_learner_until_training_is_complete() {
    let run = tempfile::tempdir().unwrap();
    let config = Config { updates: 3, ..support::small_config() };
    let (learner, address) = start_learner(&config, run.path()).await;
    let actors = [start_actor(&address, "one"), start_actor(&address, "other")];
    assert!(matches!(learner.finished().await, Training::Complete));
    for actor in actors {
        assert_eq!(actor.await.unwrap().unwrap(), Ending::Complete);
    }
    let updates = updates(run.path());
    assert_eq!(updates.len(), 3);
    assert!(
        updates.iter().all(|update| update["losses"].as_object().is_some_and(|losses| !losses.is_empty()))
    );
}
