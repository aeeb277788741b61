//! Wall and CPU time, SUMO's included.

use crate::error::BenchError;
use std::io::{Error, ErrorKind};
use std::path::Path;
use std::time::Instant;

const STAT: &str = "/proc/self/stat";

/// What something took.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Cost {
    /// Seconds on the clock.
    pub(super) wall: f64,
    /// Seconds of CPU of this process and of its children that ended meanwhile, to 0.01 s.
    pub(super) cpu: f64,
}

/// Does the work and tells what it took.
pub(super) fn measured<T>(work: impl FnOnce() -> Result<T, BenchError>) -> Result<(T, Cost), BenchError> {
    let (cpu, start) = (cpu()?, Instant::now());
    let result = work()?;
    let wall = start.elapsed().as_secs_f64();
    Ok((result, Cost { wall, cpu: self::cpu()? - cpu }))
}

fn cpu() -> Result<f64, BenchError> {
    let wrong = |source| BenchError::CpuTime { path: Path::new(STAT).to_owned(), source };
    let text = std::fs::read_to_string(STAT).map_err(wrong)?;
    let ticks =
        ticks(&text).ok_or_else(|| wrong(Error::new(ErrorKind::InvalidData, "it has another form")))?;
    Ok(ticks as f64 / rustix::param::clock_ticks_per_second() as f64)
}

/// User and system time of the process and of its children (proc(5), fields 14 to 17).
fn ticks(stat: &str) -> Option<u64> {
    // The second field is the program's name, which may hold anything, in parentheses.
    let (_, fields) = stat.rsplit_once(") ")?;
    let times: Vec<u64> = fields.split(' ').skip(11).take(4).map_while(|field| field.parse().ok()).collect();
    (times.len() == 4).then(|| times.iter().sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_time_and_that_of_children_is_summed() {
        let stat = "42 (a ) b) S 1 42 42 0 -1 4194304 113 0 0 0 5 7 11 13 20 0 1 0 100 1000 50";
        assert_eq!(ticks(stat), Some(36));
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
        assert!(cost.cpu > 0.0 && cost.wall > 0.0, "{cost:?}");
    }
}
