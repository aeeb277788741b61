//! Wall and CPU time, SUMO's included.

use crate::error::BenchError;
use crate::report::{Better, Row};
use std::io::{Error, ErrorKind};
use std::path::Path;
use std::time::Instant;

const STAT: &str = "/proc/self/stat";

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

/// Adds a row of wall time and one of CPU time, each of the pair of ours and the baseline's whose ratio is the median.
pub(crate) fn compare(case: &str, baseline: &str, pairs: &[(Cost, Cost)], rows: &mut Vec<Row>) {
    for (unit, of) in [("wall", (|cost| cost.wall) as fn(&Cost) -> f64), ("CPU", |cost| cost.cpu)] {
        let pairs = pairs.iter().map(|(ours, theirs)| (of(ours), of(theirs))).collect();
        if let Some((ours, theirs)) = middle_pair(pairs) {
            rows.push(Row::new(format!("{case}, {unit}"), "s", Better::Lower, ours, (baseline, theirs)));
        }
    }
}

/// Of pairs of ours and a baseline's the one whose ratio is the median: two medians of their own may stem from different
/// minutes. Of the middle two of an even number the one that is worse for us; none where there is no pair.
fn middle_pair(mut pairs: Vec<(f64, f64)>) -> Option<(f64, f64)> {
    pairs.sort_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    pairs.get(pairs.len() / 2).copied()
}

/// Seconds of CPU of another process so far, to 0.01 s.
pub(crate) fn cpu_of(pid: u32) -> Result<f64, BenchError> {
    Ok(read(Path::new(&format!("/proc/{pid}/stat")))?[0])
}

/// Seconds of CPU of this process, and of its children that ended.
fn cpu() -> Result<[f64; 2], BenchError> {
    read(Path::new(STAT))
}

fn read(path: &Path) -> Result<[f64; 2], BenchError> {
    let wrong = |source| BenchError::CpuTime { path: path.to_owned(), source };
    let text = std::fs::read_to_string(path).map_err(wrong)?;
    let ticks =
        ticks(&text).ok_or_else(|| wrong(Error::new(ErrorKind::InvalidData, "it has another form")))?;
    let second = rustix::param::clock_ticks_per_second() as f64;
    Ok(ticks.map(|ticks| ticks as f64 / second))
}

/// User and system time of the process and of its children (proc(5), fields 14 to 17).
fn ticks(stat: &str) -> Option<[u64; 2]> {
    // The second field is the program's name, which may hold anything, in parentheses.
    let (_, fields) = stat.rsplit_once(") ")?;
    let times: Vec<u64> = fields.split(' ').skip(11).take(4).map_while(|field| field.parse().ok()).collect();
    let [user, system, child_user, child_system] = times.try_into().ok()?;
    Some([user + system, child_user + child_system])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_time_and_that_of_children_is_read() {
        let stat = "42 (a ) b) S 1 42 42 0 -1 4194304 113 0 0 0 5 7 11 13 20 0 1 0 100 1000 50";
        assert_eq!(ticks(stat), Some([12, 24]));
        assert_eq!(ticks("42 (a) S 1"), None);
    }

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
}
