//! Text of XML files that nobody has vouched for: how much of it may be one piece, and how much there may be at all.
//!
//! The parser gathers each tag and each stretch of text before it shows it, and a compressed file of a few kilobytes can hold
//! one of gigabytes.

use std::io::{self, BufRead, Read};

/// Longest tag, text or comment, bytes. The longest in real files, an edge's shape or a vehicle's route, has some kilobytes.
const LONGEST_PIECE: u64 = 16 << 20;
/// Longest file, unpacked, bytes: ten times the net of a city of ten thousand intersections.
const LONGEST: u64 = 4 << 30;
/// Most attributes of an element: each is compared with all the others. SUMO's have at most some forty.
pub(crate) const MOST_ATTRIBUTES: usize = 256;

/// Text that ends in an error where a piece or the whole is too long.
#[derive(Debug)]
pub(crate) struct Bounded<R> {
    text: R,
    piece: u64,
    whole: u64,
}

impl<R: BufRead> Bounded<R> {
    pub(crate) fn new(text: R) -> Self {
        Self { text, piece: LONGEST_PIECE, whole: LONGEST }
    }

    /// A new piece begins.
    pub(crate) fn next_piece(&mut self) {
        self.piece = LONGEST_PIECE;
    }

    fn check(&self) -> io::Result<()> {
        let what = match (self.piece, self.whole) {
            (_, 0) => format!("it has more than {LONGEST} bytes of text"),
            (0, _) => format!("a single tag or text in it has more than {LONGEST_PIECE} bytes"),
            _ => return Ok(()),
        };
        Err(io::Error::new(io::ErrorKind::FileTooLarge, what))
    }
}

impl<R: BufRead> BufRead for Bounded<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        let most = usize::try_from(self.piece.min(self.whole)).unwrap_or(usize::MAX);
        let spent = self.check();
        let bytes = self.text.fill_buf()?;
        // The end of the file comes first: a file may be exactly as long.
        if !bytes.is_empty() {
            spent?;
        }
        Ok(&bytes[..bytes.len().min(most)])
    }

    fn consume(&mut self, count: usize) {
        self.piece = self.piece.saturating_sub(count as u64);
        self.whole = self.whole.saturating_sub(count as u64);
        self.text.consume(count);
    }
}

impl<R: BufRead> Read for Bounded<R> {
    fn read(&mut self, target: &mut [u8]) -> io::Result<usize> {
        let bytes = self.fill_buf()?;
        let count = bytes.len().min(target.len());
        target[..count].copy_from_slice(&bytes[..count]);
        self.consume(count);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::BufReader;

    /// Text that never ends.
    fn endless() -> BufReader<io::Repeat> {
        BufReader::new(io::repeat(b'a'))
    }

    fn gather(text: &mut Bounded<impl BufRead>) -> io::Result<usize> {
        let mut gathered = Vec::new();
        text.read_until(b'>', &mut gathered)
    }

    #[test]
    fn a_piece_is_refused_where_it_is_too_long_and_the_next_has_the_same_room() {
        let mut text = Bounded::new(endless());
        assert!(gather(&mut text).unwrap_err().to_string().contains("single tag"));
        text.next_piece();
        let mut byte = [0];
        assert_eq!(text.read(&mut byte).unwrap(), 1);
        let piece = LONGEST_PIECE as usize;
        let exactly = [vec![b'a'; piece - 1], b">".to_vec()].concat();
        assert_eq!(gather(&mut Bounded::new(exactly.as_slice())).unwrap(), piece);
        assert_eq!(gather(&mut Bounded::new(&exactly[..piece - 1])).unwrap(), piece - 1);
    }

    #[test]
    fn a_file_is_refused_where_it_is_too_long() {
        let mut text = Bounded { whole: 100, ..Bounded::new(endless()) };
        assert!(gather(&mut text).unwrap_err().to_string().contains("bytes of text"));
        let mut text = Bounded { whole: 100, ..Bounded::new(&[b'a'; 100][..]) };
        assert_eq!(gather(&mut text).unwrap(), 100);
    }
}
