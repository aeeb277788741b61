//! TraCI's blocks: values are put in with the counts and lengths about them, or taken apart.

use super::{below, bytes, pick};
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

const TYPES: [u8; 16] =
    [0x00, 0x01, 0x02, 0x03, 0x04, 0x06, 0x07, 0x08, 0x09, 0x0a, 0x0b, 0x0c, 0x0e, 0x0f, 0x10, 0x11];

/// Bytes without a length of their own: one value, or what a target puts behind a length.
pub fn value(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    match below(rng, 4) {
        0 => {
            let at = below(rng, input.len() + 1);
            let new = make_value(rng, 0);
            input.splice(at..at, new);
        }
        1 => change_number(input, rng),
        2 if !input.is_empty() => {
            let at = below(rng, input.len());
            input[at] = TYPES[below(rng, TYPES.len())];
        }
        _ => bytes::mutate(input, most, rng),
    }
    input.truncate(most);
}

/// A first byte that chooses, then blocks one behind the other.
pub fn blocks(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    if input.is_empty() || below(rng, 16) == 0 {
        return value(input, most, rng);
    }
    let places = places(&input[1..]);
    let Some(&(start, header, end)) = places.get(below(rng, places.len())) else {
        return value(input, most, rng);
    };
    let (start, end) = (start + 1, end + 1);
    match below(rng, 8) {
        0 => drop(input.drain(start..end)),
        1 => {
            let copy = input[start..end].to_vec();
            input.splice(start..start, copy);
        }
        2 => change_number(input, rng),
        _ => {
            // The block's length follows its content.
            let mut content = input[start + header..end].to_vec();
            for _ in 0..1 + below(rng, 3) {
                value(&mut content, most, rng);
            }
            input.splice(start..end, block(&content));
        }
    }
    input.truncate(most);
}

/// Start, length of the header and end of each block, as far as lengths are right.
fn places(bytes: &[u8]) -> Vec<(usize, usize, usize)> {
    let mut places = Vec::new();
    let mut at = 0;
    while let Some(&short) = bytes.get(at) {
        let (length, header) = if short == 0 {
            let Some(long) = bytes.get(at + 1..).and_then(<[u8]>::first_chunk::<4>) else { break };
            (usize::try_from(i32::from_be_bytes(*long)).unwrap_or(0), 5)
        } else {
            (usize::from(short), 1)
        };
        let Some(end) = at.checked_add(length).filter(|&end| length >= header && end <= bytes.len()) else {
            // A step's answer has the number of subscriptions here.
            at += 4;
            continue;
        };
        places.push((at, header, end));
        at = end;
    }
    places
}

/// A block of this content.
#[must_use]
pub fn block(content: &[u8]) -> Vec<u8> {
    match u8::try_from(content.len() + 1) {
        Ok(short) => [&[short], content].concat(),
        Err(_) => {
            let length = i32::try_from(content.len() + 5).unwrap_or(i32::MAX);
            [&[0], &length.to_be_bytes()[..], content].concat()
        }
    }
}

/// Changes four bytes that may be a length or count.
fn change_number(input: &mut [u8], rng: &mut impl Rng) {
    let small = |at: &usize| {
        input[*at..].first_chunk::<4>().is_some_and(|b| i32::from_be_bytes(*b).unsigned_abs() < 4096)
    };
    let places: Vec<usize> = (0..input.len().saturating_sub(3)).filter(small).collect();
    let Some(&at) = places.get(below(rng, places.len())) else { return };
    let Some(bytes) = input[at..].first_chunk_mut::<4>() else { return };
    let old = i32::from_be_bytes(*bytes);
    let new = match below(rng, 5) {
        0 => old.wrapping_add(1),
        1 => old.wrapping_sub(1),
        2 => [0, -1, i32::MAX, i32::MIN, 1 << 28, 255, 256][below(rng, 7)],
        3 => old.wrapping_mul(2),
        _ => rng.random_range(0..300),
    };
    *bytes = new.to_be_bytes();
}

fn text(rng: &mut impl Rng) -> Vec<u8> {
    let text = pick(rng, &["", "J0", "v", "gneE1_0", "rrGG", "ä", "unknown"]);
    [&u32::try_from(text.len()).unwrap_or(0).to_be_bytes(), text.as_bytes()].concat()
}

/// A value with its type, right in itself.
fn make_value(rng: &mut impl Rng, depth: usize) -> Vec<u8> {
    let id = TYPES[below(rng, TYPES.len())];
    let mut bytes = vec![id];
    let mut doubles = |count: usize| -> Vec<u8> {
        (0..count)
            .flat_map(|_| [0.0, 1.5, -1073741824.0, f64::NAN, f64::INFINITY][below(rng, 5)].to_be_bytes())
            .collect()
    };
    match id {
        0x00 | 0x01 => bytes.extend(doubles(2)),
        0x02 | 0x03 => bytes.extend(doubles(3)),
        0x0b => bytes.extend(doubles(1)),
        0x04 => {
            bytes.extend(text(rng));
            bytes.extend([0; 9]);
        }
        0x06 => {
            let count = below(rng, 4);
            bytes.push(u8::try_from(count).unwrap_or(0));
            bytes.extend(vec![0; 16 * count]);
        }
        0x07 | 0x08 => bytes.push(rng.random()),
        0x09 => bytes.extend(rng.random::<[u8; 4]>()),
        0x0c => bytes.extend(text(rng)),
        0x0e | 0x10 => {
            let count = below(rng, 4);
            bytes.extend(u32::try_from(count).unwrap_or(0).to_be_bytes());
            for _ in 0..count {
                if id == 0x0e {
                    bytes.extend(text(rng));
                } else {
                    bytes.extend(1.0f64.to_be_bytes());
                }
            }
        }
        0x0f => {
            let count = if depth > 10 { 0 } else { below(rng, 3) };
            bytes.extend(u32::try_from(count).unwrap_or(0).to_be_bytes());
            for _ in 0..count {
                bytes.extend(make_value(rng, depth + 1));
            }
        }
        _ => bytes.extend([0, 0, 0, 1]),
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_changed_block_keeps_its_length_right() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut whole = 0;
        for _ in 0..1000 {
            let mut input = [&[0][..], &block(&[7; 10]), &block(&[8; 300])].concat();
            blocks(&mut input, 2000, &mut rng);
            let places = places(&input[1..]);
            whole += usize::from(places.last().is_some_and(|(_, _, end)| *end == input.len() - 1));
        }
        assert!(whole > 700, "{whole}");
    }
}
