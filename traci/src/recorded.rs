//! Answers that come from somewhere else than a socket: recorded traffic, or a fuzzer.

use crate::batch::Replies;
use crate::codec::{DecodeError, Reader};
use crate::reply::{self, Answer};
use crate::subscription::SubscriptionResults;

/// The commands of one message, and the answer to them once it was [read](Self::read).
#[derive(Debug, Default)]
pub struct Recorded {
    sent: Vec<u8>,
    starts: Vec<usize>,
    body: Vec<u8>,
    answers: Vec<Answer>,
}

impl Recorded {
    /// Takes the commands of a message, without its length.
    ///
    /// # Errors
    /// [`DecodeError`] if they are no commands one after the other.
    pub fn new(commands: &[u8]) -> Result<Self, DecodeError> {
        let mut starts = Vec::new();
        let mut reader = Reader::new(commands);
        while !reader.is_empty() {
            starts.push(commands.len() - reader.rest().len());
            reader.block()?;
        }
        Ok(Self { sent: commands.to_vec(), starts, ..Self::default() })
    }

    /// Reads an answer, without its length, as a [`Client`](crate::Client) does, and gives the replies to the commands.
    /// Refused commands count as done.
    ///
    /// # Errors
    /// [`DecodeError`] if it does not answer the commands.
    pub fn read(&mut self, body: &[u8]) -> Result<Replies<'_>, DecodeError> {
        self.body.clear();
        self.body.extend_from_slice(body);
        reply::read(&self.sent, &self.starts, &self.body, &mut self.answers)?;
        Ok(Replies { answers: &self.answers, body: &self.body, sent: &self.sent, starts: &self.starts })
    }

    /// What a step brought, if the first command was one.
    pub fn subscriptions(&self) -> SubscriptionResults<'_> {
        match self.answers.first() {
            Some(Answer::Step(count, range)) => {
                SubscriptionResults::checked(*count, &self.body[range.clone()])
            }
            _ => SubscriptionResults::default(),
        }
    }

    /// The commands in words, one after the other.
    pub fn describe(&self) -> Vec<String> {
        self.starts.iter().map(|&start| reply::describe(&self.sent[start..])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::Writer;
    use crate::constants::{Domain, RESPONSE, result, types, vehicle};

    fn speed_of_v() -> Vec<u8> {
        let mut bytes = Vec::new();
        Writer::new(&mut bytes).command(Domain::Vehicle.get(), |w| {
            w.u8(vehicle::SPEED).str("v");
        });
        bytes
    }

    #[test]
    fn an_answer_is_read_as_from_a_socket() {
        let mut recorded = Recorded::new(&[speed_of_v(), speed_of_v()].concat()).unwrap();
        assert_eq!(recorded.describe().len(), 2);
        assert!(recorded.describe()[0].contains("vehicle 'v'"));
        let mut body = Vec::new();
        for speed in [1.5, 2.5] {
            let mut writer = Writer::new(&mut body);
            writer.command(Domain::Vehicle.get(), |w| {
                w.u8(result::OK).str("");
            });
            writer.command(Domain::Vehicle.get() + RESPONSE, |w| {
                w.u8(vehicle::SPEED).str("v").u8(types::DOUBLE).f64(speed);
            });
        }
        let replies = recorded.read(&body).unwrap();
        assert_eq!((replies.double(0).unwrap(), replies.double(1).unwrap()), (1.5, 2.5));
        assert!(recorded.read(&body[1..]).is_err());
        assert!(recorded.subscriptions().is_empty());
    }

    #[test]
    fn what_is_no_command_is_refused() {
        assert!(Recorded::new(&[9, 1]).is_err());
        assert!(Recorded::new(&[]).unwrap().describe().is_empty());
    }
}
