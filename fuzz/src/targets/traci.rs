//! What SUMO sends.

use crate::Outcome;
use crate::mutate::traci::block;
use cross_traci::codec::{DecodeError, Reader, Writer};
use cross_traci::constants::{command, traffic_light, vehicle};
use cross_traci::value::{read_last_value, read_value};
use cross_traci::{Domain, Intake, Recorded, Reply, Subscription, Value};
use std::hint::black_box;
use std::sync::LazyLock;

/// Any bytes as a value.
pub(super) fn values(input: &[u8]) -> Outcome {
    let last = read_last_value(Reader::new(input));
    if let Ok(value) = &last {
        walk(value);
    }
    let mut reader = Reader::new(input);
    match read_value(&mut reader) {
        Ok(value) => {
            walk(&value);
            assert!(reader.rest().len() < input.len(), "a value takes at least its type");
        }
        Err(error) => sentence(&error),
    }
    Outcome::of(&last)
}

/// The first byte chooses commands; what follows answers them.
pub(super) fn replies(input: &[u8]) -> Outcome {
    let Some((&choice, body)) = input.split_first() else { return Outcome::Refused };
    let commands = &COMMANDS[usize::from(choice) % COMMANDS.len()];
    // Our own commands can be read.
    let mut recorded = Recorded::new(commands).unwrap_or_default();
    let read = match recorded.read(body) {
        Ok(replies) => {
            for (index, reply) in replies.iter().enumerate() {
                if let Reply::Value(value) = &reply {
                    walk(value);
                }
                let _ = black_box((
                    replies.double(index).is_ok(),
                    replies.int(index).is_ok(),
                    replies.str(index).is_ok(),
                ));
                if let Ok(subscription) = replies.subscription(index) {
                    walk_subscription(&subscription);
                }
            }
            Ok(())
        }
        Err(error) => {
            sentence(&error);
            Err(error)
        }
    };
    let results = recorded.subscriptions();
    assert_eq!(results.iter().count(), results.len());
    for subscription in results.iter() {
        walk_subscription(&subscription);
    }
    let _ = black_box(results.find(Domain::Vehicle, "v").is_some());
    let _ = black_box(results.find_context(Domain::Junction, "J0", Domain::Vehicle).is_some());
    Outcome::of(&read)
}

/// The first byte says in what pieces the rest comes from a socket; each message is then read as the answer to a step.
pub(super) fn stream(input: &[u8]) -> Outcome {
    let Some((&piece, mut rest)) = input.split_first() else { return Outcome::Refused };
    let mut intake = Intake::default();
    let mut recorded = Recorded::new(&COMMANDS[1]).unwrap_or_default();
    let mut outcome = Outcome::Refused;
    loop {
        match intake.advance() {
            Err(error) => {
                sentence(&error);
                return Outcome::Refused;
            }
            Ok(true) => {
                outcome = Outcome::of(&recorded.read(intake.body()).map(drop));
                for subscription in recorded.subscriptions().iter() {
                    walk_subscription(&subscription);
                }
                continue;
            }
            Ok(false) => {}
        }
        match intake.space() {
            Err(error) => {
                sentence(&error);
                return Outcome::Refused;
            }
            Ok(space) => {
                assert!(!space.is_empty(), "what is to come needs room");
                let count = space.len().min(usize::from(piece) + 1).min(rest.len());
                if count == 0 {
                    return outcome;
                }
                space[..count].copy_from_slice(&rest[..count]);
                rest = &rest[count..];
                intake.took(count);
            }
        }
    }
}

/// Reads all there is in a value.
fn walk(value: &Value<'_>) {
    let _ = black_box(format!("{value:?}"));
    let _ = black_box((value.int().is_ok(), value.position().is_ok(), value.double().is_ok()));
    if let Ok(parts) = value.compound() {
        parts.iter().for_each(|part| walk(&part));
    }
    if let Ok(texts) = value.strings() {
        assert_eq!(texts.iter().count(), texts.len(), "what was checked can be read");
    }
    if let Ok(numbers) = value.doubles() {
        assert_eq!(numbers.iter().count(), numbers.len(), "what was checked can be read");
    }
}

fn walk_subscription(subscription: &Subscription<'_>) {
    let _ = black_box((subscription.domain(), subscription.object_id(), subscription.context()));
    assert_eq!(subscription.objects().count(), subscription.len(), "what was checked can be read");
    for object in subscription.objects() {
        let _ = black_box(object.id());
        object.values().for_each(|(_, value)| walk(&value));
        let _ = black_box(object.get(vehicle::SPEED));
    }
}

fn sentence(error: &DecodeError) {
    assert!(!error.to_string().is_empty());
}

/// Messages as the environment sends them, and every other kind.
static COMMANDS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let message = |write: &dyn Fn(&mut Writer<'_>)| {
        let mut bytes = Vec::new();
        write(&mut Writer::new(&mut bytes));
        bytes
    };
    let get = |w: &mut Writer<'_>, domain: Domain, variable: u8, object: &str| {
        w.command(domain.get(), |w| {
            w.u8(variable).str(object);
        });
    };
    let around = |w: &mut Writer<'_>, variables: &[u8]| {
        w.command(Domain::Junction.subscribe_context(), |w| {
            w.f64(0.0)
                .f64(0.0)
                .str("J0")
                .u8(Domain::Vehicle.get())
                .f64(1e9)
                .u8(u8::try_from(variables.len()).unwrap_or(0));
            variables.iter().for_each(|variable| {
                w.u8(*variable);
            });
        });
    };
    vec![
        message(&|w| {
            w.command(command::GET_VERSION, |_| {});
        }),
        message(&|w| {
            w.command(command::SIMULATION_STEP, |w| {
                w.f64(10.0);
            });
        }),
        message(&|w| {
            get(w, Domain::Vehicle, vehicle::SPEED, "v");
            get(w, Domain::TrafficLight, traffic_light::RED_YELLOW_GREEN_STATE, "J0");
        }),
        message(&|w| {
            around(w, &[vehicle::LANE_ID, vehicle::SPEED]);
            around(w, &[]);
        }),
        message(&|w| {
            w.command(Domain::Vehicle.subscribe(), |w| {
                w.f64(0.0).f64(0.0).str("v").u8(1).u8(vehicle::SPEED);
            });
            w.command(Domain::TrafficLight.set(), |w| {
                w.u8(traffic_light::RED_YELLOW_GREEN_STATE).str("J0").u8(0x0c).str("GGrr");
            });
            w.command(command::CLOSE, |_| {});
        }),
    ]
});

/// Good answers to [`COMMANDS`], as inputs of [`replies`].
#[must_use]
pub(super) fn answers() -> Vec<Vec<u8>> {
    let ok = |id: u8| block(&[id, 0, 0, 0, 0, 0]);
    let text = |text: &str| [&u32::try_from(text.len()).unwrap_or(0).to_be_bytes(), text.as_bytes()].concat();
    let speed = [&[vehicle::SPEED, 0, 0x0b][..], &13.9f64.to_be_bytes()].concat();
    let lane = [&[vehicle::LANE_ID, 0, 0x0c][..], &text("gneE1_0")].concat();
    let one = block(&[&[0xe4][..], &text("v"), &[1], &speed].concat());
    let context = |id: u8| {
        let vehicle = |name: &str| [text(name), lane.clone(), speed.clone()].concat();
        block(&[&[id][..], &text("J0"), &[0xa4, 2, 0, 0, 0, 2], &vehicle("v"), &vehicle("w.17")].concat())
    };
    let failed =
        block(&[&[0xe4][..], &text("w"), &[1, vehicle::SPEED, 0xff, 0x0c], &text("not known")].concat());
    let around = Domain::Junction.subscribe_context();
    let version = block(&[&[0, 0, 0, 0, 22][..], &text("SUMO 1.28.0")].concat());
    let step = |results: &[Vec<u8>]| {
        [&[1][..], &ok(2), &u32::try_from(results.len()).unwrap_or(0).to_be_bytes(), &results.concat()]
            .concat()
    };
    let get = |domain: u8, variable: u8, object: &str, value: &[u8]| {
        [ok(domain), block(&[&[domain + 0x10, variable][..], &text(object), value].concat())].concat()
    };
    let number = [&[0x0b][..], &1.5f64.to_be_bytes()].concat();
    let state = [&[0x0c][..], &text("GGrr")].concat();
    vec![
        [&[0][..], &ok(0), &version].concat(),
        step(&[]),
        step(&[one.clone(), context(around + 0x10), failed]),
        [
            &[2][..],
            &get(0xa4, vehicle::SPEED, "v", &number),
            &get(0xa2, traffic_light::RED_YELLOW_GREEN_STATE, "J0", &state),
        ]
        .concat(),
        [&[3][..], &ok(around), &context(around + 0x10), &ok(around)].concat(),
        [&[4][..], &ok(0xd4), &one, &ok(0xc2), &ok(0x7f)].concat(),
        [
            &[4][..],
            &block(&[&[0xd4, 0xff][..], &text("Vehicle 'v' is not known")].concat()),
            &ok(0xc2),
            &ok(0x7f),
        ]
        .concat(),
    ]
}

/// The same as they come from a socket, as inputs of [`stream`].
#[must_use]
pub(super) fn messages() -> Vec<Vec<u8>> {
    let steps = answers().into_iter().filter(|answer| answer.first() == Some(&1));
    let framed = |answer: Vec<u8>| {
        let length = u32::try_from(answer.len() + 3).unwrap_or(0).to_be_bytes();
        [&[16][..], &length, &answer[1..]].concat()
    };
    steps.map(framed).collect()
}
