//! Changes to inputs that keep their form, so that they get past the first check.
//!
//! What a form knows of its own (elements, lengths, counts) is changed together; single bytes are left to libFuzzer, and to
//! [`bytes`] where there is none.

pub mod bytes;
pub mod text;
pub mod traci;
pub mod wire;

use crate::parts;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// Changes an input; `most` is the longest that it may become.
pub type Mutator = fn(&mut Vec<u8>, usize, &mut ChaCha8Rng);

/// Changes one of several parts.
pub fn parts<const N: usize>(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng, mutators: [Mutator; N]) {
    let split: [&[u8]; N] = parts::split(input);
    let mut owned = split.map(<[u8]>::to_vec);
    let chosen = below(rng, N);
    let others: usize = owned.iter().map(Vec::len).sum::<usize>() - owned[chosen].len();
    mutators[chosen](&mut owned[chosen], most.saturating_sub(others + 4 * N), rng);
    *input = parts::join(owned.each_ref().map(Vec::as_slice));
    // The lengths may be new: what had no room for them is longer now.
    input.truncate(most);
}

/// One of `0..count`; 0 if there is none.
fn below(rng: &mut impl Rng, count: usize) -> usize {
    if count < 2 { 0 } else { rng.random_range(0..count) }
}

/// One of these.
fn pick<'a, T: ?Sized>(rng: &mut impl Rng, of: &[&'a T]) -> &'a T {
    of[below(rng, of.len())]
}
