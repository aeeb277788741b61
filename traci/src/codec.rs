//! TraCI's bytes: big-endian numbers, length-prefixed strings, length-prefixed messages.
//!
//! Everything here works on slices that may hold anything at all: a wrong length, a cut-off number or a string that is
//! not text is an error value, never a panic, and a declared length never makes anything allocate.

use thiserror::Error;

/// Largest message that is accepted, in bytes. A step of a city with 100,000 subscribed vehicles stays far below.
pub const MAX_MESSAGE: usize = 256 << 20;

/// Nested compounds deeper than this are refused, so that a hostile message cannot exhaust the stack.
pub const MAX_DEPTH: usize = 8;

/// Why bytes are no TraCI.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// The bytes end inside a value.
    #[error("the bytes end early: {needed} more needed, {left} left")]
    Truncated {
        /// Bytes that the value still needs.
        needed: usize,
        /// Bytes that are there.
        left: usize,
    },
    /// A length or count that cannot be true.
    #[error("impossible length {declared} (limit {limit})")]
    Length {
        /// What the bytes say.
        declared: i64,
        /// The largest possible value at that place.
        limit: usize,
    },
    /// A value of another type than the caller asked for.
    #[error("expected {expected}, found {found}")]
    Type {
        /// Type asked for.
        expected: &'static str,
        /// Type found.
        found: &'static str,
    },
    /// A type id that TraCI does not define.
    #[error("unknown type id 0x{0:02x}")]
    UnknownType(u8),
    /// A string that is not UTF-8.
    #[error("a string is not UTF-8")]
    Utf8,
    /// Compounds inside compounds, too many of them.
    #[error("compounds nested deeper than {MAX_DEPTH}")]
    Depth,
    /// Bytes left over where a message or block should have ended.
    #[error("{0} bytes left over")]
    Trailing(usize),
    /// Another answer than the one that belongs to the command.
    #[error("expected {what} {expected}, found {found}")]
    Mismatch {
        /// What differs, such as `response`.
        what: &'static str,
        /// What the command calls for.
        expected: String,
        /// What came.
        found: String,
    },
    /// SUMO sent an error text in the place of a value.
    #[error("SUMO has no value here: {0}")]
    Failed(String),
}

/// Where a stream of bytes stands with regard to its first message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// The message is not complete; at least this many bytes are missing.
    NeedMore(usize),
    /// The first `length` bytes, the four of the length included, are one message.
    Complete {
        /// Bytes of the whole message.
        length: usize,
    },
}

/// Finds the first message in `bytes`.
///
/// # Errors
/// [`DecodeError::Length`] if the declared length is below four or above `limit`.
pub fn frame(bytes: &[u8], limit: usize) -> Result<Frame, DecodeError> {
    let Some(header) = bytes.first_chunk::<4>() else {
        return Ok(Frame::NeedMore(4 - bytes.len()));
    };
    let declared = i32::from_be_bytes(*header);
    let length = usize::try_from(declared)
        .ok()
        .filter(|&length| (4..=limit).contains(&length))
        .ok_or(DecodeError::Length { declared: declared.into(), limit })?;
    Ok(match length.checked_sub(bytes.len()) {
        None | Some(0) => Frame::Complete { length },
        Some(missing) => Frame::NeedMore(missing),
    })
}

/// A cursor over received bytes. Strings are borrowed from them.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Reads from the front of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// Bytes not read yet.
    pub fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    /// Whether all bytes are read.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Takes the next `count` bytes.
    ///
    /// # Errors
    /// [`DecodeError::Truncated`].
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        let Some((head, tail)) = self.bytes.split_at_checked(count) else {
            return Err(DecodeError::Truncated { needed: count - self.bytes.len(), left: self.bytes.len() });
        };
        self.bytes = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let Some((head, tail)) = self.bytes.split_first_chunk::<N>() else {
            return Err(DecodeError::Truncated { needed: N - self.bytes.len(), left: self.bytes.len() });
        };
        self.bytes = tail;
        Ok(*head)
    }

    /// An unsigned byte.
    ///
    /// # Errors
    /// [`DecodeError::Truncated`], like every method here that reads a number.
    pub fn u8(&mut self) -> Result<u8, DecodeError> {
        self.array().map(u8::from_be_bytes)
    }

    /// A signed byte.
    ///
    /// # Errors
    /// [`DecodeError::Truncated`].
    pub fn i8(&mut self) -> Result<i8, DecodeError> {
        self.array().map(i8::from_be_bytes)
    }

    /// A 32-bit integer.
    ///
    /// # Errors
    /// [`DecodeError::Truncated`].
    pub fn i32(&mut self) -> Result<i32, DecodeError> {
        self.array().map(i32::from_be_bytes)
    }

    /// A double.
    ///
    /// # Errors
    /// [`DecodeError::Truncated`].
    pub fn f64(&mut self) -> Result<f64, DecodeError> {
        self.array().map(f64::from_be_bytes)
    }

    /// A count of things that take at least `least` bytes each, so that a lying count is found before it is believed.
    ///
    /// # Errors
    /// [`DecodeError::Length`] for a negative count or one that the remaining bytes cannot hold.
    pub fn count(&mut self, least: usize) -> Result<usize, DecodeError> {
        let declared = self.i32()?;
        let limit = self.bytes.len() / least.max(1);
        usize::try_from(declared)
            .ok()
            .filter(|&count| count <= limit)
            .ok_or(DecodeError::Length { declared: declared.into(), limit })
    }

    /// The bytes of a length-prefixed string.
    ///
    /// # Errors
    /// [`DecodeError::Length`] or [`DecodeError::Truncated`].
    pub fn string_bytes(&mut self) -> Result<&'a [u8], DecodeError> {
        let length = self.count(1)?;
        self.take(length)
    }

    /// A length-prefixed string.
    ///
    /// # Errors
    /// As [`string_bytes`](Self::string_bytes), and [`DecodeError::Utf8`].
    pub fn str(&mut self) -> Result<&'a str, DecodeError> {
        std::str::from_utf8(self.string_bytes()?).map_err(|_| DecodeError::Utf8)
    }

    /// A command or response: a length (one byte, or zero and four bytes), then a body. The length counts itself.
    ///
    /// # Errors
    /// [`DecodeError::Length`] or [`DecodeError::Truncated`].
    pub fn block(&mut self) -> Result<Reader<'a>, DecodeError> {
        let short = self.u8()?;
        let (declared, header) = if short == 0 { (i64::from(self.i32()?), 5) } else { (i64::from(short), 1) };
        let limit = self.bytes.len() + header;
        let body = usize::try_from(declared)
            .ok()
            .and_then(|length| length.checked_sub(header))
            .filter(|&body| body <= self.bytes.len())
            .ok_or(DecodeError::Length { declared, limit })?;
        self.take(body).map(Reader::new)
    }

    /// Checks that nothing is left.
    ///
    /// # Errors
    /// [`DecodeError::Trailing`].
    pub fn end(&self) -> Result<(), DecodeError> {
        if self.bytes.is_empty() { Ok(()) } else { Err(DecodeError::Trailing(self.bytes.len())) }
    }
}

/// Appends TraCI's bytes to a buffer that the caller keeps.
#[derive(Debug)]
pub struct Writer<'a> {
    bytes: &'a mut Vec<u8>,
}

impl<'a> Writer<'a> {
    /// Appends to `bytes`.
    pub fn new(bytes: &'a mut Vec<u8>) -> Self {
        Self { bytes }
    }

    /// An unsigned byte.
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.bytes.push(value);
        self
    }

    /// A signed byte.
    pub fn i8(&mut self, value: i8) -> &mut Self {
        self.bytes.extend(value.to_be_bytes());
        self
    }

    /// A 32-bit integer.
    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.bytes.extend(value.to_be_bytes());
        self
    }

    /// A double.
    pub fn f64(&mut self, value: f64) -> &mut Self {
        self.bytes.extend(value.to_be_bytes());
        self
    }

    /// A count or length. Above `i32::MAX` it saturates; such a message is refused before it is sent, being larger
    /// than [`MAX_MESSAGE`].
    pub fn count(&mut self, value: usize) -> &mut Self {
        self.i32(i32::try_from(value).unwrap_or(i32::MAX))
    }

    /// A length-prefixed string.
    pub fn str(&mut self, value: &str) -> &mut Self {
        self.count(value.len());
        self.bytes.extend_from_slice(value.as_bytes());
        self
    }

    /// A command: `body` writes what follows the command id; the length before it is filled in afterwards.
    pub fn command(&mut self, id: u8, body: impl FnOnce(&mut Writer<'_>)) -> &mut Self {
        let start = self.bytes.len();
        self.bytes.extend([0, id]);
        body(&mut Writer { bytes: self.bytes });
        let length = self.bytes.len() - start;
        if let Ok(short) = u8::try_from(length) {
            self.bytes[start] = short;
        } else {
            // The one byte stays zero, which announces four bytes of length behind it.
            let length = i32::try_from(length + 4).unwrap_or(i32::MAX);
            self.bytes.splice(start + 1..start + 1, length.to_be_bytes());
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn an_incomplete_message_says_how_much_is_missing() {
        assert_eq!(frame(&[], 100), Ok(Frame::NeedMore(4)));
        assert_eq!(frame(&[0, 0, 0], 100), Ok(Frame::NeedMore(1)));
        assert_eq!(frame(&[0, 0, 0, 6, 1], 100), Ok(Frame::NeedMore(1)));
        assert_eq!(frame(&[0, 0, 0, 6, 1, 2, 3], 100), Ok(Frame::Complete { length: 6 }));
    }

    #[test]
    fn impossible_message_lengths_are_refused_before_any_memory_is_taken() {
        for bytes in [[0, 0, 0, 3], [0xff, 0xff, 0xff, 0xff], [0x7f, 0xff, 0xff, 0xff]] {
            assert!(matches!(frame(&bytes, MAX_MESSAGE), Err(DecodeError::Length { .. })), "{bytes:?}");
        }
    }

    #[test]
    fn a_string_longer_than_the_message_is_refused() {
        let mut reader = Reader::new(&[0x7f, 0xff, 0xff, 0xff, b'a']);
        assert_eq!(reader.str(), Err(DecodeError::Length { declared: i64::from(i32::MAX), limit: 1 }));
        assert_eq!(Reader::new(&[0, 0, 0, 1, 0xff]).str(), Err(DecodeError::Utf8));
    }

    #[test]
    fn a_block_cannot_reach_beyond_its_message_nor_be_shorter_than_its_own_length() {
        assert!(matches!(Reader::new(&[9, 1]).block(), Err(DecodeError::Length { .. })));
        assert!(matches!(Reader::new(&[0, 0, 0, 0, 4]).block(), Err(DecodeError::Length { .. })));
        assert!(matches!(Reader::new(&[0, 0x80, 0, 0, 0]).block(), Err(DecodeError::Length { .. })));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = frame(&bytes, MAX_MESSAGE);
            let mut reader = Reader::new(&bytes);
            while let Ok(block) = reader.block() {
                let mut inner = block.clone();
                let _ = inner.str();
                let _ = block.clone().count(3);
                if block.is_empty() && reader.is_empty() { break; }
            }
            let _ = Reader::new(&bytes).f64();
        }

        #[test]
        fn commands_of_every_length_round_trip(
            id in any::<u8>(), text in ".{0,300}", number in any::<i32>(), real in any::<f64>(), byte in any::<i8>(),
        ) {
            let mut bytes = Vec::new();
            Writer::new(&mut bytes)
                .command(id, |w| { w.str(&text).i32(number); })
                .command(1, |w| { w.f64(real).i8(byte); });
            let mut reader = Reader::new(&bytes);
            let mut first = reader.block().unwrap();
            prop_assert_eq!(first.u8().unwrap(), id);
            prop_assert_eq!(first.str().unwrap(), &text);
            prop_assert_eq!(first.i32().unwrap(), number);
            prop_assert!(first.end().is_ok());
            let mut second = reader.block().unwrap();
            prop_assert_eq!(second.u8().unwrap(), 1);
            prop_assert_eq!(second.f64().unwrap().to_bits(), real.to_bits());
            prop_assert_eq!(second.i8().unwrap(), byte);
            prop_assert!(reader.end().is_ok());
        }

        #[test]
        fn a_message_cut_anywhere_needs_more(body in proptest::collection::vec(any::<u8>(), 0..100), cut in 0usize..104) {
            let mut bytes = (body.len() as i32 + 4).to_be_bytes().to_vec();
            bytes.extend(&body);
            let whole = bytes.len();
            let expected = if cut >= whole { Frame::Complete { length: whole } }
                else if cut < 4 { Frame::NeedMore(4 - cut) } else { Frame::NeedMore(whole - cut) };
            prop_assert_eq!(frame(&bytes[..cut.min(whole)], MAX_MESSAGE), Ok(expected));
        }
    }
}
