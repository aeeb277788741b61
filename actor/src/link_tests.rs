use super::*;
use bytes::Bytes;
use tokio::runtime::Runtime;

/// Both ends, with join 1 of session 10 as the present one. The runtime only has to live.
struct Fixture {
    _runtime: Runtime,
    simulator: SimulatorEnd,
    network: NetworkEnd,
    stop: CancellationToken,
    session: Arc<Session>,
}

fn fixture() -> Fixture {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let stop = CancellationToken::new();
    let (simulator, network) = pair(stop.clone(), runtime.handle().clone());
    let session = Session::bare(1, 10);
    network.session.send_replace(Some(Arc::clone(&session)));
    network.directions.send_replace(Directions { epoch: 10, ..Directions::default() });
    Fixture { _runtime: runtime, simulator, network, stop, session }
}

fn snapshot(epoch: u64, policy_version: u64) -> Option<Snapshot> {
    let weights = cross_proto::weights::Snapshot { policy_version, bytes: Bytes::new() };
    Some(Snapshot { epoch, weights })
}

fn assignment(episode: u64) -> v1::EpisodeAssignment {
    v1::EpisodeAssignment { episode, ..Default::default() }
}

#[test]
fn a_full_queue_holds_the_simulator_until_the_session_changes() {
    let Fixture { mut simulator, network, session, .. } = fixture();
    assert_eq!(simulator.send(&session, Record::Request), Ok(()));
    let blocked = std::thread::spawn({
        let session = Arc::clone(&session);
        move || simulator.send(&session, Record::Request)
    });
    network.session.send_replace(Some(Session::bare(2, 10)));
    assert_eq!(blocked.join().unwrap(), Err(Halt::SessionChanged));
    assert!(network.records.len() == 1, "the second record was not taken");
}

#[test]
fn a_full_queue_holds_the_simulator_until_the_actor_stops() {
    let Fixture { mut simulator, network: _network, session, stop, .. } = fixture();
    assert_eq!(simulator.send(&session, Record::Request), Ok(()));
    let blocked = std::thread::spawn(move || simulator.send(&session, Record::Request));
    stop.cancel();
    assert_eq!(blocked.join().unwrap(), Err(Halt::Stop));
}

#[test]
fn an_assignment_of_an_earlier_join_is_passed_over() {
    let Fixture { mut simulator, mut network, session, .. } = fixture();
    let asking = std::thread::spawn(move || simulator.next_episode(&session).map(|a| a.episode));
    assert!(matches!(network.records.blocking_recv(), Some((1, Record::Request))));
    network.assignments.blocking_send((0, assignment(7))).unwrap();
    network.assignments.blocking_send((1, assignment(8))).unwrap();
    assert_eq!(asking.join().unwrap(), Ok(8));
}

#[test]
fn weights_must_be_of_the_session_and_new_enough() {
    let Fixture { mut simulator, network, session, .. } = fixture();
    network.directions.send_modify(|directions| directions.min_policy_version = 3);
    network.snapshot.send_replace(snapshot(9, 5));
    let waiting = std::thread::spawn(move || {
        let first = simulator.weights(&session, 0).map(|s| s.policy_version);
        (first, simulator.weights(&session, 4).map(|s| s.policy_version))
    });
    // Each replaces the one before, whether the simulator has looked at it or not: neither of the first two will do.
    network.snapshot.send_replace(snapshot(10, 2));
    network.snapshot.send_replace(snapshot(10, 4));
    assert_eq!(waiting.join().unwrap(), (Ok(4), Ok(4)));
}

#[test]
fn only_the_named_episode_of_the_present_session_is_given_up() {
    let Fixture { simulator, network, session, stop, .. } = fixture();
    assert_eq!(simulator.check(&session, 3), Ok(()));
    network.directions.send_modify(|directions| directions.unknown_episode = Some(3));
    assert_eq!(simulator.check(&session, 3), Err(Halt::UnknownEpisode));
    assert_eq!(simulator.check(&session, 4), Ok(()));
    network.directions.send_modify(|directions| directions.epoch = 9);
    assert_eq!(simulator.check(&session, 3), Ok(()));

    network.session.send_replace(None);
    assert_eq!(simulator.check(&session, 3), Err(Halt::SessionChanged));
    stop.cancel();
    assert_eq!(simulator.check(&session, 3), Err(Halt::Stop));
}

#[test]
fn only_its_own_acknowledgement_ends_the_wait_for_it() {
    let Fixture { mut simulator, network, session, .. } = fixture();
    network.directions.send_modify(|directions| directions.acknowledged = Some((2, 5)));
    let waiting = std::thread::spawn(move || simulator.acknowledged(&session, 3, 0));
    network.directions.send_modify(|directions| directions.acknowledged = Some((3, 0)));
    assert_eq!(waiting.join().unwrap(), Ok(()));
}

#[test]
fn there_is_no_session_for_an_actor_that_stops() {
    let Fixture { mut simulator, stop, session, .. } = fixture();
    assert_eq!(simulator.session().map(|s| s.join), Some(session.join));
    stop.cancel();
    assert!(simulator.session().is_none());
}
