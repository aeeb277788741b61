//! Wall and CPU time, SUMO's included.

use crate::error::BenchError;
use crate::report::{Better, Row};
use cross_support::proc::Stat;
use std::time::Instant;

/// What something took.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Cost {
    /// Seconds on the clock.
    pub(crate) wall: f64,
    /// Seconds of CPU of this process and of its children that ended meanwhile, to 0.01 s.
    pub(crate) cpu: f64,
    /// Those of this process alone.
    pub(crate) own_cpu: f64,
}

/// Does the work and tells what it took.
pub(crate) fn measured<T>(work: impl FnOnce() -> Result<T, BenchError>) -> Result<(T, Cost), BenchError> {
    let (before, start) = (cpu()?, Instant::now());
    let result = work()?;
    let wall = start.elapsed().as_secs_f64();
    let after = cpu()?;
    let [own_cpu, children] = [after[0] - before[0], after[1] - before[1]];
    Ok((result, Cost { wall, cpu: own_cpu + children, own_cpu }))
}

/// Adds a row of wall time and one of CPU time, each of the pair of ours and the baseline's whose ratio is the median; and,
/// of several pairs, a row of the least wall time of each side, which other programs have disturbed least.
pub(crate) fn compare(case: &str, baseline: &str, pairs: &[(Cost, Cost)], rows: &mut Vec<Row>) {
    for (unit, of) in [("wall", (|cost| cost.wall) as fn(&Cost) -> f64), ("CPU", |cost| cost.cpu)] {
        let pairs = pairs.iter().map(|(ours, theirs)| (of(ours), of(theirs))).collect();
        if let Some((ours, theirs)) = middle_pair(pairs) {
            rows.push(Row::new(format!("{case}, {unit}"), "s", Better::Lower, ours, (baseline, theirs)));
        }
    }
    if pairs.len() > 1 {
        let (ours, theirs) = fastest_of_each(pairs);
        rows.push(Row::new(
            format!("{case}, wall, fastest of each"),
            "s",
            Better::Lower,
            ours,
            (baseline, theirs),
        ));
    }
}

/// Least wall time of ours and of a baseline's, of whichever pairs.
fn fastest_of_each(pairs: &[(Cost, Cost)]) -> (f64, f64) {
    pairs.iter().fold((f64::INFINITY, f64::INFINITY), |(ours, theirs), pair| {
        (ours.min(pair.0.wall), theirs.min(pair.1.wall))
    })
}

/// Of pairs of ours and a baseline's the one whose ratio is the median: two medians of their own may stem from different
/// minutes. Of the middle two of an even number the one that is worse for us; none where there is no pair.
fn middle_pair(mut pairs: Vec<(f64, f64)>) -> Option<(f64, f64)> {
    pairs.sort_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    pairs.get(pairs.len() / 2).copied()
}

/// Seconds of CPU of another process so far, to 0.01 s.
pub(crate) fn cpu_of(pid: u32) -> Result<f64, BenchError> {
    Ok(read(pid)?[0])
}

/// Seconds of CPU of this process, and of its children that ended.
fn cpu() -> Result<[f64; 2], BenchError> {
    read(std::process::id())
}

fn read(pid: u32) -> Result<[f64; 2], BenchError> {
    let stat = Stat::of(pid).ok_or(BenchError::CpuTime { pid })?;
    let second = rustix::param::clock_ticks_per_second() as f64;
    Ok([stat.ticks, stat.ended_children_ticks].map(|ticks| ticks as f64 / second))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_that_ended_counts() {
        let ((), cost) = measured(|| {
            let spin = "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done";
            assert!(std::process::Command::new("sh").args(["-c", spin]).status().unwrap().success());
            Ok(())
        })
        .unwrap();
        assert!(cost.cpu > cost.own_cpu && cost.wall > 0.0, "{cost:?}");
    }

    #[test]
    fn the_pair_of_the_median_ratio_is_one_that_was_measured() {
        assert_eq!(middle_pair(vec![(3.0, 1.0), (1.0, 1.0), (4.0, 2.0)]), Some((4.0, 2.0)));
        assert_eq!(middle_pair(vec![(2.0, 2.0), (1.0, 2.0)]), Some((2.0, 2.0)));
        assert_eq!(middle_pair(vec![]), None);
    }

    #[test]
    fn the_fastest_of_each_side_may_be_of_different_pairs() {
        let pair =
            |ours, theirs| (Cost { wall: ours, ..Cost::default() }, Cost { wall: theirs, ..Cost::default() });
        let mut rows = Vec::new();
        compare("a", "b", &[pair(3.0, 1.0), pair(2.0, 4.0)], &mut rows);
        let fastest = rows.iter().find(|row| row.case == "a, wall, fastest of each").unwrap();
        assert_eq!((fastest.ours, fastest.baseline), (2.0, 1.0));
        rows.clear();
        compare("a", "b", &[pair(3.0, 1.0)], &mut rows);
        assert_eq!(rows.len(), 2, "one pair has no fastest");
    }
}
