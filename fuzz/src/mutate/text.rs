//! XML, JSON, TOML and lines: whole elements, values and numbers are changed, so that most results still parse.

use super::{below, bytes, pick};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Numbers at the edges of what readers take.
const NUMBERS: &[&str] = &[
    "0",
    "1",
    "-1",
    "-0",
    "2",
    "3",
    "255",
    "256",
    "65535",
    "65536",
    "2147483647",
    "4294967295",
    "4294967296",
    "9007199254740993",
    "18446744073709551615",
    "18446744073709551616",
    "-9223372036854775808",
    "0.1",
    "1e-320",
    "1e308",
    "1e999",
    "NaN",
    "inf",
    "-inf",
    "1e18",
    "0.9999999999999999",
    "1_000",
    "0x10",
    "007",
    "",
];

/// Pieces that mean something in one of the forms.
const WORDS: &[&str] = &[
    "<",
    ">",
    "/>",
    "</",
    "&amp;",
    "&#0;",
    "&#x10FFFF;",
    "&",
    "<!--",
    "-->",
    "<![CDATA[",
    "]]>",
    "<?xml",
    "?>",
    "<!DOCTYPE a>",
    "\"",
    "'",
    "=",
    " ",
    "\n",
    "\t",
    "{",
    "}",
    "[",
    "]",
    ",",
    ":",
    "null",
    "true",
    "\\u0000",
    "\\ud800",
    "#",
    "[[a]]",
    "\u{feff}",
    "ä",
    "\u{10ffff}",
    "\0",
    ".",
    "..",
    "/",
    "%",
    "-",
];

/// XML.
pub fn xml(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    mutate(input, most, rng, elements);
}

/// JSON.
pub fn json(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    mutate(input, most, rng, brackets);
}

/// TOML, JSON lines, tokens.
pub fn lines(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    mutate(input, most, rng, line);
}

/// Finds the unit (element, value, line) about a place.
type Unit = fn(&[u8], usize) -> Option<Range<usize>>;

fn mutate(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng, unit: Unit) {
    for _ in 0..1 + below(rng, 4) {
        let at = below(rng, input.len() + 1);
        match below(rng, 12) {
            0..=2 => {
                let number = pick(rng, NUMBERS);
                replace(input, next(input, at, number_at), number.as_bytes());
            }
            3..=5 => {
                // Ids name each other: one value in another's place hits or misses.
                let value =
                    next(input, below(rng, input.len() + 1), string_at).map(|place| input[place].to_vec());
                if let Some(value) = value {
                    replace(input, next(input, at, string_at), &value);
                }
            }
            6 => replace(input, unit(input, at), &[]),
            7 | 8 => {
                let copy = unit(input, at).map(|place| input[place].to_vec()).unwrap_or_default();
                let to = unit(input, below(rng, input.len() + 1)).map_or(at, |place| place.start);
                // Now and then very often: what is quadratic shows.
                let times = if below(rng, 16) == 0 { 1 + below(rng, 64) } else { 1 };
                if input.len() + copy.len() * times <= most {
                    input.splice(to..to, copy.repeat(times));
                }
            }
            9 => {
                let (one, other) = (unit(input, at), unit(input, below(rng, input.len() + 1)));
                if let (Some(one), Some(other)) = (one, other)
                    && one.end <= other.start
                {
                    let (first, second) = (input[one.clone()].to_vec(), input[other.clone()].to_vec());
                    input.splice(other, first);
                    input.splice(one, second);
                }
            }
            10 => {
                let word = pick(rng, WORDS);
                input.splice(at..at, word.bytes());
            }
            _ => bytes::mutate(input, most, rng),
        }
    }
    if input.len() > most || rng.random_ratio(1, 100) {
        let end = unit(input, below(rng, input.len() + 1)).map_or(most, |place| place.start);
        input.truncate(end.min(most));
    }
}

fn replace(input: &mut Vec<u8>, place: Option<Range<usize>>, by: &[u8]) {
    if let Some(place) = place {
        input.splice(place, by.iter().copied());
    }
}

/// The first range that `find` gives from `at` on.
fn next(input: &[u8], at: usize, find: fn(&[u8], usize) -> Option<Range<usize>>) -> Option<Range<usize>> {
    // Far enough for the longest tag; the whole input would make this slow.
    (at..input.len().min(at + 400)).find_map(|at| find(input, at))
}

fn number_at(input: &[u8], at: usize) -> Option<Range<usize>> {
    let numeric = |byte: &u8| byte.is_ascii_digit() || b".-+eE".contains(byte);
    if !input.get(at)?.is_ascii_digit() {
        return None;
    }
    let start = input[..at].iter().rposition(|byte| !numeric(byte)).map_or(0, |before| before + 1);
    let end = input[at..].iter().position(|byte| !numeric(byte)).map_or(input.len(), |length| at + length);
    Some(start..end)
}

/// What stands between the quotation mark at `at` and the next one.
fn string_at(input: &[u8], at: usize) -> Option<Range<usize>> {
    let mark = *input.get(at).filter(|mark| b"\"'".contains(mark))?;
    let length = input[at + 1..].iter().position(|byte| *byte == mark)?;
    Some(at + 1..at + 1 + length)
}

/// The tag about `at`; of an opening one sometimes all to the end of the line, which is where writers end elements.
fn elements(input: &[u8], at: usize) -> Option<Range<usize>> {
    let start = input.get(..=at.min(input.len().checked_sub(1)?))?.iter().rposition(|byte| *byte == b'<')?;
    let end = start + 1 + input[start..].iter().position(|byte| *byte == b'>')?;
    let closed = input[..end].ends_with(b"/>") || input[start..].starts_with(b"</");
    if closed {
        return Some(start..end);
    }
    // An opening tag: to the closing one of the same name, if there is one.
    let name_end = input[start + 1..].iter().position(|byte| b" />\n".contains(byte))? + start + 1;
    let closing = [b"</", &input[start + 1..name_end], b">"].concat();
    let to = input[end..].windows(closing.len()).position(|window| window == closing);
    Some(start..to.map_or(end, |to| end + to + closing.len()))
}

/// The innermost object or list that begins at or before `at`, with the comma behind it.
fn brackets(input: &[u8], at: usize) -> Option<Range<usize>> {
    let start =
        input.get(..=at.min(input.len().checked_sub(1)?))?.iter().rposition(|byte| b"{[".contains(byte))?;
    let mut depth = 0usize;
    for (offset, byte) in input[start..].iter().enumerate() {
        match byte {
            b'{' | b'[' => depth += 1,
            b'}' | b']' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            let end = start + offset + 1;
            return Some(start..end + usize::from(input.get(end) == Some(&b',')));
        }
    }
    None
}

fn line(input: &[u8], at: usize) -> Option<Range<usize>> {
    let at = at.min(input.len().checked_sub(1)?);
    let start = input[..at].iter().rposition(|byte| *byte == b'\n').map_or(0, |before| before + 1);
    let end =
        input[at..].iter().position(|byte| *byte == b'\n').map_or(input.len(), |length| at + length + 1);
    Some(start..end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn units_are_whole() {
        let text = b"<a><b x=\"1\"/><c>2</c></a>";
        let tag = |at: usize| elements(text, at).map(|place| std::str::from_utf8(&text[place]).unwrap());
        assert_eq!((tag(1), tag(6)), (Some("<a><b x=\"1\"/><c>2</c></a>"), Some("<b x=\"1\"/>")));
        assert_eq!((tag(15), tag(19)), (Some("<c>2</c>"), Some("</c>")));
        let text = b"[{\"a\":[1,2]},{\"b\":3}]";
        let value = |at: usize| brackets(text, at).map(|place| std::str::from_utf8(&text[place]).unwrap());
        assert_eq!((value(3), value(7)), (Some("{\"a\":[1,2]},"), Some("[1,2]")));
        assert_eq!(brackets(b"[1", 1), None);
        assert_eq!((line(b"a\nbc\n", 2), line(b"", 0)), (Some(2..5), None));
        assert_eq!((number_at(b"x=-1.5e3,", 5), string_at(b"='ab'", 1)), (Some(2..8), Some(2..4)));
    }

    #[test]
    fn nothing_grows_beyond_the_limit_and_empty_input_is_fine() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for mutate in [xml, json, lines] {
            let (mut input, mut longest) = (Vec::new(), 0);
            for _ in 0..3000 {
                mutate(&mut input, 300, &mut rng);
                assert!(input.len() <= 300);
                longest = longest.max(input.len());
            }
            assert!(longest > 200, "{longest}");
        }
    }
}
