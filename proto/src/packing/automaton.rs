//! Reads packed counts a byte at a time without unpacking them: what a learner does with every fragment that comes.
//!
//! A code at a time, with a branch for each kind, was a third of the learner's work for a fragment. An automaton over the codes
//! has ten states, so that a byte is a function from state to state.
//!
//! Looked up in a table by state and byte, each byte would wait for the load before it. A function of ten states of six bits fits
//! a word instead, and applying it is a shift:
//!
//! ```text
//!   NEXT[byte]:  bits 6 s .. 6 s + 6 hold 6 x (the state after s)       state = NEXT[byte] >> state, of which six bits count
//! ```
//! The words do not depend on the state, so that they are loaded ahead, and nothing but a shift is between a byte and the next.

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
const STATES: u8 = 10;
/// Bits of a state: ten times six fit a word, and a shift by six bits' worth is what a processor does by itself.
const BITS: u8 = 6;
/// The bits of a word that are the state.
const STATE: u64 = (1 << BITS) - 1;

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

/// The state after a byte's two codes, and the counts that they complete.
const fn both(state: u8, byte: u8) -> (u8, u8) {
    let (between, first) = step(state, byte & 0xf);
    let (after, second) = step(between, byte >> 4);
    (after, first + second)
}

/// For each byte what it makes of every state.
static NEXT: [u64; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < table.len() {
        let mut state = 0;
        while state < STATES {
            let (after, _) = both(state, byte as u8);
            table[byte] |= ((after * BITS) as u64) << (state * BITS);
            state += 1;
        }
        byte += 1;
    }
    table
};

/// For each state times its bits, and each byte: the counts that the byte completes.
static COUNTS: [[u8; 256]; 1 << BITS] = {
    let mut table = [[0; 256]; 1 << BITS];
    let mut state = 0;
    while state < STATES {
        let mut byte = 0;
        while byte < 256 {
            let (_, counts) = both(state, byte as u8);
            table[(state * BITS) as usize][byte] = counts;
            byte += 1;
        }
        state += 1;
    }
    table
};

/// Whether the bytes hold exactly `expected` counts by the rules of [`pack`](super::pack).
pub(super) fn holds(bytes: &[u8], expected: usize) -> bool {
    let Some((&last, whole)) = bytes.split_last() else { return expected == 0 };
    // START times its bits.
    let mut state: u64 = 0;
    let mut counts = 0;
    for &byte in whole {
        counts += usize::from(COUNTS[(state & STATE) as usize][usize::from(byte)]);
        // Takes the low six bits of the state, whatever is above them.
        state = NEXT[usize::from(byte)].wrapping_shr(state as u32);
    }
    if counts >= expected {
        return false;
    }
    let state = (state & STATE) as u8 / BITS;
    // Half of the last byte may be filling.
    let (state, first) = step(state, last & 0xf);
    counts += usize::from(first);
    if state == START && counts == expected {
        return last >> 4 == 0;
    }
    let (state, second) = step(state, last >> 4);
    state == START && counts + usize::from(second) == expected
}
