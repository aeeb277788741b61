//! Bytes as they come from a socket, until they are one message.

use crate::codec::{DecodeError, Frame, MAX_MESSAGE, frame};

/// The buffer grows by at most this much ahead of bytes that really came, whatever length the message declares.
const GROWTH: usize = 1 << 20;
/// The least buffer: most answers fit.
const LEAST: usize = 1 << 14;

/// A buffer that one message is received into. Kept between messages, so that steady traffic does not allocate.
#[derive(Debug, Default)]
pub struct Intake {
    buffer: Vec<u8>,
    /// Only so many bytes of the buffer mean anything.
    filled: usize,
}

impl Intake {
    /// Forgets the last message.
    pub fn clear(&mut self) {
        self.filled = 0;
    }

    /// Where the next bytes go; `None` once the message is complete.
    ///
    /// # Errors
    /// [`DecodeError::Length`] for a declared length that cannot be, [`DecodeError::Trailing`] for bytes behind the
    /// message: commands and answers alternate, so nothing may follow an answer.
    pub fn wanted(&mut self) -> Result<Option<&mut [u8]>, DecodeError> {
        let missing = match frame(&self.buffer[..self.filled], MAX_MESSAGE)? {
            Frame::Complete { length } if length == self.filled => return Ok(None),
            Frame::Complete { length } => return Err(DecodeError::Trailing(self.filled - length)),
            Frame::NeedMore(missing) => missing,
        };
        let wanted = self.filled + missing.min(GROWTH);
        if self.buffer.len() < wanted {
            self.buffer.resize(wanted.next_power_of_two().max(LEAST), 0);
        }
        Ok(Some(&mut self.buffer[self.filled..]))
    }

    /// So many bytes were put where [`wanted`](Self::wanted) said.
    pub fn took(&mut self, count: usize) {
        self.filled = (self.filled + count).min(self.buffer.len());
    }

    /// The message without its length, as far as it is there.
    pub fn body(&self) -> &[u8] {
        self.buffer.get(4..self.filled).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Feeds `bytes` in pieces of at most `most`; gives the buffer's size and whether a message came.
    fn feed(mut bytes: &[u8], most: usize) -> Result<(usize, bool), DecodeError> {
        let mut intake = Intake::default();
        while let Some(space) = intake.wanted()? {
            let count = space.len().min(most).min(bytes.len());
            if count == 0 {
                return Ok((intake.buffer.len(), false));
            }
            space[..count].copy_from_slice(&bytes[..count]);
            bytes = &bytes[count..];
            intake.took(count);
        }
        Ok((intake.buffer.len(), true))
    }

    #[test]
    fn a_message_is_complete_however_it_is_cut() {
        let message = [&1000i32.to_be_bytes()[..], &[7; 996]].concat();
        for most in [1, 3, 4, 5, 999, 1000] {
            assert_eq!(feed(&message, most), Ok((LEAST, true)));
        }
        assert_eq!(feed(&message[..999], 100), Ok((LEAST, false)));
    }

    #[test]
    fn memory_follows_what_came_and_not_what_was_declared() {
        let (size, complete) = feed(&(200i32 << 20).to_be_bytes(), 4).unwrap();
        assert!(!complete && size <= 2 * GROWTH, "{size}");
    }

    #[test]
    fn nothing_may_follow_a_message() {
        assert_eq!(feed(&[0, 0, 0, 5, 1, 2, 3], 100), Err(DecodeError::Trailing(2)));
    }
}
