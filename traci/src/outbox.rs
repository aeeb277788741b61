//! Messages on their way out: the one being written, those still to be sent, those whose answers have not come.
//!
//! They lie one behind the other in a single buffer, so that several go out in one system call, and stay there until
//! they are answered, since errors tell of a command from its own bytes.

use crate::codec::{DecodeError, MAX_MESSAGE, Writer};
use crate::constants::command;
use std::collections::VecDeque;
use std::ops::Range;

/// A message of one or more commands, as places in the buffer and in the list of commands.
#[derive(Debug, Clone, Default)]
struct Message {
    bytes: Range<usize>,
    commands: Range<usize>,
}

/// The messages. Buffers are kept, so that steady traffic does not allocate.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    /// Whole messages, each with its length in front.
    bytes: Vec<u8>,
    /// Where commands start.
    starts: Vec<usize>,
    /// Complete and not answered, oldest first.
    waiting: VecDeque<Message>,
    /// The last one that was answered.
    answered: Message,
    /// The one being written; it ends where the buffer ends.
    open: Message,
    /// So many bytes were sent.
    sent: usize,
}

impl Outbox {
    /// Begins a message; one that was begun and not [posted](Self::post) is forgotten.
    pub(crate) fn begin(&mut self) {
        // Where nothing waits, nothing that was written is needed any more.
        let (bytes, starts) = self.waiting.back().map_or((0, 0), |last| (last.bytes.end, last.commands.end));
        self.bytes.truncate(bytes);
        self.starts.truncate(starts);
        if bytes == 0 {
            self.sent = 0;
            self.answered = Message::default();
        }
        self.bytes.extend([0; 4]);
        self.open = Message { bytes: bytes..bytes, commands: starts..starts };
    }

    /// Adds a command to the message.
    pub(crate) fn push(&mut self, id: u8, body: impl FnOnce(&mut Writer<'_>)) {
        self.starts.push(self.bytes.len());
        Writer::new(&mut self.bytes).command(id, body);
    }

    /// Number of commands in the message being written.
    pub(crate) fn commands(&self) -> usize {
        self.starts.len() - self.open.commands.start
    }

    /// The commands being written, each with all that follows it.
    pub(crate) fn written(&self) -> Commands<'_> {
        Commands { bytes: &self.bytes, starts: &self.starts[self.open.commands.start..] }
    }

    /// Completes the message: it is to be sent.
    ///
    /// # Errors
    /// [`DecodeError::Length`] if it is too large; it is forgotten then.
    pub(crate) fn post(&mut self) -> Result<(), DecodeError> {
        let bytes = self.open.bytes.start..self.bytes.len();
        let declared = i32::try_from(bytes.len()).ok().filter(|_| bytes.len() <= MAX_MESSAGE);
        let (Some(declared), Some(header)) = (declared, self.bytes[bytes.start..].first_chunk_mut::<4>())
        else {
            let declared = i64::try_from(bytes.len()).unwrap_or(i64::MAX);
            return Err(DecodeError::Length { declared, limit: MAX_MESSAGE });
        };
        *header = declared.to_be_bytes();
        self.waiting.push_back(Message { bytes, commands: self.open.commands.start..self.starts.len() });
        Ok(())
    }

    /// What is still to be sent.
    pub(crate) fn unsent(&self) -> &[u8] {
        let end = self.waiting.back().map_or(self.sent, |last| last.bytes.end);
        &self.bytes[self.sent..end]
    }

    /// So many more bytes were sent.
    pub(crate) fn sent(&mut self, count: usize) {
        self.sent += count;
    }

    /// Messages whose answers have not come.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// The commands of the oldest message whose answer has not come; of none if none is missing.
    pub(crate) fn awaited(&self) -> Commands<'_> {
        self.waiting.front().map_or(Commands::default(), |message| self.commands_of(message))
    }

    /// The oldest message's answer is there.
    pub(crate) fn settle(&mut self) {
        self.answered = self.waiting.pop_front().unwrap_or_default();
    }

    /// The commands of the message that was answered last.
    pub(crate) fn answered(&self) -> Commands<'_> {
        self.commands_of(&self.answered)
    }

    fn commands_of(&self, message: &Message) -> Commands<'_> {
        Commands { bytes: &self.bytes[..message.bytes.end], starts: &self.starts[message.commands.clone()] }
    }
}

/// The commands of one message.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Commands<'a> {
    /// Everything to the end of the message.
    pub(crate) bytes: &'a [u8],
    /// Where in it the message's commands start.
    pub(crate) starts: &'a [usize],
}

impl Commands<'_> {
    /// Bytes of the message.
    pub(crate) fn len(&self) -> usize {
        // The length stands in front of the first command.
        self.starts.first().map_or(0, |first| self.bytes.len() + 4 - first)
    }

    /// Whether the message is a `simulationStep`: one command of ten bytes, its id behind its length.
    pub(crate) fn is_step(&self) -> bool {
        self.starts
            .first()
            .is_some_and(|&start| self.bytes.get(start..start + 2) == Some(&[10, command::SIMULATION_STEP]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(outbox: &mut Outbox) {
        outbox.begin();
        outbox.push(command::SIMULATION_STEP, |w| {
            w.f64(1.0);
        });
    }

    #[test]
    fn messages_lie_behind_one_another_until_they_are_answered() {
        let mut outbox = Outbox::default();
        step(&mut outbox);
        outbox.post().unwrap();
        outbox.begin();
        outbox.push(command::GET_VERSION, |_| {});
        outbox.push(command::CLOSE, |_| {});
        outbox.post().unwrap();
        assert_eq!(outbox.unsent().len(), 14 + 8);
        assert_eq!(outbox.unsent()[14..], [0, 0, 0, 8, 2, 0, 2, 0x7f]);
        outbox.sent(20);
        assert_eq!(outbox.unsent(), [2, 0x7f]);
        assert!(outbox.awaited().is_step());
        outbox.settle();
        assert_eq!((outbox.answered().len(), outbox.answered().starts.len()), (14, 1));
        assert_eq!((outbox.awaited().len(), outbox.awaited().starts.len()), (8, 2));
        assert!(!outbox.awaited().is_step());
        outbox.sent(2);
        outbox.settle();
        assert_eq!((outbox.waiting(), outbox.answered().len()), (0, 8));
        step(&mut outbox);
        assert_eq!((outbox.bytes.len(), outbox.sent, outbox.commands()), (14, 0, 1));
    }

    #[test]
    fn a_message_that_is_begun_and_left_is_never_sent() {
        let mut outbox = Outbox::default();
        step(&mut outbox);
        outbox.post().unwrap();
        step(&mut outbox);
        outbox.begin();
        assert_eq!((outbox.unsent().len(), outbox.commands(), outbox.waiting()), (14, 0, 1));
        outbox.push(command::CLOSE, |_| {});
        outbox.post().unwrap();
        assert_eq!(outbox.unsent().len(), 14 + 6);
    }
}
