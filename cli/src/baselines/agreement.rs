//! Whether two measurements of the same rule agree.

use cross_sim::metrics::Metric;
use serde::Serialize;

/// How far two means may lie apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Allowed {
    /// This share of the other's mean, or this much, whichever is more.
    Apart { relative: f64, absolute: f64 },
    /// Our mean between the other's lowest and highest seed: for traffic so chaotic that means of few seeds say little.
    Spread,
}

/// What counts as agreement on a scenario of the paper; none for metrics and scenarios without a measure.
///
/// The free-flowing scenarios repeat to a few per cent over seeds, the congested arterial to twice that.
pub(crate) fn allowed(scenario: &str, metric: Metric) -> Option<Allowed> {
    let (relative, absolute) = match metric {
        Metric::QueueLength => (0.03, 0.02),
        Metric::Speed => (0.01, 0.0),
        Metric::TripTime => (0.02, 0.0),
        Metric::TripDelay => (0.04, 0.0),
        _ => return None,
    };
    match scenario {
        "grid5x5" => Some(Allowed::Spread),
        "arterial4x4" => Some(Allowed::Apart { relative: 2.0 * relative, absolute: 2.0 * absolute }),
        "grid4x4" | "jinan1" | "jinan2" | "jinan3" | "hangzhou1" | "hangzhou2" => {
            Some(Allowed::Apart { relative, absolute })
        }
        _ => None,
    }
}

/// A mean, and the lowest and highest of the seeds that it was made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spread {
    pub(crate) mean: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

impl Spread {
    /// Of the means of several seeds; none of none.
    pub(crate) fn of(values: &[f64]) -> Option<Self> {
        let low = values.iter().copied().reduce(f64::min)?;
        let high = values.iter().copied().reduce(f64::max)?;
        Some(Self { mean: values.iter().sum::<f64>() / values.len() as f64, low, high })
    }
}

/// Our mean of a metric beside somebody else's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Comparison {
    /// Key of the metric.
    pub(crate) metric: &'static str,
    pub(crate) ours: f64,
    pub(crate) theirs: f64,
    /// Ours less theirs, as a share of theirs.
    pub(crate) difference: f64,
    /// None where there is no measure of agreement.
    pub(crate) agrees: Option<bool>,
}

impl Comparison {
    /// Compares; `chaotic` is the spread within which a mean has to lie where seeds differ much.
    pub(crate) fn new(
        scenario: &str,
        metric: Metric,
        ours: f64,
        theirs: f64,
        chaotic: Spread,
        mean: f64,
    ) -> Self {
        let agrees = allowed(scenario, metric).map(|allowed| match allowed {
            Allowed::Apart { relative, absolute } => {
                (ours - theirs).abs() <= (relative * theirs.abs()).max(absolute)
            }
            Allowed::Spread => (chaotic.low..=chaotic.high).contains(&mean),
        });
        Self { metric: metric.key(), ours, theirs, difference: (ours - theirs) / theirs, agrees }
    }

    /// With another measurement over the same seeds: where traffic is chaotic, our mean has to lie between its seeds.
    pub(crate) fn with_reference(scenario: &str, metric: Metric, ours: f64, theirs: Spread) -> Self {
        Self::new(scenario, metric, ours, theirs.mean, theirs, ours)
    }

    /// With a published figure of unknown seeds: where traffic is chaotic, it has to lie between our seeds.
    pub(crate) fn with_published(scenario: &str, metric: Metric, ours: Spread, theirs: f64) -> Self {
        Self::new(scenario, metric, ours.mean, theirs, ours, theirs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn single(value: f64) -> Spread {
        Spread { mean: value, low: value, high: value }
    }

    fn agrees(scenario: &str, metric: Metric, ours: f64, theirs: f64) -> Option<bool> {
        Comparison::with_reference(scenario, metric, ours, single(theirs)).agrees
    }

    #[test]
    fn a_queue_may_differ_by_a_share_or_by_an_amount() {
        assert_eq!(agrees("grid4x4", Metric::QueueLength, 0.069, 0.05), Some(true));
        assert_eq!(agrees("grid4x4", Metric::QueueLength, 0.071, 0.05), Some(false));
        assert_eq!(agrees("jinan1", Metric::QueueLength, 2.05, 2.0), Some(true));
        assert_eq!(agrees("jinan1", Metric::QueueLength, 1.93, 2.0), Some(false));
    }

    #[test]
    fn the_arterial_may_differ_twice_as_much() {
        for (metric, share) in [(Metric::Speed, 0.01), (Metric::TripTime, 0.02), (Metric::TripDelay, 0.04)] {
            let ours = 100.0 * (1.0 + 1.5 * share);
            assert_eq!(agrees("hangzhou2", metric, ours, 100.0), Some(false), "{metric:?}");
            assert_eq!(agrees("arterial4x4", metric, ours, 100.0), Some(true), "{metric:?}");
            assert_eq!(agrees("arterial4x4", metric, ours + 100.0 * share, 100.0), Some(false));
        }
    }

    #[test]
    fn chaotic_traffic_agrees_within_the_spread() {
        let theirs = Spread::of(&[2.0, 3.5, 3.0]).unwrap();
        let compare = |ours| Comparison::with_reference("grid5x5", Metric::QueueLength, ours, theirs).agrees;
        assert_eq!((compare(2.1), compare(1.9), compare(3.6)), (Some(true), Some(false), Some(false)));
        let published =
            |figure| Comparison::with_published("grid5x5", Metric::QueueLength, theirs, figure).agrees;
        assert_eq!((published(3.4), published(3.6)), (Some(true), Some(false)));
    }

    #[test]
    fn what_has_no_measure_is_not_judged() {
        assert_eq!(agrees("grid4x4", Metric::TripDuration, 1.0, 2.0), None);
        assert_eq!(agrees("mine", Metric::TripDelay, 1.0, 1.0), None);
        let comparison = Comparison::with_reference("mine", Metric::TripDelay, 1.5, single(2.0));
        assert_eq!(comparison.difference, -0.25);
    }
}
