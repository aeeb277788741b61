//! Messages that are sent before the answers to earlier ones are there, with a real SUMO.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers may fail as its body may")]

mod common;

use common::{eventually, runs, signal, start};
use cross_traci::constants::{any, lane, vehicle};
use cross_traci::{Domain, ErrorKind, Sumo, TraciError};

/// Ids of all vehicles, in SUMO's order.
fn who(sumo: &mut Sumo) -> Vec<String> {
    sumo.client().ids(Domain::Vehicle).unwrap()
}

fn show(sumo: &mut Sumo, state: char) -> cross_traci::Batch<'_> {
    let mut batch = sumo.client().batch();
    for light in ["A0", "B1", "C2", "D3"] {
        batch.set_traffic_light_state(light, &state.to_string().repeat(36));
    }
    batch
}

#[test]
fn what_is_posted_happens_in_order_as_if_it_was_waited_for() {
    let (mut waiting, mut posting) = (start(), start());
    for round in 0..20 {
        let (state, to) = (if round % 2 == 0 { 'G' } else { 'r' }, 10.0 * f64::from(round + 1));
        show(&mut waiting, state).send().unwrap();
        waiting.client().simulation_step(to - 7.0).unwrap();
        show(&mut waiting, 'y').send().unwrap();
        waiting.client().simulation_step(to).unwrap();

        show(&mut posting, state).post().unwrap();
        posting.client().post_step(to - 7.0).unwrap();
        show(&mut posting, 'y').post().unwrap();
        posting.client().post_step(to).unwrap();
        assert_eq!(posting.client().waiting(), 4);
        assert_eq!(who(&mut waiting), who(&mut posting), "at {to} s");
        assert_eq!(posting.client().waiting(), 0);
    }
    assert!(who(&mut posting).len() > 20);
    let (one, other) = (waiting.client().statistics(), posting.client().statistics());
    assert_eq!(
        (one.messages, one.commands + 1, one.bytes_sent),
        (other.messages - 1, other.commands, one.bytes_sent)
    );
}

#[test]
fn answers_are_taken_one_by_one() {
    let mut sumo = start();
    let client = sumo.client();
    client.subscribe(Domain::Simulation, "", &[cross_traci::constants::simulation::TIME]).unwrap();
    for second in 1..=5 {
        client.post_step(f64::from(second)).unwrap();
        let mut batch = client.batch();
        batch.get(Domain::Vehicle, any::ID_COUNT, "");
        batch.post().unwrap();
    }
    client.flush().unwrap();
    for second in 1..=5 {
        let step = client.take().unwrap().step().unwrap();
        let time = step.iter().next().unwrap().objects().next().unwrap().values().next().unwrap().1;
        assert_eq!(time.double().unwrap(), f64::from(second));
        let count = client.take().unwrap();
        assert!(count.step().is_none() && count.int(0).unwrap() >= 0);
        assert!(client.subscriptions().is_empty());
    }
    assert!(client.take().unwrap().is_empty());
    assert_eq!(client.time().unwrap(), 5.0);
}

#[test]
fn a_refusal_of_something_posted_is_told_by_the_next_call_and_harms_nothing() {
    let mut sumo = start();
    let client = sumo.client();
    client.post_step(3.0).unwrap();
    client.batch().set_traffic_light_state("nowhere", "G");
    let mut batch = client.batch();
    batch.set_traffic_light_state("nowhere", "G").set_traffic_light_state("A0", &"r".repeat(36));
    batch.post().unwrap();
    client.post_step(4.0).unwrap();
    let error = client.time().unwrap_err();
    let TraciError::Refused { command, refused: 1, sent: 2, .. } = &error else { panic!("{error:?}") };
    assert!(command.contains("'nowhere'"), "{error}");
    assert_eq!(client.time().unwrap(), 4.0);
    let state = client.get_string(Domain::TrafficLight, 0x20, "A0").unwrap();
    assert_eq!(state, "r".repeat(36));
}

#[test]
fn a_time_that_is_no_number_is_not_posted() {
    let mut sumo = start();
    assert_eq!(sumo.client().post_step(f64::NAN).unwrap_err().kind(), ErrorKind::Refused);
    assert_eq!(sumo.client().waiting(), 0);
    assert_eq!(sumo.client().time().unwrap(), 0.0);
}

#[test]
fn a_sumo_that_dies_is_told_by_the_message_that_was_waited_for() {
    let mut sumo = start();
    let pid = sumo.pid();
    sumo.client().post_step(10.0).unwrap();
    sumo.client().take().unwrap();
    sumo.client().post_step(20.0).unwrap();
    sumo.client().post_step(30.0).unwrap();
    signal(pid, rustix::process::Signal::KILL);
    assert!(eventually(|| !runs(pid)));
    let error = sumo.client().take().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert!(error.to_string().contains("the simulation step to 20 s"), "{error}");
    assert_eq!(sumo.client().post_step(40.0).unwrap_err().to_string().matches("SIGKILL").count(), 1);
}

/// Neither side's socket holds all this: SUMO would wait for room for its answers, and we for SUMO to read.
#[test]
fn answers_that_nobody_takes_yet_do_not_stop_what_is_sent() {
    let mut sumo = start();
    let client = sumo.client();
    client.simulation_step(100.0).unwrap();
    let lanes = client.ids(Domain::Lane).unwrap();
    let rounds = 100;
    for _ in 0..rounds {
        let mut batch = client.batch();
        for id in &lanes {
            batch.get(Domain::Lane, lane::LAST_STEP_VEHICLE_IDS, id);
        }
        batch.get(Domain::Lane, any::ID_LIST, "");
        batch.post().unwrap();
    }
    assert!(client.statistics().bytes_sent < 10_000);
    client.flush().unwrap();
    for _ in 0..rounds {
        let replies = client.take().unwrap();
        assert_eq!(replies.value(lanes.len()).unwrap().strings().unwrap().len(), lanes.len());
    }
    assert!(client.statistics().bytes_received > 3_000_000, "{:?}", client.statistics());
    assert!(client.get_double(Domain::Vehicle, vehicle::SPEED, "nobody").is_err());
    assert_eq!(client.time().unwrap(), 100.0);
}
