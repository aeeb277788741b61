//! Reads packed counts a byte at a time without unpacking them: what a learner does with every fragment that comes.
//!
//! A code at a time, with a branch for each kind, was a third of the learner's work for a fragment. An automaton over the codes
//! has ten states, so that a table tells for each of them and each byte the state after it and how many counts it adds.

/// The next code begins a count or a run.
const START: u8 = 0;
/// The next code is the length of a run.
const LENGTH: u8 = 1;
/// The next code is the first of a wide count's four.
const WIDE_FIRST: u8 = 2;
/// Three, two, one codes of a wide count are missing, and it is small so far: if the rest are zeros it has a short form.
const SMALL: [u8; 3] = [3, 4, 5];
/// The same, and it is not small.
const LARGE: [u8; 3] = [6, 7, 8];
/// These are not packed counts.
const REFUSED: u8 = 9;
/// A power of two, so that a state needs no check to be an index.
const STATES: usize = 16;

/// The state after a code, and the counts that it completes.
const fn step(state: u8, code: u8) -> (u8, u8) {
    match (state, code) {
        (START, super::RUN) => (LENGTH, 0),
        (START, super::WIDE) => (WIDE_FIRST, 0),
        (START, _) => (START, 1),
        (LENGTH, length) => (START, length + super::MIN_RUN as u8),
        (WIDE_FIRST, 14 | 15) => (LARGE[0], 0),
        (WIDE_FIRST, _) => (SMALL[0], 0),
        (3, 0) => (SMALL[1], 0),
        (4, 0) => (SMALL[2], 0),
        (5, 0) => (REFUSED, 0),
        (3 | 6, _) => (LARGE[1], 0),
        (4 | 7, _) => (LARGE[2], 0),
        (5 | 8, _) => (START, 1),
        _ => (REFUSED, 0),
    }
}

/// For each state and byte: the state after its two codes in the high byte, the counts that they complete in the low one.
static BYTES: [[u16; 256]; STATES] = {
    let mut table = [[0; 256]; STATES];
    let mut state = 0;
    while state < STATES {
        let mut byte = 0;
        while byte < 256 {
            let (between, first) = step(state as u8, byte as u8 & 0xf);
            let (after, second) = step(between, byte as u8 >> 4);
            table[state][byte] = (after as u16) << 8 | (first + second) as u16;
            byte += 1;
        }
        state += 1;
    }
    table
};

/// Whether the bytes hold exactly `expected` counts by the rules of [`pack`](super::pack).
pub(super) fn holds(bytes: &[u8], expected: usize) -> bool {
    let Some((&last, whole)) = bytes.split_last() else { return expected == 0 };
    let (mut state, mut counts) = (START, 0);
    for &byte in whole {
        let entry = BYTES[usize::from(state) % STATES][usize::from(byte)];
        state = (entry >> 8) as u8;
        counts += usize::from(entry & 0xff);
    }
    if counts >= expected {
        return false;
    }
    // Half of the last byte may be filling.
    let (state, first) = step(state, last & 0xf);
    counts += usize::from(first);
    if state == START && counts == expected {
        return last >> 4 == 0;
    }
    let (state, second) = step(state, last >> 4);
    state == START && counts + usize::from(second) == expected
}
