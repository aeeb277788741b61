//! Which experts and clusters of a learned policy are active in an episode: when, and at which intersection.

use cross_model::Routing;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, PoisonError};

/// Seconds over which shares are averaged.
pub(crate) const INTERVAL_SECONDS: f64 = 60.0;

/// Shares of an episode. Each inner list sums to 1; there are none where the policy has no such part.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct EpisodeRouting {
    pub(crate) experts: Shares,
    pub(crate) clusters: Shares,
}

/// Shares of the experts or of the clusters.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Shares {
    /// Of each minute, mean over the intersections.
    pub(crate) over_time: Vec<Vec<f64>>,
    /// Of each intersection in layout order, mean over the episode.
    pub(crate) by_agent: Vec<Vec<f64>>,
}

/// What is added up while an episode runs; shared by the controller, which writes, and whoever wants the result.
#[derive(Debug, Clone, Default)]
pub(crate) struct RoutingLog(Arc<Mutex<Sums>>);

#[derive(Debug, Default)]
struct Sums {
    begin: Option<f64>,
    experts: Table,
    clusters: Table,
}

/// Sums of shares by minute and by intersection.
#[derive(Debug, Default)]
struct Table {
    over_time: Vec<Vec<f64>>,
    by_agent: Vec<Vec<f64>>,
}

impl RoutingLog {
    /// Forgets what was added: another episode begins.
    pub(crate) fn clear(&self) {
        *self.lock() = Sums::default();
    }

    /// Adds a decision at a simulated time in seconds, of so many agents.
    pub(crate) fn add(&self, time: f64, agents: usize, routing: &Routing) {
        let mut sums = self.lock();
        let begin = *sums.begin.get_or_insert(time);
        // Time goes forward, so that this is no less than 0.
        let interval = ((time - begin) / INTERVAL_SECONDS) as usize;
        sums.experts.add(interval, agents, &routing.experts);
        sums.clusters.add(interval, agents, &routing.clusters);
    }

    /// The shares of what was added.
    pub(crate) fn shares(&self) -> EpisodeRouting {
        let sums = self.lock();
        EpisodeRouting { experts: sums.experts.shares(), clusters: sums.clusters.shares() }
    }

    /// A panic elsewhere leaves sums that are sums all the same.
    fn lock(&self) -> std::sync::MutexGuard<'_, Sums> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    /// Adds shares `[agents, width]`, row-major.
    fn add(&mut self, interval: usize, agents: usize, shares: &[f32]) {
        let width = shares.len() / agents.max(1);
        if width == 0 {
            return;
        }
        grow(&mut self.over_time, interval + 1, width);
        grow(&mut self.by_agent, agents, width);
        for (own, by_agent) in shares.chunks_exact(width).zip(&mut self.by_agent) {
            for sums in [&mut self.over_time[interval], by_agent] {
                for (sum, share) in sums.iter_mut().zip(own) {
                    *sum += f64::from(*share);
                }
            }
        }
    }

    fn shares(&self) -> Shares {
        let all = |sums: &[Vec<f64>]| sums.iter().map(|sums| normalised(sums)).collect();
        Shares { over_time: all(&self.over_time), by_agent: all(&self.by_agent) }
    }
}

fn grow(rows: &mut Vec<Vec<f64>>, to: usize, width: usize) {
    if rows.len() < to {
        rows.resize(to, vec![0.0; width]);
    }
}

/// Shares of their sum, to four decimals, which a picture does not show.
fn normalised(sums: &[f64]) -> Vec<f64> {
    let total: f64 = sums.iter().sum();
    sums.iter().map(|sum| if total > 0.0 { (sum / total * 1e4).round() / 1e4 } else { 0.0 }).collect()
}

/// The mean of the same shares in several episodes.
pub(crate) fn mean<'s>(episodes: impl Iterator<Item = &'s Vec<Vec<f64>>>) -> Vec<Vec<f64>> {
    let mut sums: Vec<Vec<f64>> = Vec::new();
    for rows in episodes {
        for (at, row) in rows.iter().enumerate() {
            grow(&mut sums, at + 1, row.len());
            sums[at].iter_mut().zip(row).for_each(|(sum, share)| *sum += share);
        }
    }
    sums.iter().map(|sums| normalised(sums)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two agents, two experts, no clusters.
    fn decision(first: [f32; 2], second: [f32; 2]) -> Routing {
        Routing { experts: [first, second].concat(), clusters: Vec::new() }
    }

    #[test]
    fn shares_are_told_by_minute_and_by_intersection() {
        let log = RoutingLog::default();
        log.add(1000.0, 2, &decision([1.0, 0.0], [0.5, 0.5]));
        log.add(1059.0, 2, &decision([1.0, 0.0], [0.5, 0.5]));
        log.add(1060.0, 2, &decision([0.0, 1.0], [0.5, 0.5]));
        let shares = log.shares();
        assert_eq!(shares.experts.over_time, [[0.75, 0.25], [0.25, 0.75]]);
        assert_eq!(shares.experts.by_agent, [[0.6667, 0.3333], [0.5, 0.5]]);
        assert_eq!(shares.clusters, Shares::default());
        log.clear();
        assert_eq!(log.shares(), EpisodeRouting::default());
    }

    #[test]
    fn several_episodes_have_a_mean() {
        let one = vec![vec![1.0, 0.0], vec![0.0, 1.0]];
        let other = vec![vec![0.0, 1.0]];
        assert_eq!(mean([&one, &other].into_iter()), [[0.5, 0.5], [0.0, 1.0]]);
        assert!(mean([].into_iter()).is_empty());
    }
}
