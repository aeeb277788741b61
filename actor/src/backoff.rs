//! How long to wait before the next attempt.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// Pause after the first failure.
const FIRST: Duration = Duration::from_millis(200);
/// No pause is longer: after an outage of any length, actors are back within this time.
const LONGEST: Duration = Duration::from_secs(5);

/// Exponential back-off with jitter.
///
/// Pauses double from 200 ms to 5 s, and each is shortened by a random part of up to one half, so that the actors of a
/// cluster do not return to a restarted learner all at once.
#[derive(Debug)]
pub struct Backoff {
    next: Duration,
    rng: ChaCha8Rng,
}

impl Backoff {
    /// Jitter is drawn from `seed`: different for each actor, repeatable in tests.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { next: FIRST, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The pause after one more failure.
    pub fn pause(&mut self) -> Duration {
        let full = self.next;
        self.next = (self.next * 2).min(LONGEST);
        full.mul_f64(self.rng.random_range(0.5..=1.0))
    }

    /// Starts over after a success.
    pub fn reset(&mut self) {
        self.next = FIRST;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_the_longest_within_the_jitter() {
        let mut backoff = Backoff::new(7);
        let mut full = FIRST;
        for _ in 0..12 {
            let pause = backoff.pause();
            assert!(pause >= full / 2 && pause <= full, "{pause:?} of {full:?}");
            full = (full * 2).min(LONGEST);
        }
        assert_eq!(full, LONGEST);
    }

    #[test]
    fn success_starts_over() {
        let mut backoff = Backoff::new(7);
        for _ in 0..8 {
            backoff.pause();
        }
        backoff.reset();
        assert!(backoff.pause() <= FIRST);
    }

    #[test]
    fn actors_with_different_seeds_return_at_different_times() {
        let pauses = |seed| {
            let mut backoff = Backoff::new(seed);
            (0..4).map(|_| backoff.pause()).collect::<Vec<_>>()
        };
        assert_eq!(pauses(1), pauses(1));
        assert_ne!(pauses(1), pauses(2));
    }
}
