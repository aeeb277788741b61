//! The protocol, spoken with a real SUMO.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers may fail as its body may")]

mod common;

use common::{grid, home, start};
use cross_traci::constants::{junction, lane, simulation, traffic_light, vehicle};
use cross_traci::{Argument, Domain, ErrorKind, Reply, Sumo, TraciError, Value};
use std::collections::BTreeMap;

const WANTED: [u8; 3] = [vehicle::LANE_ID, vehicle::LANE_POSITION, vehicle::SPEED];

/// Lane, position and speed of every vehicle, bit for bit.
type Vehicles = BTreeMap<String, (String, u64, u64)>;

fn vehicles(results: cross_traci::SubscriptionResults<'_>) -> Vehicles {
    let context = results.find_context(Domain::Junction, "A0", Domain::Vehicle).unwrap();
    context
        .objects()
        .map(|object| {
            let mut values = object.values();
            let (first, lane) = values.next().unwrap();
            let (second, position) = values.next().unwrap();
            let (third, speed) = values.next().unwrap();
            assert_eq!([first, second, third], WANTED);
            assert!(values.next().is_none());
            let numbers = (position.double().unwrap().to_bits(), speed.double().unwrap().to_bits());
            (object.id().to_owned(), (lane.str().unwrap().to_owned(), numbers.0, numbers.1))
        })
        .collect()
}

fn subscribe_all(sumo: &mut Sumo) {
    sumo.client().subscribe_context(Domain::Junction, "A0", 1e7, Domain::Vehicle, &WANTED).unwrap();
}

#[test]
fn the_handshake_tells_the_version() {
    let mut sumo = start();
    let (api, identifier) = sumo.client().version();
    assert_eq!(api, 22);
    assert!(identifier.starts_with("SUMO 1."), "{identifier}");
    assert_eq!(format!("SUMO {}", home().version().unwrap()), identifier);
}

#[test]
fn thirty_seconds_at_once_equal_thirty_single_ones() {
    let (mut one, mut many) = (start(), start());
    subscribe_all(&mut one);
    subscribe_all(&mut many);
    for round in 1..=10 {
        let to = f64::from(round) * 30.0;
        let at_once = vehicles(one.client().simulation_step(to).unwrap());
        for _ in 0..29 {
            many.client().simulation_step(0.0).unwrap();
        }
        let one_by_one = vehicles(many.client().simulation_step(0.0).unwrap());
        assert!(!at_once.is_empty());
        assert_eq!(at_once, one_by_one, "at {to} s");
        assert_eq!((one.client().time().unwrap(), many.client().time().unwrap()), (to, to));
    }
}

#[test]
fn a_context_subscription_equals_reading_every_vehicle() {
    let mut sumo = start();
    subscribe_all(&mut sumo);
    let subscribed = vehicles(sumo.client().simulation_step(200.0).unwrap());
    let client = sumo.client();
    let mut ids = client.ids(Domain::Vehicle).unwrap();
    ids.sort();
    assert_eq!(ids, subscribed.keys().cloned().collect::<Vec<_>>());
    assert!(ids.len() > 20);

    let mut batch = client.batch();
    for id in &ids {
        for variable in WANTED {
            batch.get(Domain::Vehicle, variable, id);
        }
    }
    assert_eq!(batch.len(), 3 * ids.len());
    let replies = batch.send().unwrap();
    for (index, id) in ids.iter().enumerate() {
        let read = (
            replies.str(3 * index).unwrap().to_owned(),
            replies.double(3 * index + 1).unwrap().to_bits(),
            replies.double(3 * index + 2).unwrap().to_bits(),
        );
        assert_eq!(read, subscribed[id], "{id}");
    }
}

#[test]
fn looking_around_once_sees_what_a_subscription_sees_and_leaves_none_behind() {
    let (mut once, mut standing) = (start(), start());
    subscribe_all(&mut standing);
    for to in [100.0, 200.0, 300.0] {
        assert!(once.client().simulation_step(to).unwrap().is_empty());
        let seen = once.client().look_around(Domain::Junction, "A0", 1e7, Domain::Vehicle, &WANTED).unwrap();
        let seen: Vec<String> = seen.objects().map(|object| format!("{object:?}")).collect();
        let results = standing.client().simulation_step(to).unwrap();
        let context = results.find_context(Domain::Junction, "A0", Domain::Vehicle).unwrap();
        let subscribed: Vec<String> = context.objects().map(|object| format!("{object:?}")).collect();
        assert!(!seen.is_empty());
        assert_eq!(seen, subscribed, "at {to} s");
    }
}

#[test]
fn a_subscription_brings_its_values_at_once_with_each_step_and_no_more_when_ended() {
    let mut sumo = start();
    let client = sumo.client();
    let halting = [lane::LAST_STEP_HALTING_NUMBER, lane::LAST_STEP_VEHICLE_NUMBER];
    let now = client.subscribe(Domain::Lane, "A0A1_0", &halting).unwrap();
    assert_eq!(now.objects().next().unwrap().get(halting[1]).unwrap().int(), Ok(0));
    client.subscribe(Domain::Simulation, "", &[simulation::TIME]).unwrap();
    let results = client.simulation_step(17.0).unwrap();
    assert_eq!(results.len(), 2);
    let time = results.find(Domain::Simulation, "").unwrap().objects().next().unwrap();
    assert_eq!(time.get(simulation::TIME).unwrap().double(), Ok(17.0));
    assert!(time.get(simulation::SCALE).is_none());
    assert!(results.find(Domain::Lane, "A0A1_0").is_some());
    // A time that has passed makes no step and brings the same again.
    let again = client.simulation_step(17.0).unwrap();
    assert_eq!(again.len(), 2);

    client.unsubscribe(Domain::Lane, "A0A1_0").unwrap();
    assert_eq!(client.simulation_step(18.0).unwrap().len(), 1);
    assert!(client.subscriptions().find(Domain::Lane, "A0A1_0").is_none());
    client.unsubscribe(Domain::Simulation, "").unwrap();
    assert!(client.simulation_step(19.0).unwrap().is_empty());
}

#[test]
fn events_are_counted_over_all_seconds_of_a_step() {
    let (mut one, mut many) = (start(), start());
    let events = [simulation::DEPARTED_NUMBER, simulation::ARRIVED_NUMBER];
    one.client().subscribe(Domain::Simulation, "", &events).unwrap();
    for to in [100.0, 200.0, 300.0] {
        let results = one.client().simulation_step(to).unwrap();
        let object = results.find(Domain::Simulation, "").unwrap().objects().next().unwrap();
        let subscribed = events.map(|event| object.get(event).unwrap().int().unwrap());
        let read = one.client().simulation_state().unwrap();
        let mut summed = [0, 0];
        for _ in 0..100 {
            many.client().simulation_step(0.0).unwrap();
            let second = many.client().simulation_state().unwrap();
            summed = [summed[0] + second.departed, summed[1] + second.arrived];
        }
        assert_eq!(subscribed, summed, "at {to} s");
        assert_eq!([read.departed, read.arrived], summed, "at {to} s");
        assert_eq!(read.time, to);
        assert!(read.min_expected > 0);
    }
}

#[test]
fn all_lights_are_set_and_read_in_one_message_each() {
    let mut sumo = start();
    let client = sumo.client();
    let lights = client.ids(Domain::TrafficLight).unwrap();
    assert_eq!(lights.len(), 16);
    let states: Vec<String> = (0..16).map(|i| "G".repeat(i) + &"r".repeat(36 - i)).collect();
    let before = client.statistics();
    let mut batch = client.batch();
    for (light, state) in lights.iter().zip(&states) {
        batch.set_traffic_light_state(light, state);
    }
    let replies = batch.send().unwrap();
    assert_eq!(replies.len(), 16);
    assert!(replies.iter().all(|reply| reply == Reply::Done));
    let after = client.statistics();
    assert_eq!((after.messages - before.messages, after.commands - before.commands), (1, 16));

    let mut batch = client.batch();
    for light in &lights {
        batch.get(Domain::TrafficLight, traffic_light::RED_YELLOW_GREEN_STATE, light);
    }
    let replies = batch.send().unwrap();
    let read: Vec<&str> = replies
        .iter()
        .map(|reply| match reply {
            Reply::Value(value) => value.str().unwrap(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(read, states);
}

#[test]
fn a_refused_command_carries_sumos_words_and_harms_no_other() {
    let mut sumo = start();
    let client = sumo.client();
    let error = client.set_traffic_light_state("nowhere", "GGG").unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Refused);
    assert_eq!(
        error.to_string(),
        "SUMO refused setting RED_YELLOW_GREEN_STATE of traffic light 'nowhere' to 'GGG': \
         Traffic light 'nowhere' is not known"
    );

    let green = "G".repeat(36);
    let mut batch = client.batch();
    batch.set_traffic_light_state("A0", &green).set_traffic_light_state("nowhere", &green);
    batch.subscribe(Domain::Vehicle, "nobody", &WANTED).set_traffic_light_state("A1", &green);
    let error = batch.send().unwrap_err();
    let TraciError::Refused { refused, sent, ref message, .. } = error else { panic!("{error}") };
    assert_eq!((refused, sent), (2, 4));
    assert!(message.contains("nowhere"), "{message}");
    for light in ["A0", "A1"] {
        let state = traffic_light::RED_YELLOW_GREEN_STATE;
        assert_eq!(client.get_string(Domain::TrafficLight, state, light).unwrap(), green);
    }
    let error = client.get(Domain::Simulation, 0xfe, "").unwrap_err();
    assert!(error.to_string().contains("unsupported variable"), "{error}");
    assert_eq!(client.get(Domain::Gui, 0, "").unwrap_err().kind(), ErrorKind::Refused);
    assert_eq!(client.simulation_step(f64::NAN).unwrap_err().kind(), ErrorKind::Refused);
    assert_eq!(client.time().unwrap(), 0.0);
}

#[test]
fn a_value_asked_for_under_the_wrong_type_is_named() {
    let mut sumo = start();
    let client = sumo.client();
    let error = client.get_int(Domain::Simulation, simulation::TIME, "").unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Protocol);
    assert!(error.to_string().contains("reading TIME of simulation"), "{error}");
    assert!(error.to_string().contains("expected an integer, found a double"), "{error}");
    // That was the caller's mistake: the connection is in step.
    assert_eq!(client.time().unwrap(), 0.0);
}

#[test]
fn every_kind_of_value_is_understood() {
    let mut sumo = start();
    let client = sumo.client();
    client.simulation_step(100.0).unwrap();
    let (x, y) = client.get_position(Domain::Junction, junction::POSITION, "A0").unwrap();
    assert_eq!((x, y), (300.0, 300.0));
    let Value::Polygon(corners) = client.get(Domain::Simulation, simulation::NET_BOUNDING_BOX, "").unwrap()
    else {
        panic!("the bounding box is a polygon")
    };
    assert_eq!(corners.iter().collect::<Vec<_>>(), [(0.0, 0.0), (1500.0, 1500.0)]);
    let lanes = client.get_strings(Domain::TrafficLight, traffic_light::CONTROLLED_LANES, "A0").unwrap();
    assert_eq!(lanes.len(), 36);

    let links = client.get(Domain::TrafficLight, traffic_light::CONTROLLED_LINKS, "A0").unwrap();
    let mut parts = links.compound().unwrap().iter();
    assert_eq!(parts.next(), Some(Value::Int(36)));
    assert_eq!(parts.next(), Some(Value::Int(1)));
    let link = parts.next().unwrap().strings().unwrap();
    assert_eq!(link.iter().next(), lanes.first().map(String::as_str));

    // The same compound, where only its own counts tell where it ends.
    let both = [traffic_light::CONTROLLED_LINKS, traffic_light::COMPLETE_DEFINITION];
    let subscription = client.subscribe(Domain::TrafficLight, "A0", &both).unwrap();
    let read: Vec<u8> = subscription.objects().flat_map(|object| object.values()).map(|(id, _)| id).collect();
    assert_eq!(read, both);

    let any = client.ids(Domain::Vehicle).unwrap().swap_remove(0);
    let leader = client.get_with(Domain::Vehicle, vehicle::LEADER, &any, &[Argument::Double(100.0)]).unwrap();
    assert_eq!(leader.compound().unwrap().iter().count(), 2);
    client.set(Domain::Simulation, simulation::SCALE, "", Argument::Double(0.5)).unwrap();
    assert_eq!(client.get_double(Domain::Simulation, simulation::SCALE, "").unwrap(), 0.5);
}

#[test]
fn another_simulation_can_be_loaded_and_one_that_cannot_is_reported() {
    let mut sumo = start();
    subscribe_all(&mut sumo);
    let arguments =
        grid().arguments().iter().map(|arg| arg.to_string_lossy().into_owned()).collect::<Vec<_>>();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let client = sumo.client();
    let first = vehicles(client.simulation_step(120.0).unwrap());
    client.load(&arguments).unwrap();
    assert_eq!(client.time().unwrap(), 0.0);
    assert!(client.simulation_step(1.0).unwrap().is_empty(), "subscriptions end with their simulation");
    subscribe_all(&mut sumo);
    assert_eq!(vehicles(sumo.client().simulation_step(120.0).unwrap()), first);

    let error = sumo.client().load(&["-n", "/nowhere/gone.net.xml"]).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert!(error.to_string().contains("File '/nowhere/gone.net.xml' is not accessible"), "{error}");
}

#[test]
fn the_order_among_clients_can_be_set() {
    let mut sumo = start();
    sumo.client().set_order(3).unwrap();
    assert_eq!(sumo.client().set_order(1 << 30 | 1).unwrap_err().kind(), ErrorKind::Refused);
    assert_eq!(sumo.client().time().unwrap(), 0.0);
}

#[test]
fn closing_lets_sumo_write_its_outputs_and_twice_is_no_error() {
    let directory = tempfile::tempdir().unwrap();
    let trips = directory.path().join("tripinfo.xml");
    let command =
        grid().option("--tripinfo-output", &trips).option("--tripinfo-output.write-unfinished", "true");
    let mut sumo = Sumo::start(&home(), &command, common::PATIENCE).unwrap();
    sumo.client().simulation_step(150.0).unwrap();
    sumo.client().close().unwrap();
    sumo.client().close().unwrap();
    let error = sumo.client().time().unwrap_err();
    assert!(matches!(error, TraciError::Unusable { .. }), "{error}");
    let pid = sumo.pid();
    let report = sumo.close().unwrap();
    assert!(report.status.success());
    assert!(!common::runs(pid));
    let written = std::fs::read_to_string(trips).unwrap();
    assert!(written.contains("<tripinfo ") && written.trim_end().ends_with("</tripinfos>"));
}
