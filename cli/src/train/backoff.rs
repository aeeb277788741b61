//! How soon, how often, and how long in vain a process that died is started again.

use std::collections::VecDeque;
use std::time::Duration;

/// The window over which restarts are counted.
const WINDOW: Duration = Duration::from_secs(60);

/// Restarts of one process: each sooner than the last one allows, none beyond so many a minute.
///
/// Times are since the start of the run, so that tests need no clock.
#[derive(Debug, Clone)]
pub(crate) struct Backoff {
    first: Duration,
    longest: Duration,
    per_minute: usize,
    recent: VecDeque<Duration>,
}

impl Backoff {
    pub(crate) fn new(first: Duration, longest: Duration, per_minute: usize) -> Self {
        Self { first, longest, per_minute, recent: VecDeque::new() }
    }

    /// Counts a death at `now`; how long to wait before the next start, or `None` when it died too often.
    pub(crate) fn after_death(&mut self, now: Duration) -> Option<Duration> {
        while self.recent.front().is_some_and(|&then| now.saturating_sub(then) >= WINDOW) {
            self.recent.pop_front();
        }
        if self.recent.len() >= self.per_minute {
            return None;
        }
        // Doubles with every death that the window still holds: one now and then costs little, a series waits longer.
        let doublings = u32::try_from(self.recent.len()).unwrap_or(u32::MAX).min(16);
        self.recent.push_back(now);
        Some(self.first.saturating_mul(1 << doublings).min(self.longest))
    }

    /// Most restarts within a minute.
    pub(crate) fn per_minute(&self) -> usize {
        self.per_minute
    }
}

/// Deaths of one process since training last advanced.
///
/// The rate alone would let a process that takes a while to die be started again for ever.
#[derive(Debug, Clone, Default)]
pub(crate) struct InVain {
    progress: u64,
    deaths: u32,
}

impl InVain {
    /// Counts a death when training had come to `progress`; deaths so far without any advance.
    pub(crate) fn after_death(&mut self, progress: u64) -> u32 {
        self.deaths = self.deaths(progress).saturating_add(1);
        self.progress = self.progress.max(progress);
        self.deaths
    }

    /// Deaths without any advance, now that training has come to `progress`.
    pub(crate) fn deaths(&self, progress: u64) -> u32 {
        if progress > self.progress { 0 } else { self.deaths }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(n: u64) -> Duration {
        Duration::from_secs(n)
    }

    #[test]
    fn waits_double_up_to_the_longest() {
        let mut backoff = Backoff::new(seconds(1), seconds(5), 10);
        let waits: Vec<_> = (0..5).map(|i| backoff.after_death(seconds(i)).unwrap().as_secs()).collect();
        assert_eq!(waits, [1, 2, 4, 5, 5]);
    }

    #[test]
    fn too_many_a_minute_is_refused_and_forgotten_later() {
        let mut backoff = Backoff::new(seconds(1), seconds(1), 2);
        assert!(backoff.after_death(seconds(0)).is_some());
        assert!(backoff.after_death(seconds(10)).is_some());
        assert_eq!(backoff.after_death(seconds(59)), None);
        assert_eq!(backoff.after_death(seconds(60)), Some(seconds(1)));
    }

    #[test]
    fn only_an_advance_forgets_deaths() {
        let mut in_vain = InVain::default();
        assert_eq!([3, 3, 3].map(|progress| in_vain.after_death(progress)), [1, 2, 3]);
        assert_eq!((in_vain.deaths(3), in_vain.deaths(4)), (3, 0));
        // Going back to an older checkpoint is no advance.
        assert_eq!([2, 3, 4].map(|progress| in_vain.after_death(progress)), [4, 5, 1]);
    }
}
