//! The answer to a message: a status for every command, and what belongs to it.

use crate::codec::{DecodeError, Reader};
use crate::constants::{Domain, RESPONSE, command, result, types, variable_name};
use crate::outbox::Commands;
use crate::subscription::{Subscription, SubscriptionResults};
use crate::value::read_last_value;
use std::ops::Range;

/// What answers a command, as a place in the receive buffer.
#[derive(Debug, Clone)]
pub(crate) enum Answer {
    /// SUMO refused; the range is its message.
    Refused(Range<usize>),
    /// Done, with nothing to say.
    Done,
    /// A value with its type id.
    Value(Range<usize>),
    /// The inside of a subscription's response.
    Subscribed(Range<usize>),
    /// The inside of a version's response, behind its id.
    Version(Range<usize>),
    /// Subscription results after a step.
    Step(usize, Range<usize>),
}

/// What a command calls for, told by its own bytes.
enum Expected<'a> {
    Nothing,
    Version,
    Step,
    Value { domain: Domain, variable: u8, object: &'a [u8] },
    Subscription { domain: Domain, context: bool },
}

fn expected(bytes: &[u8]) -> Result<(u8, Expected<'_>), DecodeError> {
    let mut block = Reader::new(bytes).block()?;
    let id = block.u8()?;
    let expected = match id {
        command::GET_VERSION => Expected::Version,
        command::SIMULATION_STEP => Expected::Step,
        _ => {
            if let Some(domain) = Domain::from_get(id) {
                Expected::Value { domain, variable: block.u8()?, object: block.string_bytes()? }
            } else if let Some((domain, context)) = subscribing(id) {
                block.take(16)?;
                block.string_bytes()?;
                if context {
                    block.take(9)?;
                }
                // Without variables it ends a subscription, which is answered by the status alone.
                if block.u8()? == 0 { Expected::Nothing } else { Expected::Subscription { domain, context } }
            } else {
                Expected::Nothing
            }
        }
    };
    Ok((id, expected))
}

fn subscribing(id: u8) -> Option<(Domain, bool)> {
    Domain::ALL.into_iter().find_map(|domain| {
        if domain.subscribe() == id {
            Some((domain, false))
        } else if domain.subscribe_context() == id {
            Some((domain, true))
        } else {
            None
        }
    })
}

fn mismatch(what: &'static str, expected: u8, found: u8) -> DecodeError {
    DecodeError::Mismatch { what, expected: format!("0x{expected:02x}"), found: format!("0x{found:02x}") }
}

/// Reads the answers to the commands that start at `starts` in `sent`, in their order, from `body`.
///
/// Everything is checked here, also inside values and subscriptions, so that whoever reads them later needs no errors.
pub(crate) fn read(
    sent: &[u8],
    starts: &[usize],
    body: &[u8],
    answers: &mut Vec<Answer>,
) -> Result<(), DecodeError> {
    answers.clear();
    let mut reader = Reader::new(body);
    let place = |reader: &Reader<'_>| body.len() - reader.rest().len();
    for &start in starts {
        let (id, expected) = expected(&sent[start.min(sent.len())..])?;
        let mut status = reader.block()?;
        let answered = status.u8()?;
        if answered != id {
            return Err(mismatch("the status of command", id, answered));
        }
        let outcome = status.u8()?;
        let message = status.string_bytes()?;
        status.end()?;
        if outcome != result::OK {
            let end = place(&reader);
            answers.push(Answer::Refused(end - message.len()..end));
            // SUMO sends the (useless) response of a subscription even when it refuses it.
            if let Expected::Subscription { .. } = expected {
                let mut ahead = reader.clone();
                if ahead.block().is_ok_and(|mut block| block.u8() == Ok(id.wrapping_add(RESPONSE))) {
                    reader = ahead;
                }
            }
            continue;
        }
        answers.push(match expected {
            Expected::Nothing => Answer::Done,
            Expected::Version => {
                let mut block = reader.block()?;
                let response = block.u8()?;
                if response != id {
                    return Err(mismatch("response", id, response));
                }
                let end = place(&reader);
                Answer::Version(end - block.rest().len()..end)
            }
            Expected::Step => {
                let count = reader.count(2)?;
                let start = place(&reader);
                SubscriptionResults::check(count, reader.rest())?;
                reader = Reader::new(&[]);
                Answer::Step(count, start..body.len())
            }
            Expected::Value { domain, variable, object } => {
                let mut block = reader.block()?;
                let response = block.u8()?;
                if response != domain.get() + RESPONSE {
                    return Err(mismatch("response", domain.get() + RESPONSE, response));
                }
                let answered = block.u8()?;
                if answered != variable {
                    return Err(mismatch("variable", variable, answered));
                }
                let about = block.string_bytes()?;
                if about != object {
                    return Err(DecodeError::Mismatch {
                        what: "object",
                        expected: format!("'{}'", String::from_utf8_lossy(object)),
                        found: format!("'{}'", String::from_utf8_lossy(about)),
                    });
                }
                read_last_value(block.clone())?;
                let end = place(&reader);
                Answer::Value(end - block.rest().len()..end)
            }
            Expected::Subscription { domain, context } => {
                let block = reader.block()?;
                let subscription = Subscription::read(block.clone())?;
                if subscription.domain() != domain || subscription.context().is_some() != context {
                    return Err(DecodeError::Mismatch {
                        what: "a subscription to",
                        expected: domain.noun().to_owned(),
                        found: subscription.domain().noun().to_owned(),
                    });
                }
                subscription.check()?;
                let end = place(&reader);
                Answer::Subscribed(end - block.rest().len()..end)
            }
        });
    }
    reader.end()
}

/// A command in words, told from the bytes that were sent: nothing is spent on it unless something fails.
pub(crate) fn describe(bytes: &[u8]) -> String {
    try_describe(bytes).unwrap_or_else(|_| "an unreadable command".to_owned())
}

fn try_describe(bytes: &[u8]) -> Result<String, DecodeError> {
    let mut block = Reader::new(bytes).block()?;
    let id = block.u8()?;
    Ok(match id {
        command::GET_VERSION => "the version request".to_owned(),
        command::LOAD => "loading another simulation".to_owned(),
        command::SIMULATION_STEP => match block.f64()? {
            0.0 => "one simulation step".to_owned(),
            to => format!("the simulation step to {to} s"),
        },
        command::SET_ORDER => "setting the client order".to_owned(),
        command::CLOSE => "closing".to_owned(),
        _ => {
            if let Some((domain, context)) = subscribing(id) {
                block.take(16)?;
                let object = block.str()?;
                let kind = if context { "context subscription around" } else { "subscription to" };
                return Ok(format!("the {kind} {} '{object}'", domain.noun()));
            }
            let (verb, domain) = if let Some(domain) = Domain::from_get(id) {
                ("reading", domain)
            } else if let Some(domain) = Domain::ALL.into_iter().find(|domain| domain.set() == id) {
                ("setting", domain)
            } else {
                return Ok(format!("command 0x{id:02x}"));
            };
            let variable = block.u8()?;
            let object = block.str()?;
            let name = match variable_name(domain, variable) {
                Some(name) => name.to_owned(),
                None => format!("variable 0x{variable:02x}"),
            };
            let mut text = format!("{verb} {name} of {}", domain.noun());
            if !object.is_empty() {
                text.push_str(&format!(" '{object}'"));
            }
            if block.u8() == Ok(types::STRING)
                && let Ok(value) = block.str()
            {
                text.push_str(&format!(" to '{}'", value.chars().take(60).collect::<String>()));
            }
            text
        }
    })
}

/// A whole message in words.
pub(crate) fn describe_message(message: Commands<'_>) -> String {
    let Commands { bytes: sent, starts } = message;
    let first = starts.first().map_or_else(String::new, |&start| describe(&sent[start.min(sent.len())..]));
    match starts.len() {
        0 => "nothing".to_owned(),
        1 => first,
        count => format!("{first} and {} more in one message", count - 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::argument::Argument;
    use crate::codec::Writer;
    use crate::constants::{traffic_light, vehicle};
    use proptest::prelude::*;

    /// A message of one command, as it would be sent, without the length in front.
    fn command(id: u8, body: impl FnOnce(&mut Writer<'_>)) -> Vec<u8> {
        let mut bytes = Vec::new();
        Writer::new(&mut bytes).command(id, body);
        bytes
    }

    fn status(bytes: &mut Vec<u8>, id: u8, outcome: u8, message: &str) {
        Writer::new(bytes).command(id, |w| {
            w.u8(outcome).str(message);
        });
    }

    #[test]
    fn commands_are_told_in_words() {
        let set = command(Domain::TrafficLight.set(), |w| {
            w.u8(traffic_light::RED_YELLOW_GREEN_STATE).str("J0");
            Argument::Str("GGrr").write(w);
        });
        assert_eq!(describe(&set), "setting RED_YELLOW_GREEN_STATE of traffic light 'J0' to 'GGrr'");
        let step = command(command::SIMULATION_STEP, |w| {
            w.f64(30.0);
        });
        assert_eq!(describe(&step), "the simulation step to 30 s");
        let starts = [0, set.len()];
        let both = [set, step].concat();
        let told = describe_message(Commands { bytes: &both, starts: &starts });
        assert_eq!(
            told,
            "setting RED_YELLOW_GREEN_STATE of traffic light 'J0' to 'GGrr' and 1 more in one message"
        );
        assert_eq!(describe(&[]), "an unreadable command");
        assert_eq!(describe(&[2, 0xf7]), "command 0xf7");
    }

    #[test]
    fn the_response_that_follows_a_refused_subscription_is_skipped() {
        let subscribe = command(Domain::Vehicle.subscribe(), |w| {
            w.f64(0.0).f64(0.0).str("v").u8(1).u8(vehicle::SPEED);
        });
        let version = command(command::GET_VERSION, |_| {});
        let starts = [0, subscribe.len()];
        let sent = [subscribe, version].concat();
        let mut body = Vec::new();
        status(&mut body, Domain::Vehicle.subscribe(), result::ERROR, "no such vehicle");
        Writer::new(&mut body).command(Domain::Vehicle.subscribe() + RESPONSE, |w| {
            w.str("v").u8(1).u8(vehicle::SPEED).u8(result::ERROR);
            Argument::Str("no such vehicle").write(w);
        });
        status(&mut body, command::GET_VERSION, result::OK, "");
        Writer::new(&mut body).command(command::GET_VERSION, |w| {
            w.i32(22).str("SUMO");
        });
        let mut answers = Vec::new();
        read(&sent, &starts, &body, &mut answers).unwrap();
        let Answer::Refused(message) = &answers[0] else { panic!("{answers:?}") };
        assert_eq!(&body[message.clone()], b"no such vehicle");
        assert!(matches!(answers[1], Answer::Version(_)), "{answers:?}");
    }

    #[test]
    fn an_answer_about_another_object_is_not_taken() {
        let sent = command(Domain::Vehicle.get(), |w| {
            w.u8(vehicle::SPEED).str("v");
        });
        let mut body = Vec::new();
        status(&mut body, Domain::Vehicle.get(), result::OK, "");
        Writer::new(&mut body).command(Domain::Vehicle.get() + RESPONSE, |w| {
            w.u8(vehicle::SPEED).str("w");
            Argument::Double(1.0).write(w);
        });
        let error = read(&sent, &[0], &body, &mut Vec::new()).unwrap_err();
        assert_eq!(error.to_string(), "expected object 'v', found 'w'");
    }

    proptest! {
        #[test]
        fn arbitrary_answers_never_panic(
            id in prop_oneof![Just(0u8), Just(2), Just(0xa4), Just(0xd4), Just(0x89), any::<u8>()],
            sent in proptest::collection::vec(any::<u8>(), 0..60), body in proptest::collection::vec(any::<u8>(), 0..200), proper in any::<bool>(),
        ) {
            let message = command(id, |w| { for byte in &sent { w.u8(*byte); } });
            let mut answer = Vec::new();
            if proper {
                status(&mut answer, id, result::OK, "");
            }
            answer.extend(&body);
            let mut answers = Vec::new();
            let _ = read(&message, &[0], &answer, &mut answers);
            let _ = read(&sent, &[0, 7, 1000], &body, &mut answers);
            let _ = describe(&message);
            let _ = describe(&sent);
        }
    }
}
