//! Several commands in one message, answered in one.

use crate::argument::Argument;
use crate::client::Client;
use crate::codec::{DecodeError, Reader, Writer};
use crate::constants::{Domain, INVALID_DOUBLE, traffic_light};
use crate::error::TraciError;
use crate::reply::{Answer, describe};
use crate::subscription::{Subscription, SubscriptionResults};
use crate::value::{Value, read_last_value};

/// Commands that go out together. Made by [`Client::batch`], ended by [`send`](Self::send) or [`post`](Self::post);
/// dropped, nothing is sent.
///
/// `simulationStep` cannot be among them: SUMO throws away the answers to what stands before it in the same message.
#[derive(Debug)]
#[must_use = "nothing is sent before `send` or `post`"]
pub struct Batch<'c> {
    client: &'c mut Client,
}

impl<'c> Batch<'c> {
    pub(crate) fn new(client: &'c mut Client) -> Self {
        client.begin();
        Self { client }
    }

    /// Number of commands so far; the next one's place in the [`Replies`].
    pub fn len(&self) -> usize {
        self.client.commands()
    }

    /// Whether there is no command yet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Sets the signal of every link of a traffic light, as `rRyYgGsuoO`.
    pub fn set_traffic_light_state(&mut self, id: &str, state: &str) -> &mut Self {
        self.set(Domain::TrafficLight, traffic_light::RED_YELLOW_GREEN_STATE, id, Argument::Str(state))
    }

    /// Sets a variable.
    pub fn set(&mut self, domain: Domain, variable: u8, object: &str, value: Argument<'_>) -> &mut Self {
        self.client.push(domain.set(), |w| {
            w.u8(variable).str(object);
            value.write(w);
        });
        self
    }

    /// Reads a variable.
    pub fn get(&mut self, domain: Domain, variable: u8, object: &str) -> &mut Self {
        self.get_with(domain, variable, object, &[])
    }

    /// Reads a variable that needs parameters.
    pub fn get_with(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
        parameters: &[Argument<'_>],
    ) -> &mut Self {
        self.client.push(domain.get(), |w| {
            w.u8(variable).str(object);
            for parameter in parameters {
                parameter.write(w);
            }
        });
        self
    }

    /// Subscribes to variables of one object: they come with every step from now on. No variables ends it.
    /// Only the first 255 variables count, which is all that SUMO can take.
    pub fn subscribe(&mut self, domain: Domain, object: &str, variables: &[u8]) -> &mut Self {
        self.client.push(domain.subscribe(), |w| {
            w.f64(INVALID_DOUBLE).f64(INVALID_DOUBLE).str(object);
            write_variables(w, variables);
        });
        self
    }

    /// Subscribes to variables of all objects of the domain `of` within `range` metres of one object. No variables
    /// ends it.
    pub fn subscribe_context(
        &mut self,
        domain: Domain,
        object: &str,
        range: f64,
        of: Domain,
        variables: &[u8],
    ) -> &mut Self {
        self.client.push(domain.subscribe_context(), |w| {
            w.f64(INVALID_DOUBLE).f64(INVALID_DOUBLE).str(object).u8(of.get()).f64(range);
            write_variables(w, variables);
        });
        self
    }

    /// Sends all of them in one message and waits for the answers. An empty batch sends nothing.
    ///
    /// # Errors
    /// [`TraciError::Refused`] names the first refused command; all others were carried out. Other errors end the
    /// connection.
    pub fn send(self) -> Result<Replies<'c>, TraciError> {
        if !self.is_empty() {
            self.client.run()?;
        }
        Ok(self.client.replies())
    }

    /// Sends all of them in one message, but waits for nothing: SUMO comes to them after all that was posted before. The
    /// answers are [taken](Client::take), or checked and forgotten by the next call that waits. An empty batch posts
    /// nothing.
    ///
    /// # Errors
    /// [`TraciError::Unusable`] after an earlier failure.
    pub fn post(self) -> Result<(), TraciError> {
        if self.is_empty() { Ok(()) } else { self.client.post() }
    }
}

fn write_variables(writer: &mut Writer<'_>, variables: &[u8]) {
    let count = u8::try_from(variables.len()).unwrap_or(u8::MAX);
    writer.u8(count);
    for variable in &variables[..count.into()] {
        writer.u8(*variable);
    }
}

/// The answers to a [`Batch`], in its order, borrowed from the receive buffer.
#[derive(Debug, Clone, Copy)]
pub struct Replies<'a> {
    pub(crate) answers: &'a [Answer],
    pub(crate) body: &'a [u8],
    pub(crate) sent: &'a [u8],
    pub(crate) starts: &'a [usize],
}

/// The answer to one command.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Reply<'a> {
    /// Carried out.
    Done,
    /// The value read.
    Value(Value<'a>),
    /// Subscribed; [`Replies::subscription`] has the values as of now.
    Subscribed,
}

impl<'a> Replies<'a> {
    /// Number of commands.
    pub fn len(&self) -> usize {
        self.answers.len()
    }

    /// Whether there was no command.
    pub fn is_empty(&self) -> bool {
        self.answers.is_empty()
    }

    /// What a step brought, if the message was a [`simulationStep`](Client::post_step).
    pub fn step(&self) -> Option<SubscriptionResults<'a>> {
        match self.answers.first() {
            Some(Answer::Step(count, range)) => {
                Some(SubscriptionResults::checked(*count, &self.body[range.clone()]))
            }
            _ => None,
        }
    }

    /// The answers in order.
    pub fn iter(&self) -> impl Iterator<Item = Reply<'a>> + use<'a> {
        let body = self.body;
        self.answers.iter().map(move |answer| match answer {
            // Checked on arrival, so that the second arm of the inner match is never taken.
            Answer::Value(range) => match read_last_value(Reader::new(&body[range.clone()])) {
                Ok(value) => Reply::Value(value),
                Err(_) => Reply::Done,
            },
            Answer::Subscribed(_) => Reply::Subscribed,
            _ => Reply::Done,
        })
    }

    /// The value that command number `index` read.
    ///
    /// # Errors
    /// [`TraciError::Protocol`] if that command did not read one.
    pub fn value(&self, index: usize) -> Result<Value<'a>, TraciError> {
        match self.answers.get(index) {
            Some(Answer::Value(range)) => read_last_value(Reader::new(&self.body[range.clone()]))
                .map_err(|source| self.error(index, source)),
            _ => Err(self.error(index, DecodeError::Type { expected: "a value", found: "none" })),
        }
    }

    /// The values as of now of the subscription that command number `index` made.
    ///
    /// # Errors
    /// [`TraciError::Protocol`] if that command did not subscribe.
    pub fn subscription(&self, index: usize) -> Result<Subscription<'a>, TraciError> {
        match self.answers.get(index) {
            Some(Answer::Subscribed(range)) => Subscription::read(Reader::new(&self.body[range.clone()]))
                .map_err(|source| self.error(index, source)),
            _ => Err(self.error(index, DecodeError::Type { expected: "a subscription", found: "none" })),
        }
    }

    /// The real number that command number `index` read.
    ///
    /// # Errors
    /// [`TraciError::Protocol`] if it read something else; so for the two below.
    pub fn double(&self, index: usize) -> Result<f64, TraciError> {
        self.value(index)?.double().map_err(|source| self.error(index, source))
    }

    /// The integer that command number `index` read.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn int(&self, index: usize) -> Result<i32, TraciError> {
        self.value(index)?.int().map_err(|source| self.error(index, source))
    }

    /// The text that command number `index` read.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn str(&self, index: usize) -> Result<&'a str, TraciError> {
        self.value(index)?.str().map_err(|source| self.error(index, source))
    }

    pub(crate) fn error(&self, index: usize, source: DecodeError) -> TraciError {
        let command = self.starts.get(index).map_or_else(
            || format!("command {index} of {}", self.len()),
            |&start| describe(&self.sent[start..]),
        );
        TraciError::Protocol { command, source, evidence: Box::default() }
    }
}
