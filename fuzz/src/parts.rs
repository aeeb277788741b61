//! Several files in one input: each behind its length, four bytes, lowest first.
//!
//! Every input means something: a length beyond the end stands for what is left, and what is missing is empty.

/// The first `N` parts; what follows them is ignored.
#[must_use]
pub fn split<const N: usize>(mut input: &[u8]) -> [&[u8]; N] {
    std::array::from_fn(|_| {
        let Some((length, rest)) = input.split_first_chunk::<4>() else {
            return std::mem::take(&mut input);
        };
        let length = usize::try_from(u32::from_le_bytes(*length)).unwrap_or(usize::MAX);
        let (part, rest) = rest.split_at(length.min(rest.len()));
        input = rest;
        part
    })
}

/// The input of these parts.
#[must_use]
pub fn join<const N: usize>(parts: [&[u8]; N]) -> Vec<u8> {
    let mut input = Vec::new();
    for part in parts {
        input.extend(u32::try_from(part.len()).unwrap_or(u32::MAX).to_le_bytes());
        input.extend(part);
    }
    input
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_joined_is_split_again() {
        assert_eq!(split(&join([b"one", b"", b"three"])), [&b"one"[..], b"", b"three"]);
    }

    #[test]
    fn lengths_may_lie() {
        assert_eq!(split(&[9, 0, 0, 0, 1, 2]), [&[1, 2][..], &[]]);
        assert_eq!(split(&[1, 0, 0, 0, 7, 8, 9]), [&[7][..], &[8, 9], &[]]);
        assert_eq!(split::<2>(&[]), [&[] as &[u8], &[]]);
        assert_eq!(split(&[0xff; 5]), [&[0xff][..], &[]]);
    }
}
