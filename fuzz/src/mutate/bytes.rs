//! Changes that know nothing of the form.

use super::below;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// A few bytes changed, taken out, doubled, or the end cut off.
pub fn mutate(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    for _ in 0..1 + below(rng, 3) {
        let at = below(rng, input.len() + 1);
        let length = (1 + below(rng, 8)).min(input.len() - at);
        match below(rng, 6) {
            0 => drop(input.drain(at..at + length)),
            1 => {
                let copy = input[at..at + length].to_vec();
                let to = below(rng, input.len() + 1);
                input.splice(to..to, copy);
            }
            2 => input.insert(at, rng.random()),
            3 if below(rng, 4) == 0 => input.truncate(at),
            _ => change(input, at, rng),
        }
    }
    input.truncate(most);
}

fn change(input: &mut [u8], at: usize, rng: &mut impl Rng) {
    let Some(byte) = input.get_mut(at) else { return };
    *byte = match below(rng, 4) {
        0 => *byte ^ (1 << below(rng, 8)),
        1 => byte.wrapping_add(1),
        2 => [0, 0xff, 0x7f, 0x80][below(rng, 4)],
        _ => rng.random(),
    };
}
