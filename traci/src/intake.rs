//! Bytes as they come from a socket, until they are messages.

use crate::codec::{DecodeError, Frame, MAX_MESSAGE, frame};
use std::ops::Range;

/// The buffer grows by at most this much ahead of bytes that really came, whatever length a message declares.
const GROWTH: usize = 1 << 20;
/// The least room for what comes next: most answers fit.
const LEAST: usize = 1 << 14;

/// A buffer for messages that come one after another, of which one is looked at. Kept between messages, so that steady
/// traffic does not allocate.
#[derive(Debug, Default)]
pub struct Intake {
    buffer: Vec<u8>,
    /// The message that is looked at, its length included; everything before it is done with.
    current: Range<usize>,
    /// Only so many bytes of the buffer mean anything.
    filled: usize,
}

impl Intake {
    /// Forgets the message that is looked at, and looks at the next one if all of it is there.
    ///
    /// # Errors
    /// [`DecodeError::Length`] for a declared length that cannot be.
    pub fn advance(&mut self) -> Result<bool, DecodeError> {
        self.forget();
        match frame(&self.buffer[self.current.start..self.filled], MAX_MESSAGE)? {
            Frame::Complete { length } => {
                self.current.end += length;
                Ok(true)
            }
            Frame::NeedMore(_) => Ok(false),
        }
    }

    /// Forgets the message that is looked at.
    pub fn forget(&mut self) {
        self.current.start = self.current.end;
        if self.current.start == self.filled {
            self.current = 0..0;
            self.filled = 0;
        }
    }

    /// Where the next bytes go: never empty.
    ///
    /// # Errors
    /// [`DecodeError::Length`] for a declared length that cannot be.
    pub fn space(&mut self) -> Result<&mut [u8], DecodeError> {
        let missing = match frame(&self.buffer[self.current.end..self.filled], MAX_MESSAGE)? {
            Frame::NeedMore(missing) => missing.clamp(LEAST, GROWTH),
            Frame::Complete { .. } => LEAST,
        };
        if self.buffer.len() < self.filled + missing {
            // What is done with makes room first.
            let start = self.current.start;
            self.buffer.copy_within(start..self.filled, 0);
            self.current = 0..self.current.end - start;
            self.filled -= start;
            let wanted = self.filled + missing;
            if self.buffer.len() < wanted {
                self.buffer.resize(wanted.next_power_of_two(), 0);
            }
        }
        Ok(&mut self.buffer[self.filled..])
    }

    /// So many bytes were put where [`space`](Self::space) said.
    pub fn took(&mut self, count: usize) {
        self.filled = (self.filled + count).min(self.buffer.len());
    }

    /// The message that is looked at, without its length.
    pub fn body(&self) -> &[u8] {
        self.buffer.get(self.current.start + 4..self.current.end).unwrap_or_default()
    }

    /// Bytes that came behind the message that is looked at.
    pub fn behind(&self) -> usize {
        self.filled - self.current.end
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(length: usize) -> Vec<u8> {
        [&(length as i32).to_be_bytes()[..], &vec![7; length - 4]].concat()
    }

    /// Feeds `bytes` in pieces of at most `most`; gives the lengths of the messages' bodies as they come.
    fn feed(intake: &mut Intake, mut bytes: &[u8], most: usize) -> Result<Vec<usize>, DecodeError> {
        let mut bodies = Vec::new();
        loop {
            while intake.advance()? {
                assert!(intake.body().iter().all(|&byte| byte == 7));
                bodies.push(intake.body().len());
            }
            let space = intake.space()?;
            let count = space.len().min(most).min(bytes.len());
            if count == 0 {
                return Ok(bodies);
            }
            space[..count].copy_from_slice(&bytes[..count]);
            bytes = &bytes[count..];
            intake.took(count);
        }
    }

    #[test]
    fn messages_are_complete_however_they_are_cut() {
        let stream = [message(1000), message(4), message(40_000), message(7)].concat();
        for most in [1, 3, 4, 5, 999, 1000, 1001, 50_000] {
            let mut intake = Intake::default();
            assert_eq!(feed(&mut intake, &stream, most), Ok(vec![996, 0, 39_996, 3]));
            assert_eq!(intake.behind(), 0);
        }
        let mut intake = Intake::default();
        assert_eq!(feed(&mut intake, &stream[..999], 100), Ok(vec![]));
        assert_eq!(intake.behind(), 999);
    }

    #[test]
    fn the_message_that_is_looked_at_stays_while_others_come() {
        let mut intake = Intake::default();
        let first = message(20);
        intake.space().unwrap()[..20].copy_from_slice(&first);
        intake.took(20);
        assert!(intake.advance().unwrap());
        for _ in 0..10 {
            let more = message(LEAST);
            intake.space().unwrap()[..LEAST].copy_from_slice(&more);
            intake.took(LEAST);
        }
        assert_eq!((intake.body(), intake.behind()), (&first[4..], 10 * LEAST));
    }

    #[test]
    fn a_buffer_in_steady_use_does_not_grow() {
        let mut intake = Intake::default();
        for _ in 0..100 {
            feed(&mut intake, &[message(9000), message(9000)].concat(), 7000).unwrap();
        }
        assert!(intake.buffer.len() <= 4 * LEAST, "{}", intake.buffer.len());
    }

    #[test]
    fn memory_follows_what_came_and_not_what_was_declared() {
        let mut intake = Intake::default();
        assert_eq!(feed(&mut intake, &(200i32 << 20).to_be_bytes(), 4), Ok(vec![]));
        assert!(intake.buffer.len() <= 2 * GROWTH, "{}", intake.buffer.len());
    }

    #[test]
    fn a_length_that_cannot_be_is_refused() {
        let refused = feed(&mut Intake::default(), &[0, 0, 0, 3], 4);
        assert_eq!(refused, Err(DecodeError::Length { declared: 3, limit: MAX_MESSAGE }));
    }
}
