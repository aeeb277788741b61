//! The actor against a learner that says exactly what each test needs, in one process; SUMO and the policy are real.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

mod support;

use clap::Parser;
use cross_actor::options::LogFormat;
use cross_actor::{ActorError, Ending, Options};
use cross_proto::fragment::{FragmentSpec, decode};
use cross_proto::v1::stream_fragments_response::Message as Answer;
use cross_proto::{status, v1};
use cross_sim::trajectory::FragmentEnd;
use std::path::PathBuf;
use support::{Conversation, SCENARIO, Scripted, World};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tonic::Status;

/// An actor in this process.
struct Actor {
    running: JoinHandle<Result<Ending, ActorError>>,
    stop: CancellationToken,
    address_file: PathBuf,
    _directory: tempfile::TempDir,
}

impl Actor {
    fn start(learner: &str, id: &str, more: &[&str]) -> Self {
        if let Ok(filter) = std::env::var("CROSS_LOG") {
            // All tests of the process share one log; whoever comes first sets it up.
            let _ = cross_actor::process::log_to_stderr(LogFormat::Text, &filter);
        }
        let directory = tempfile::tempdir().unwrap();
        let address_file = directory.path().join("metrics");
        let file = address_file.to_str().unwrap();
        let common = ["cross-actor", "--learner", learner, "--actor-id", id, "--address-file", file];
        let options = Options::parse_from(common.iter().chain(more));
        let stop = CancellationToken::new();
        let running = tokio::spawn(cross_actor::run(options, stop.clone()));
        Self { running, stop, address_file, _directory: directory }
    }

    fn of(learner: &Scripted, id: &str) -> Self {
        Self::start(&format!("http://{}", learner.address), id, &[])
    }

    /// The value of a metric, by its name and labels as exported.
    async fn metric(&self, name: &str) -> f64 {
        let text = self.get("/metrics").await;
        let value = text.lines().find_map(|line| line.strip_prefix(name)?.trim().parse().ok());
        value.unwrap_or_else(|| panic!("no {name} in\n{text}"))
    }

    async fn get(&self, path: &str) -> String {
        use tokio::io::{AsyncReadExt, AsyncWriteExt};
        let address = std::fs::read_to_string(&self.address_file).unwrap();
        let mut stream = tokio::net::TcpStream::connect(address.trim()).await.unwrap();
        let request = format!("GET {path} HTTP/1.1\r\nHost: actor\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).await.unwrap();
        text
    }

    async fn end(self) -> Result<Ending, ActorError> {
        self.running.await.unwrap()
    }
}

/// Takes a whole episode, acknowledging each fragment.
async fn whole_episode(conversation: &mut Conversation) -> Vec<v1::Fragment> {
    let mut fragments = Vec::new();
    loop {
        let fragment = conversation.fragment().await;
        conversation.acknowledge(&fragment, v1::Outcome::Accepted).await;
        let last = fragment.end() != v1::FragmentEnd::Continues;
        fragments.push(fragment);
        if last {
            return fragments;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_episode_arrives_in_valid_fragments_and_goodbye_ends_the_actor() {
    let world = World::small();
    let mut learner = Scripted::of(&world).await;
    let actor = Actor::of(&learner, "one");
    let mut conversation = learner.ready(1).await;
    let joined = learner.joins.recv().await.unwrap();
    assert_eq!(joined.actor_id, "one");
    assert_eq!(joined.versions.unwrap().protocol, cross_proto::PROTOCOL_VERSION);

    conversation.say(Answer::Assignment(world.assignment(5))).await;
    let wire = whole_episode(&mut conversation).await;
    let spec = FragmentSpec::new(SCENARIO, world.layout.clone(), &world.config);
    let fragments: Vec<_> = wire.into_iter().map(|fragment| decode(fragment, &spec).unwrap()).collect();
    let shape: Vec<_> = fragments.iter().map(|f| (f.id.sequence, f.first_step, f.steps, f.end)).collect();
    assert_eq!(
        shape,
        [
            (0, 0, 4, FragmentEnd::Continues),
            (1, 4, 4, FragmentEnd::Continues),
            (2, 8, 2, FragmentEnd::Truncated)
        ]
    );
    assert!(fragments[0].recurrent.actor.is_empty());
    assert_eq!(fragments[1].recurrent.actor.len(), 16 * 32);
    assert!(fragments.iter().all(|f| f.id.episode == 5 && f.id.session_epoch == 1 && f.policy_version == 1));

    // The request for the next episode says that this one is counted.
    conversation.request().await;
    assert_eq!(actor.metric("cross_actor_decisions_total{scenario=\"grid4x4\"}").await, 160.0);
    let completed = "cross_actor_episodes_total{scenario=\"grid4x4\",outcome=\"completed\"}";
    assert_eq!(actor.metric(completed).await, 1.0);
    let summed: f32 = fragments.iter().flat_map(|f| &f.rewards).sum();
    let returned = actor.metric("cross_actor_episode_return{scenario=\"grid4x4\"}").await;
    assert!((returned - f64::from(summed) / 16.0).abs() < 1e-6, "{returned} is not {summed} / 16");
    assert!(actor.get("/ready").await.starts_with("HTTP/1.1 200"));

    conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    assert_eq!(actor.end().await.unwrap(), Ending::Complete);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_seeds_and_weights_give_the_same_episode_whoever_simulates_it() {
    let world = World::small();
    let mut episodes = Vec::new();
    for id in ["one", "other"] {
        let mut learner = Scripted::of(&world).await;
        let actor = Actor::of(&learner, id);
        let mut conversation = learner.ready(1).await;
        for episode in [8, 9] {
            conversation.say(Answer::Assignment(world.assignment(episode))).await;
            let mut fragments = whole_episode(&mut conversation).await;
            for fragment in &mut fragments {
                fragment.actor_id.clear();
                fragment.episode = 0;
            }
            episodes.push(fragments);
            conversation.request().await;
        }
        actor.stop.cancel();
        assert_eq!(actor.end().await.unwrap(), Ending::Stopped);
    }
    for again in &episodes[1..] {
        assert!(*again == episodes[0], "an episode differs from the first one of the same seeds");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broken_connection_loses_nothing_within_a_session() {
    let world = World::small();
    let mut learner = Scripted::of(&world).await;
    let actor = Actor::of(&learner, "one");
    let mut conversation = learner.ready(1).await;
    conversation.say(Answer::Assignment(world.assignment(3))).await;
    let first = conversation.fragment().await;
    conversation.fail(Status::unavailable("cut")).await;

    let mut conversation = learner.conversation().await;
    assert_eq!(conversation.hello().await, 1);
    let fragments = whole_episode(&mut conversation).await;
    assert_eq!(fragments[0], first, "the unacknowledged fragment comes again");
    assert_eq!(fragments.iter().map(|f| f.sequence).collect::<Vec<_>>(), [0, 1, 2]);
    assert!(learner.joins.try_recv().is_ok() && learner.joins.try_recv().is_err(), "joined once");

    conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    assert_eq!(actor.end().await.unwrap(), Ending::Complete);
}

#[tokio::test(flavor = "multi_thread")]
async fn another_session_drops_the_old_ones_fragments_counts_them_and_starts_over() {
    let world = World::small();
    let mut learner = Scripted::of(&world).await;
    let actor = Actor::of(&learner, "one");
    let mut conversation = learner.ready(1).await;
    conversation.say(Answer::Assignment(world.assignment(3))).await;
    for _ in 0..3 {
        conversation.fragment().await;
    }
    // The learner dies and comes back from a checkpoint: version 1 again, other weights.
    learner.admit(Ok(world.admission(2)));
    conversation.fail(Status::unavailable("killed")).await;
    let mut conversation = learner.conversation().await;
    assert_eq!(conversation.hello().await, 1);
    conversation.fail(status::error(status::Reason::OldSession, "session 1 is over; join again")).await;

    let mut conversation = learner.ready(2).await;
    assert_eq!(actor.metric("cross_actor_fragments_dropped_total{reason=\"old_session\"}").await, 3.0);
    conversation.say(Answer::Assignment(world.assignment(1))).await;
    let fragments = whole_episode(&mut conversation).await;
    assert!(fragments.iter().all(|f| f.session_epoch == 2 && f.episode == 1));

    conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    assert_eq!(actor.end().await.unwrap(), Ending::Complete);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_leaves_for_now_is_joined_again() {
    let world = World::small();
    let mut learner = Scripted::of(&world).await;
    let actor = Actor::of(&learner, "one");
    let conversation = learner.ready(1).await;
    learner.admit(Ok(world.admission(2)));
    conversation.say(Answer::Goodbye(v1::Goodbye { complete: false })).await;
    let conversation = learner.ready(2).await;
    conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    assert_eq!(actor.end().await.unwrap(), Ending::Complete);
}

#[tokio::test(flavor = "multi_thread")]
async fn no_step_is_taken_under_an_older_policy_than_asked_for() {
    let world = World::small();
    let mut learner = Scripted::of(&world).await;
    let actor = Actor::of(&learner, "one");
    let mut conversation = learner.ready(1).await;
    let assignment = v1::EpisodeAssignment { min_policy_version: 2, ..world.assignment(3) };
    conversation.say(Answer::Assignment(assignment)).await;
    learner.publish(world.snapshot(2));
    let first = conversation.fragment().await;
    assert_eq!(first.policy_version, 2);
    conversation
        .say(Answer::Ack(v1::Ack {
            episode: 3,
            sequence: 0,
            outcome: v1::Outcome::Accepted.into(),
            min_policy_version: 2,
        }))
        .await;
    conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    assert_eq!(actor.end().await.unwrap(), Ending::Complete);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_episode_unknown_to_the_learner_is_given_up_and_another_asked_for() {
    let mut config = support::small_config();
    // Long enough that the answer arrives while the episode goes on, and never more than one fragment ahead of it.
    config.env.episode_seconds = 3600;
    config.actor.unacked_fragments = 1;
    config.ppo.round_steps = 360;
    let world = World::new(config);
    let mut learner = Scripted::of(&world).await;
    let actor = Actor::of(&learner, "one");
    let mut conversation = learner.ready(1).await;
    conversation.say(Answer::Assignment(world.assignment(3))).await;
    let fragment = conversation.fragment().await;
    conversation.acknowledge(&fragment, v1::Outcome::UnknownEpisode).await;
    // One or two more were on their way.
    loop {
        match conversation.heard().await.unwrap() {
            v1::stream_fragments_request::Message::Fragment(fragment) => {
                conversation.acknowledge(&fragment, v1::Outcome::UnknownEpisode).await;
            }
            v1::stream_fragments_request::Message::EpisodeRequest(_) => break,
            other => panic!("unexpected {other:?}"),
        }
    }
    let given_up = "cross_actor_episodes_total{scenario=\"grid4x4\",outcome=\"unknown_episode\"}";
    assert_eq!(actor.metric(given_up).await, 1.0);
    actor.stop.cancel();
    assert_eq!(actor.end().await.unwrap(), Ending::Stopped);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_snapshot_is_never_acted_on_and_leaves_the_fragment_stream_alone() {
    let world = World::small();
    let mut damaged = world.snapshot(1);
    damaged.last_mut().unwrap().sha256 = vec![0; 32].into();
    let mut learner = Scripted::start(Ok(world.admission(1)), damaged).await;
    let actor = Actor::of(&learner, "one");
    let mut conversation = learner.ready(1).await;
    while actor.metric("cross_actor_snapshots_total{outcome=\"damaged\"}").await == 0.0 {
        tokio::task::yield_now().await;
    }
    // The actor asks for the weights again, on the same connection.
    learner.publish(world.snapshot(2));
    conversation.say(Answer::Assignment(world.assignment(3))).await;
    let fragments = whole_episode(&mut conversation).await;
    assert!(fragments.iter().all(|f| f.policy_version == 2));
    assert!(learner.conversations.try_recv().is_err(), "the first stream of fragments was enough");
    assert_eq!(actor.metric("cross_actor_reconnects_total").await, 0.0);
    conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    assert_eq!(actor.end().await.unwrap(), Ending::Complete);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_is_full_counts_as_there() {
    let world = World::small();
    let full = status::too_many_actors(1, std::time::Duration::from_millis(400));
    let mut learner = Scripted::start(Err(full), world.snapshot(1)).await;
    // Refused for longer than the actor would wait for a learner that is away.
    let mut actor = Actor::start(&format!("http://{}", learner.address), "one", &["--give-up-seconds", "1"]);
    let begun = std::time::Instant::now();
    while begun.elapsed() < std::time::Duration::from_secs(2) {
        tokio::select! {
            _ = learner.joins.recv() => {}
            ended = &mut actor.running => panic!("it gave up: {ended:?}"),
        }
    }
    learner.admit(Ok(world.admission(1)));
    let conversation = learner.ready(1).await;
    conversation.say(Answer::Goodbye(v1::Goodbye { complete: true })).await;
    assert_eq!(actor.end().await.unwrap(), Ending::Complete);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_foreign_net_under_the_same_name_is_refused_with_both_hashes() {
    let world = World::small();
    let mut admission = world.admission(1);
    admission.scenarios[0].layout_hash = "0123456789abcdef".to_owned();
    let learner = Scripted::start(Ok(admission), world.snapshot(1)).await;
    let error = Actor::of(&learner, "one").end().await.unwrap_err();
    let text = error.to_string();
    assert_eq!(error.exit_code(), 2);
    for part in [SCENARIO, "0123456789abcdef", &world.layout.hash()] {
        assert!(text.contains(part), "{part} is not in: {text}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_of_another_protocol_is_left_at_once() {
    let refusal = status::protocol_mismatch(cross_proto::PROTOCOL_VERSION, 99);
    let learner = Scripted::start(Err(refusal), Vec::new()).await;
    let error = Actor::of(&learner, "one").end().await.unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("protocol version"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn fragments_that_the_learner_finds_fault_with_do_not_go_round_for_ever() {
    let world = World::small();
    let mut learner = Scripted::of(&world).await;
    let actor = Actor::of(&learner, "one");
    let fault = cross_proto::Violation::new("rewards", "holds a NaN");
    loop {
        let mut conversation = tokio::select! {
            conversation = learner.conversation() => conversation,
            () = async { while !actor.running.is_finished() { tokio::task::yield_now().await } } => break,
        };
        assert_eq!(conversation.hello().await, 1);
        // Never an assignment, so the learner's complaint is all that ever comes.
        conversation.fail(status::invalid(&fault)).await;
    }
    let error = actor.end().await.unwrap_err();
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains("rewards holds a NaN"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_without_a_learner_gives_up_in_the_end() {
    // A port that was free a moment ago and has no listener.
    let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let actor = Actor::start(&format!("http://{address}"), "one", &["--give-up-seconds", "1"]);
    let error = actor.end().await.unwrap_err();
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains(&address.to_string()), "{error}");
}
