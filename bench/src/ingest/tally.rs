//! What a case comes to.

use crate::cluster::actor::Acknowledged;
use crate::report::{median, quantile};
use std::fmt;

/// What one actor counted.
#[derive(Debug, Default)]
pub(super) struct Tally {
    /// Fragments in all.
    pub(super) sent: u64,
    /// Those acknowledged.
    pub(super) acknowledged: u64,
    /// Decisions in those acknowledged while it counted.
    decisions: u64,
    /// How long each of these took, milliseconds.
    latencies: Vec<f64>,
}

impl Tally {
    /// Counts an acknowledgement; `counts` while the case is measured.
    pub(super) fn add(&mut self, acknowledged: Acknowledged, counts: bool) {
        self.acknowledged += 1;
        if counts {
            self.decisions += acknowledged.decisions as u64;
            self.latencies.push(acknowledged.after.as_secs_f64() * 1e3);
        }
    }
}

/// What the server's process took.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Usage {
    /// Seconds of CPU while acknowledgements counted.
    pub(super) cpu: f64,
    /// Bytes resident with all actors connected, before the first fragment.
    pub(super) rest: u64,
    /// Most bytes resident.
    pub(super) peak: u64,
}

/// The figures of a case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Figures {
    pub(super) decisions_per_second: f64,
    pub(super) median_ms: f64,
    pub(super) high_ms: f64,
    /// The slowest actor's decisions over those of the median one.
    pub(super) fairness: f64,
    /// Microseconds of CPU of the server for a fragment.
    pub(super) cpu_us: f64,
    pub(super) rest: u64,
    pub(super) peak: u64,
    pub(super) sent: u64,
    pub(super) acknowledged: u64,
}

impl Figures {
    /// Of all actors' tallies over `seconds`.
    pub(super) fn new(tallies: &[Tally], seconds: f64, usage: Usage) -> Self {
        let shares: Vec<f64> = tallies.iter().map(|tally| tally.decisions as f64).collect();
        let latencies: Vec<f64> = tallies.iter().flat_map(|tally| &tally.latencies).copied().collect();
        let slowest = shares.iter().copied().fold(f64::INFINITY, f64::min);
        Self {
            decisions_per_second: shares.iter().sum::<f64>() / seconds,
            median_ms: quantile(&latencies, 0.5),
            high_ms: quantile(&latencies, 0.99),
            fairness: slowest / median(&shares),
            cpu_us: usage.cpu * 1e6 / latencies.len() as f64,
            rest: usage.rest,
            peak: usage.peak,
            sent: tallies.iter().map(|tally| tally.sent).sum(),
            acknowledged: tallies.iter().map(|tally| tally.acknowledged).sum(),
        }
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.0} decisions/s, acknowledged after {:.1} ms (99 of 100: {:.1}), slowest over median {:.2}, {:.0} MB",
            self.decisions_per_second,
            self.median_ms,
            self.high_ms,
            self.fairness,
            self.peak as f64 / 1e6
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn tally(fragments: u64) -> Tally {
        let mut tally = Tally { sent: fragments, ..Tally::default() };
        for _ in 0..fragments {
            tally.add(Acknowledged { after: Duration::from_millis(fragments), decisions: 10 }, true);
        }
        tally
    }

    #[test]
    fn an_actor_that_gets_half_of_the_others_share_shows() {
        let usage = Usage { cpu: 0.5, rest: 1, peak: 2 };
        let figures = Figures::new(&[tally(2), tally(4), tally(4)], 2.0, usage);
        assert_eq!(figures.fairness, 0.5);
        assert_eq!(figures.decisions_per_second, 50.0);
        assert_eq!((figures.median_ms, figures.high_ms), (4.0, 4.0));
        assert_eq!(figures.cpu_us, 50_000.0);
        assert_eq!((figures.sent, figures.acknowledged), (10, 10));
    }

    #[test]
    fn what_comes_before_and_after_is_no_part_of_the_rate() {
        let mut late = tally(1);
        late.add(Acknowledged { after: Duration::from_secs(9), decisions: 10 }, false);
        let figures = Figures::new(&[late], 1.0, Usage::default());
        assert_eq!((figures.decisions_per_second, figures.high_ms, figures.acknowledged), (10.0, 1.0, 2));
    }
}
