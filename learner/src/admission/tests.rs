//! Every rule by the commands it returns.

use super::*;
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, RecurrentState};
use std::time::Duration;

pub(super) const EPOCH: u64 = 77;
pub(super) const EPISODE: u32 = 30;

pub(super) fn settings(scenarios: &[&str]) -> Settings {
    Settings {
        seed: 1,
        session_epoch: EPOCH,
        scenarios: scenarios
            .iter()
            .map(|name| ScenarioSettings { name: (*name).to_owned(), agents: 2, incoming_lanes: 4 })
            .collect(),
        round_steps: 30,
        buffered_steps: 60,
        episode_steps: EPISODE,
        fragment_steps: 10,
        unacked_fragments: 4,
        max_policy_lag: 2,
        serial: false,
        max_actors: 8,
        lease: Duration::from_secs(30),
        updates: 1000,
    }
}

pub(super) fn fragment(
    actor: &str,
    episode: u64,
    sequence: u32,
    scenario: &str,
    first_step: u32,
    steps: u32,
) -> Fragment {
    let end = if first_step + steps == EPISODE { FragmentEnd::Truncated } else { FragmentEnd::Continues };
    Fragment {
        id: FragmentId { actor: actor.to_owned(), session_epoch: EPOCH, episode, sequence },
        scenario: scenario.to_owned(),
        layout_hash: String::new(),
        policy_version: 1,
        first_step,
        steps,
        counts: Vec::new(),
        phases: Vec::new(),
        actions: Vec::new(),
        log_probs: Vec::new(),
        rewards: vec![-1.0; 2 * steps as usize],
        recurrent: RecurrentState::default(),
        end,
    }
}

/// A machine with one actor, `a`, on stream 1.
fn joined(settings: Settings) -> Admission {
    let mut admission = Admission::new(settings, 1, Progress::default());
    admission.join(Duration::ZERO, "a", &[]).unwrap();
    admission.hello(Duration::ZERO, StreamId(1), "a", EPOCH).unwrap();
    admission
}

fn request(admission: &mut Admission, stream: u64) -> Option<Assignment> {
    let commands = admission.request_episode(Duration::ZERO, StreamId(stream));
    commands
        .into_iter()
        .find_map(|c| if let Command::Assign { assignment, .. } = c { Some(assignment) } else { None })
}

fn outcomes(commands: &[Command]) -> Vec<(u64, u32, Outcome)> {
    let outcome = |c: &Command| match c {
        Command::Acknowledge { episode, sequence, outcome, .. } => Some((*episode, *sequence, *outcome)),
        _ => None,
    };
    commands.iter().filter_map(outcome).collect()
}

fn offer(admission: &mut Admission, stream: u64, fragment: Fragment) -> Vec<Command> {
    admission.offer(Duration::ZERO, StreamId(stream), fragment)
}

/// Sends a whole episode of three fragments.
fn episode(admission: &mut Admission, stream: u64, actor: &str, scenario: &str, id: u64) -> Vec<Command> {
    let mut commands = Vec::new();
    for sequence in 0..3 {
        commands.extend(offer(admission, stream, fragment(actor, id, sequence, scenario, sequence * 10, 10)));
    }
    commands
}

fn round(commands: &[Command]) -> Option<&Round> {
    commands.iter().find_map(|c| if let Command::Update(round) = c { Some(round) } else { None })
}

#[test]
fn a_round_starts_when_the_quota_is_there_and_statistics_follow_the_episode() {
    let mut admission = joined(settings(&["x"]));
    let assigned = request(&mut admission, 1).unwrap();
    assert_eq!((assigned.episode, assigned.scenario, assigned.min_policy_version), (0, 0, 0));
    assert!(assigned.sumo_seed >= FIRST_TRAINING_SEED);
    let commands = episode(&mut admission, 1, "a", "x", 0);
    let accepted: Vec<_> = (0..3).map(|sequence| (0, sequence, Outcome::Accepted)).collect();
    assert_eq!(outcomes(&commands), accepted);
    let round = round(&commands).unwrap();
    assert_eq!(round.fragments.len(), 3);
    assert_eq!((round.progress.updates, round.progress.decisions, round.progress.episodes), (1, 60, 1));
    let scenario = round.progress.scenarios["x"];
    assert_eq!(scenario.episode_return, Some(-30.0)); // 30 steps, -1 each, the same for both agents
    assert_eq!(scenario.queue_length, Some(0.5)); // 2 stopped vehicles on 4 lanes
}

#[test]
fn a_fragment_sent_again_is_a_duplicate_during_and_after_its_episode() {
    let mut admission = joined(settings(&["x", "y"]));
    request(&mut admission, 1).unwrap();
    let first = fragment("a", 0, 0, "x", 0, 10);
    offer(&mut admission, 1, first.clone());
    assert_eq!(outcomes(&offer(&mut admission, 1, first.clone())), [(0, 0, Outcome::Duplicate)]);
    offer(&mut admission, 1, fragment("a", 0, 1, "x", 10, 10));
    offer(&mut admission, 1, fragment("a", 0, 2, "x", 20, 10));
    assert_eq!(outcomes(&offer(&mut admission, 1, first)), [(0, 0, Outcome::Duplicate)]);
    assert_eq!(admission.offered(0, Outcome::Accepted), 3);
    assert_eq!(admission.buffered_steps(0), 30);
}

#[test]
fn other_sessions_and_unknown_episodes_are_declined() {
    let mut admission = joined(settings(&["x"]));
    let mut old = fragment("a", 0, 0, "x", 0, 10);
    old.id.session_epoch = 5;
    assert_eq!(outcomes(&offer(&mut admission, 1, old)), [(0, 0, Outcome::OldSession)]);
    let unknown = fragment("a", 9, 0, "x", 0, 10);
    assert_eq!(outcomes(&offer(&mut admission, 1, unknown)), [(9, 0, Outcome::UnknownEpisode)]);
    // Another actor's episode is as unknown as one that never was.
    admission.join(Duration::ZERO, "b", &[]).unwrap();
    admission.hello(Duration::ZERO, StreamId(2), "b", EPOCH).unwrap();
    request(&mut admission, 1).unwrap();
    let foreign = fragment("b", 0, 0, "x", 0, 10);
    assert_eq!(outcomes(&offer(&mut admission, 2, foreign)), [(0, 0, Outcome::UnknownEpisode)]);
    assert_eq!(admission.buffered_steps(0), 0);
}

#[test]
fn fields_at_fault_end_that_stream_alone() {
    let base = || fragment("a", 0, 0, "x", 0, 10);
    let mut cases = Vec::new();
    let mut gap = fragment("a", 0, 1, "x", 10, 10);
    gap.id.sequence = 2;
    cases.push(("sequence", gap));
    cases.push(("first_step", Fragment { first_step: 3, ..base() }));
    cases.push(("steps", Fragment { steps: EPISODE + 1, ..base() }));
    cases.push(("end", Fragment { steps: EPISODE, end: FragmentEnd::Continues, ..base() }));
    cases.push(("scenario", Fragment { scenario: "y".to_owned(), ..base() }));
    cases.push(("policy_version", Fragment { policy_version: 2, ..base() }));
    let mut other = base();
    other.id.actor = "b".to_owned();
    cases.push(("actor_id", other));
    for (expected, bad) in cases {
        let mut admission = joined(settings(&["x", "y"]));
        admission.join(Duration::ZERO, "b", &[]).unwrap();
        admission.hello(Duration::ZERO, StreamId(2), "b", EPOCH).unwrap();
        request(&mut admission, 1).unwrap();
        let b = request(&mut admission, 2).unwrap();
        let commands = offer(&mut admission, 1, bad);
        let [Command::Close { stream: StreamId(1), reason: CloseReason::Invalid { field, .. } }] =
            &commands[..]
        else {
            panic!("{expected}: {commands:?}")
        };
        assert_eq!(*field, expected);
        let name = admission.settings().scenarios[b.scenario].name.clone();
        let fine = offer(&mut admission, 2, fragment("b", b.episode, 0, &name, 0, 10));
        assert_eq!(outcomes(&fine), [(b.episode, 0, Outcome::Accepted)], "{expected}");
        // The actor may open a stream again under its lease; its episode is gone.
        admission.hello(Duration::ZERO, StreamId(3), "a", EPOCH).unwrap();
        let late = offer(&mut admission, 3, base());
        assert_eq!(outcomes(&late), [(0, 0, Outcome::UnknownEpisode)], "{expected}");
    }
}

#[test]
fn episodes_go_where_supply_is_least_counting_what_is_in_flight() {
    let mut admission = joined(settings(&["x", "y", "z"]));
    let mut given = Vec::new();
    for stream in 1..=6 {
        let actor = format!("a{stream}");
        admission.join(Duration::ZERO, &actor, &[]).unwrap();
        admission.hello(Duration::ZERO, StreamId(stream + 10), &actor, EPOCH).unwrap();
        given.push(request(&mut admission, stream + 10).unwrap().scenario);
    }
    assert_eq!(given, [0, 1, 2, 0, 1, 2]);
    // An aborted episode gives its share back: its scenario is next.
    admission.abort_episode(Duration::ZERO, StreamId(12), 1);
    assert_eq!(request(&mut admission, 1).unwrap().scenario, 1);
}

#[test]
fn an_actor_gets_only_scenarios_it_can_run() {
    let mut admission = joined(settings(&["x", "y"]));
    let only_y = ["y".to_owned()];
    admission.join(Duration::ZERO, "b", &only_y).unwrap();
    admission.hello(Duration::ZERO, StreamId(2), "b", EPOCH).unwrap();
    assert_eq!(request(&mut admission, 2).unwrap().scenario, 1);
    assert_eq!(request(&mut admission, 2).unwrap().scenario, 1);
    let refusal = admission.join(Duration::ZERO, "c", &["moon".to_owned()]).unwrap_err();
    assert!(refusal.to_string().contains("x, y"), "{refusal}");
}

#[test]
fn data_too_old_is_dropped_on_arrival_and_while_it_waits() {
    let mut admission = joined(settings(&["x", "y"]));
    let only = |name: &str| [name.to_owned()];
    admission.join(Duration::ZERO, "a", &only("x")).unwrap();
    admission.hello(Duration::ZERO, StreamId(1), "a", EPOCH).unwrap();
    request(&mut admission, 1).unwrap();
    offer(&mut admission, 1, fragment("a", 0, 0, "x", 0, 10));
    let _ = admission.updated(3);
    assert_eq!(admission.buffered_steps(0), 10, "a lag of 2 is within the limit");
    let _ = admission.updated(4);
    assert_eq!((admission.buffered_steps(0), admission.dropped(0, Dropped::Stale)), (0, 1));
    let late = offer(&mut admission, 1, fragment("a", 0, 1, "x", 10, 10));
    assert_eq!(outcomes(&late), [(0, 1, Outcome::Stale)]);
    assert_eq!((admission.offered(0, Outcome::Stale), admission.offered(1, Outcome::Stale)), (1, 0));
}

/// Paused, with the episode of `a` buffered and two fragments' worth of room for `b`, which is at its episode's start.
fn nearly_full(unacked_fragments: usize) -> Admission {
    let mut admission = joined(Settings { buffered_steps: 40, unacked_fragments, ..settings(&["x"]) });
    admission.pause();
    admission.join(Duration::ZERO, "b", &[]).unwrap();
    admission.hello(Duration::ZERO, StreamId(2), "b", EPOCH).unwrap();
    request(&mut admission, 1).unwrap();
    request(&mut admission, 2).unwrap();
    assert_eq!(outcomes(&episode(&mut admission, 1, "a", "x", 0)).len(), 3);
    assert_eq!(outcomes(&offer(&mut admission, 2, fragment("b", 1, 0, "x", 0, 10))).len(), 1);
    admission
}

#[test]
fn a_full_buffer_withholds_acknowledgements_until_an_update_drains_it() {
    let mut admission = nearly_full(4);
    assert_eq!(offer(&mut admission, 2, fragment("b", 1, 1, "x", 10, 10)), []);
    // Sent again, it is still one fragment with one answer to come.
    assert_eq!(offer(&mut admission, 2, fragment("b", 1, 1, "x", 10, 10)), []);
    assert!(admission.is_holding_back());
    let commands = admission.resume();
    assert_eq!(round(&commands).unwrap().fragments.len(), 3);
    assert_eq!(outcomes(&commands), [(1, 1, Outcome::Accepted)]);
}

#[test]
fn a_fragment_over_the_limit_of_unacknowledged_ones_ends_the_stream() {
    let mut admission = nearly_full(1);
    offer(&mut admission, 2, fragment("b", 1, 1, "x", 10, 10));
    let commands = offer(&mut admission, 2, fragment("b", 1, 2, "x", 20, 10));
    let reason = CloseReason::TooManyUnacked { limit: 1 };
    assert_eq!(commands, [Command::Close { stream: StreamId(2), reason }]);
}

#[test]
fn joining_again_ends_the_stream_but_a_healed_connection_loses_nothing() {
    let mut admission = joined(settings(&["x", "y"]));
    request(&mut admission, 1).unwrap();
    offer(&mut admission, 1, fragment("a", 0, 0, "x", 0, 10));
    let commands = admission.join(Duration::ZERO, "a", &[]).unwrap();
    assert_eq!(commands, [Command::Close { stream: StreamId(1), reason: CloseReason::Replaced }]);
    assert_eq!(offer(&mut admission, 1, fragment("a", 0, 1, "x", 10, 10)), [], "the old stream is dead");
    admission.hello(Duration::ZERO, StreamId(2), "a", EPOCH).unwrap();
    assert_eq!(
        outcomes(&offer(&mut admission, 2, fragment("a", 0, 0, "x", 0, 10))),
        [(0, 0, Outcome::Duplicate)]
    );
    assert_eq!(
        outcomes(&offer(&mut admission, 2, fragment("a", 0, 1, "x", 10, 10))),
        [(0, 1, Outcome::Accepted)]
    );
}

#[test]
fn leases_end_after_silence_and_free_the_place_and_the_share() {
    let mut admission = joined(Settings { max_actors: 1, ..settings(&["x", "y"]) });
    request(&mut admission, 1).unwrap();
    let refusal = admission.join(Duration::ZERO, "b", &[]).unwrap_err();
    assert_eq!(refusal, JoinRefusal::TooManyActors { limit: 1 });
    assert_eq!(admission.heartbeat(Duration::from_secs(20), StreamId(1)), []);
    assert_eq!(admission.tick(Duration::from_secs(50)), []);
    let reason = CloseReason::LeaseEnded;
    assert_eq!(admission.tick(Duration::from_secs(51)), [Command::Close { stream: StreamId(1), reason }]);
    assert_eq!(admission.actors(), 0);
    admission.join(Duration::from_secs(51), "b", &[]).unwrap();
    admission.hello(Duration::from_secs(51), StreamId(2), "b", EPOCH).unwrap();
    assert_eq!(request(&mut admission, 2).unwrap().scenario, 0, "the lost episode's share is free");
    let gone = admission.hello(Duration::ZERO, StreamId(3), "a", EPOCH).unwrap_err();
    assert_eq!(gone, HelloRefusal::NotJoined { actor: "a".to_owned() });
    let old = admission.hello(Duration::ZERO, StreamId(3), "b", 1).unwrap_err();
    assert_eq!(old, HelloRefusal::OldSession { got: 1, expected: EPOCH });
}

#[test]
fn time_in_which_the_learner_stood_still_is_nobodys_silence() {
    let mut admission = joined(settings(&["x"]));
    admission.heartbeat(Duration::from_secs(20), StreamId(1));
    // Stopped from 25 s to 85 s.
    admission.stood_still(Duration::from_secs(85), Duration::from_secs(60));
    assert_eq!(admission.tick(Duration::from_secs(85)), []);
    assert_eq!(admission.tick(Duration::from_secs(110)), []);
    assert_eq!(admission.tick(Duration::from_secs(111)).len(), 1, "silence counts again");
}

#[test]
fn an_actor_that_leaves_in_order_frees_its_place_at_once() {
    let mut admission = joined(Settings { max_actors: 1, ..settings(&["x"]) });
    admission.left(StreamId(1));
    assert_eq!(admission.actors(), 0);
    admission.join(Duration::ZERO, "b", &[]).unwrap();
}

#[test]
fn serial_mode_answers_after_the_update_with_its_version() {
    let mut admission = joined(Settings { serial: true, unacked_fragments: 1, ..settings(&["x"]) });
    let other = admission.join(Duration::ZERO, "b", &[]).unwrap_err();
    assert_eq!(other, JoinRefusal::SerialTaken { actor: "a".to_owned() });
    assert_eq!(request(&mut admission, 1).unwrap().min_policy_version, 1);
    let commands = episode(&mut admission, 1, "a", "x", 0);
    assert_eq!(outcomes(&commands).len(), 2, "the fragment that completes the round waits");
    assert!(round(&commands).is_some());
    assert_eq!(request(&mut admission, 1), None, "so does the next episode");
    // A reconnection in between must not slip past the update either.
    assert_eq!(offer(&mut admission, 1, fragment("a", 0, 2, "x", 20, 10)), []);
    let commands = admission.updated(2);
    let [Command::Acknowledge { min_policy_version: 2, sequence: 2, .. }, Command::Assign { assignment, .. }] =
        &commands[..]
    else {
        panic!("{commands:?}")
    };
    assert_eq!((assignment.episode, assignment.min_policy_version), (1, 2));
}

#[test]
fn serial_mode_repeats_an_episode_that_was_given_up() {
    let mut admission = joined(Settings { serial: true, unacked_fragments: 1, ..settings(&["x"]) });
    let first = request(&mut admission, 1).unwrap();
    offer(&mut admission, 1, fragment("a", 0, 0, "x", 0, 10));
    admission.abort_episode(Duration::ZERO, StreamId(1), 0);
    assert_eq!((admission.buffered_steps(0), admission.dropped(0, Dropped::Aborted)), (0, 1));
    assert_eq!(request(&mut admission, 1).unwrap(), first);
    let commands = episode(&mut admission, 1, "a", "x", 0);
    assert_eq!(round(&commands).unwrap().fragments.len(), 3);
}

#[test]
fn nothing_starts_after_stop_or_past_the_last_update() {
    let mut admission = joined(Settings { updates: 1, ..settings(&["x"]) });
    request(&mut admission, 1).unwrap();
    assert!(round(&episode(&mut admission, 1, "a", "x", 0)).is_some());
    assert_eq!(request(&mut admission, 1), None);
    assert!(!admission.is_complete());
    assert_eq!(admission.updated(2), []);
    assert!(admission.is_complete());

    let mut admission = joined(settings(&["x"]));
    request(&mut admission, 1).unwrap();
    admission.stop();
    assert!(round(&episode(&mut admission, 1, "a", "x", 0)).is_none());
    assert_eq!(request(&mut admission, 1), None);
}

#[test]
fn counters_go_on_from_a_checkpoint() {
    let progress =
        Progress { updates: 4, next_episode: 17, episodes: 15, decisions: 999, ..Progress::default() };
    let mut admission = Admission::new(settings(&["x"]), 2, progress);
    admission.join(Duration::ZERO, "a", &[]).unwrap();
    admission.hello(Duration::ZERO, StreamId(1), "a", EPOCH).unwrap();
    assert_eq!(request(&mut admission, 1).unwrap().episode, 17);
    let commands = episode(&mut admission, 1, "a", "x", 17);
    let progress = &round(&commands).unwrap().progress;
    assert_eq!((progress.updates, progress.next_episode, progress.episodes), (5, 18, 16));
    assert_eq!(progress.decisions, 999 + 60);
}

#[test]
fn a_failed_update_costs_its_round_and_nothing_more() {
    let mut admission = joined(settings(&["x"]));
    request(&mut admission, 1).unwrap();
    assert!(round(&episode(&mut admission, 1, "a", "x", 0)).is_some());
    admission.update_failed();
    assert_eq!((admission.progress().updates, admission.progress().decisions), (0, 0));
    assert_eq!((admission.policy_version(), admission.dropped(0, Dropped::UpdateFailed)), (1, 3));
    request(&mut admission, 1).unwrap();
    assert_eq!(round(&episode(&mut admission, 1, "a", "x", 1)).unwrap().progress.updates, 1);
}

/// What the journal says meanwhile: the message of each line and the fragment's place in its episode, in order.
fn journal(act: impl FnOnce()) -> Vec<(String, u32)> {
    let file = tempfile::NamedTempFile::new().unwrap();
    let subscriber = tracing_subscriber::fmt()
        .json()
        .with_max_level(tracing::Level::DEBUG)
        .with_writer(std::sync::Arc::new(file.reopen().unwrap()))
        .finish();
    // With a single subscriber, what another test's thread says first decides whether a line is ever of interest.
    let _second = tracing::Dispatch::new(tracing_subscriber::fmt().with_writer(std::io::sink).finish());
    tracing::subscriber::with_default(subscriber, act);
    let text = std::fs::read_to_string(file.path()).unwrap();
    text.lines()
        .map(|line| {
            let fields = serde_json::from_str::<serde_json::Value>(line).unwrap()["fields"].take();
            let said = [&fields["message"], &fields["reason"]].map(|said| said.as_str().unwrap_or_default());
            (
                said.join(" ").trim_end().to_owned(),
                serde_json::from_value(fields["sequence"].clone()).unwrap(),
            )
        })
        .collect()
}

#[test]
fn the_journal_names_what_a_failed_update_loses_and_not_what_a_good_one_trained_on() {
    let lines = |wanted: &str, lines: &[(String, u32)]| -> Vec<u32> {
        lines.iter().filter(|(said, _)| said == wanted).map(|&(_, sequence)| sequence).collect()
    };
    let mut admission = joined(settings(&["x"]));
    let taken = journal(|| {
        request(&mut admission, 1).unwrap();
        assert!(round(&episode(&mut admission, 1, "a", "x", 0)).is_some());
    });
    assert_eq!(lines("fragment trained on", &taken), [0, 1, 2]);
    let failed = journal(|| {
        admission.update_failed();
    });
    assert_eq!(lines("fragment dropped update_failed", &failed), [0, 1, 2]);
    let good = journal(|| {
        request(&mut admission, 1).unwrap();
        assert!(round(&episode(&mut admission, 1, "a", "x", 1)).is_some());
        admission.updated(2);
        // A report that comes twice must not take back what was good.
        admission.update_failed();
    });
    assert_eq!(lines("fragment trained on", &good), [0, 1, 2]);
    assert_eq!(lines("fragment dropped update_failed", &good), [0_u32; 0]);
}
