//! Vehicle counts in few bytes.
//!
//! Counts of vehicles in a lane's bands are nearly always small and mostly zero. They are written as a sequence of
//! four-bit codes, two a byte, low half first:
//!
//! | code | followed by | meaning |
//! |---|---|---|
//! | 0..=13 | | that count |
//! | 14 | one code `r` | a run of `r + 3` zeros, 3 to 18 |
//! | 15 | four codes, lowest first | a count of 16 bits, 14 to 65535 |
//!
//! An odd number of codes is filled up with a 0. The number of counts is not written: the receiver knows it from the
//! layout and the number of steps, and refuses bytes that hold more or fewer.

mod automaton;

/// Largest count that is its own code.
const MAX_DIRECT: u16 = 13;
const RUN: u8 = 14;
const WIDE: u8 = 15;
/// Shortest run worth its two codes; shorter ones are single zeros.
const MIN_RUN: usize = 3;
const MAX_RUN: usize = MIN_RUN + 15;

/// Why bytes are not packed counts.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PackingError {
    /// The bytes end too early.
    #[error("ends before the {expected} counts that its layout and steps give")]
    TooShort {
        /// Counts that were asked for.
        expected: usize,
    },
    /// There is more than was asked for.
    #[error("holds more than the {expected} counts that its layout and steps give")]
    TooLong {
        /// Counts that were asked for.
        expected: usize,
    },
    /// A wide code holds a count that has a short one.
    #[error("writes the count {value} in the wide form that is for counts from 14")]
    NotWide {
        /// The count.
        value: u16,
    },
}

/// Packs counts.
#[must_use]
pub fn pack(counts: &[u16]) -> Vec<u8> {
    let mut writer = Writer { bytes: Vec::with_capacity(counts.len() / 4 + 8), half: false };
    let mut rest = counts;
    while let Some(&count) = rest.first() {
        let zeros = rest.iter().take(MAX_RUN).take_while(|&&c| c == 0).count();
        if zeros >= MIN_RUN {
            writer.put(RUN);
            // At most MAX_RUN - MIN_RUN = 15.
            writer.put((zeros - MIN_RUN) as u8);
            rest = &rest[zeros..];
            continue;
        }
        if count <= MAX_DIRECT {
            writer.put(count as u8);
        } else {
            writer.put(WIDE);
            for shift in [0, 4, 8, 12] {
                writer.put((count >> shift) as u8 & 0xf);
            }
        }
        rest = &rest[1..];
    }
    writer.bytes
}

/// Unpacks exactly `expected` counts.
///
/// Memory is taken only when the bytes are long enough to hold that many counts.
///
/// # Errors
/// [`PackingError`] if the bytes hold fewer or more counts, or were not written by [`pack`]'s rules.
pub fn unpack(bytes: &[u8], expected: usize) -> Result<Vec<u16>, PackingError> {
    if is_too_short(bytes, expected) {
        return Err(PackingError::TooShort { expected });
    }
    let mut counts = Unpacked(Vec::with_capacity(expected));
    read(bytes, expected, &mut counts)?;
    Ok(counts.0)
}

/// Whether [`unpack`] would give exactly `expected` counts; takes no memory, and a fraction of the time.
///
/// # Errors
/// As [`unpack`].
pub fn check(bytes: &[u8], expected: usize) -> Result<(), PackingError> {
    if automaton::holds(bytes, expected) {
        return Ok(());
    }
    if is_too_short(bytes, expected) {
        return Err(PackingError::TooShort { expected });
    }
    read(bytes, expected, &mut Counted(0))
}

/// Whether there are too few bytes for the densest form, a run: one byte for [`MAX_RUN`] counts.
fn is_too_short(bytes: &[u8], expected: usize) -> bool {
    bytes.len().saturating_mul(MAX_RUN) < expected
}

/// What becomes of counts that are read.
trait Sink {
    /// How many there are so far.
    fn len(&self) -> usize;
    fn one(&mut self, count: u16);
    fn zeros(&mut self, zeros: usize);
}

struct Unpacked(Vec<u16>);

impl Sink for Unpacked {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn one(&mut self, count: u16) {
        self.0.push(count);
    }

    fn zeros(&mut self, zeros: usize) {
        self.0.resize(self.0.len() + zeros, 0);
    }
}

struct Counted(usize);

impl Sink for Counted {
    fn len(&self) -> usize {
        self.0
    }

    fn one(&mut self, _: u16) {
        self.0 += 1;
    }

    fn zeros(&mut self, zeros: usize) {
        self.0 += zeros;
    }
}

fn read(bytes: &[u8], expected: usize, counts: &mut impl Sink) -> Result<(), PackingError> {
    let mut reader = Reader { bytes: bytes.iter(), high: None };
    while counts.len() < expected {
        match reader.get().ok_or(PackingError::TooShort { expected })? {
            RUN => {
                let zeros = reader.get().ok_or(PackingError::TooShort { expected })?;
                let zeros = usize::from(zeros) + MIN_RUN;
                if zeros > expected - counts.len() {
                    return Err(PackingError::TooLong { expected });
                }
                counts.zeros(zeros);
            }
            WIDE => {
                let mut value = 0;
                for shift in [0, 4, 8, 12] {
                    let code = reader.get().ok_or(PackingError::TooShort { expected })?;
                    value |= u16::from(code) << shift;
                }
                if value <= MAX_DIRECT {
                    return Err(PackingError::NotWide { value });
                }
                counts.one(value);
            }
            direct => counts.one(u16::from(direct)),
        }
    }
    // At most the filling half byte may be left, and it is 0.
    if reader.high.is_some_and(|filling| filling != 0) || !reader.bytes.as_slice().is_empty() {
        return Err(PackingError::TooLong { expected });
    }
    Ok(())
}

struct Writer {
    bytes: Vec<u8>,
    /// Whether the last byte's high half is free.
    half: bool,
}

impl Writer {
    fn put(&mut self, code: u8) {
        match self.bytes.last_mut().filter(|_| self.half) {
            Some(last) => *last |= code << 4,
            None => self.bytes.push(code),
        }
        self.half = !self.half;
    }
}

struct Reader<'a> {
    bytes: std::slice::Iter<'a, u8>,
    /// The second half of the byte whose first half was read last.
    high: Option<u8>,
}

impl Reader<'_> {
    fn get(&mut self) -> Option<u8> {
        if let Some(high) = self.high.take() {
            return Some(high);
        }
        let byte = *self.bytes.next()?;
        self.high = Some(byte >> 4);
        Some(byte & 0xf)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Counts as traffic gives them: mostly zeros, sometimes a queue, rarely a jam on a long lane.
    fn counts() -> impl Strategy<Value = Vec<u16>> {
        let count = prop_oneof![6 => Just(0), 3 => 0..20_u16, 1 => any::<u16>()];
        proptest::collection::vec(count, 0..400)
    }

    proptest! {
        #[test]
        fn round_trip(counts in counts()) {
            prop_assert_eq!(check(&pack(&counts), counts.len()), Ok(()));
            prop_assert_eq!(unpack(&pack(&counts), counts.len()), Ok(counts));
        }

        #[test]
        fn every_other_length_is_refused(counts in counts(), difference in 1..4_usize, more: bool) {
            let other = if more { counts.len() + difference } else { counts.len().saturating_sub(difference) };
            prop_assume!(other != counts.len());
            // The 0 that fills the last byte cannot be told from a last count of 0; nothing else may pass.
            if let Ok(unpacked) = unpack(&pack(&counts), other) {
                prop_assert_eq!(other.abs_diff(counts.len()), 1);
                let longer = if other > counts.len() { &unpacked } else { &counts };
                prop_assert_eq!(longer.last(), Some(&0));
            }
        }

        #[test]
        fn a_byte_more_or_less_is_refused(counts in counts(), extra: u8) {
            let mut packed = pack(&counts);
            packed.push(extra);
            prop_assert_eq!(unpack(&packed, counts.len()), Err(PackingError::TooLong { expected: counts.len() }));
            packed.pop();
            if packed.pop().is_some() {
                prop_assert_eq!(unpack(&packed, counts.len()), Err(PackingError::TooShort { expected: counts.len() }));
            }
        }

        #[test]
        fn garbage_gives_the_asked_number_or_an_error(bytes: Vec<u8>, expected in 0..2000_usize) {
            let unpacked = unpack(&bytes, expected);
            prop_assert_eq!(check(&bytes, expected), unpacked.clone().map(drop));
            if let Ok(counts) = unpacked {
                prop_assert_eq!(counts.len(), expected);
            }
        }
    }

    /// Bytes of codes that are mostly runs and wide counts, right and wrong.
    fn odd_bytes() -> impl Strategy<Value = Vec<u8>> {
        let half = prop_oneof![3 => Just(0_u8), 3 => Just(RUN), 3 => Just(WIDE), 2 => 0..16_u8];
        proptest::collection::vec((half.clone(), half).prop_map(|(low, high)| low | high << 4), 0..12)
    }

    proptest! {
        #[test]
        fn the_automaton_takes_exactly_what_unpacks(bytes in odd_bytes()) {
            for expected in 0..200 {
                let unpacked = unpack(&bytes, expected);
                prop_assert_eq!(automaton::holds(&bytes, expected), unpacked.is_ok(), "{} {:?}", expected, unpacked);
                prop_assert_eq!(check(&bytes, expected), unpacked.map(drop));
            }
        }
    }

    #[test]
    fn the_layout_of_codes_is_fixed() {
        assert_eq!(pack(&[1, 2, 13]), [0x21, 0x0d]);
        assert_eq!(pack(&[0, 0]), [0x00]);
        assert_eq!(pack(&[0; 3]), [0x0e]);
        assert_eq!(pack(&[0; 18]), [0xfe]);
        assert_eq!(pack(&[0; 19]), [0xfe, 0x00]);
        assert_eq!(pack(&[14]), [0xef, 0x00, 0x00]);
        assert_eq!(pack(&[0x1234, 1]), [0x4f, 0x23, 0x11]);
        assert!(pack(&[]).is_empty());
    }

    #[test]
    fn a_huge_expectation_takes_no_memory() {
        assert_eq!(unpack(&[0xfe; 10], usize::MAX), Err(PackingError::TooShort { expected: usize::MAX }));
    }

    #[test]
    fn a_run_past_the_end_is_refused() {
        assert_eq!(unpack(&[0xfe], 17), Err(PackingError::TooLong { expected: 17 }));
    }

    #[test]
    fn a_small_count_in_the_wide_form_is_refused() {
        assert_eq!(unpack(&[0x3f, 0x00, 0x00], 1), Err(PackingError::NotWide { value: 3 }));
    }

    #[test]
    fn a_filling_that_is_not_zero_is_refused() {
        assert_eq!(unpack(&[0x15], 1), Err(PackingError::TooLong { expected: 1 }));
        assert_eq!(unpack(&[0x05], 1), Ok(vec![5]));
    }
}
