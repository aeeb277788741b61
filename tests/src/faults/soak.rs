//! The soak: a run that nothing disturbs, as a user would run it, and what its processes weigh over the time.

use super::Broken;
use super::observe::Seen;
use super::world::{Setting, World};
use std::time::{Duration, Instant};

/// Until then a learner may grow: libtorch and the allocator take what they need once.
const SETTLED: Duration = Duration::from_secs(5 * 60);
/// Most growth after that, percent of the resident memory.
pub const MOST_GROWTH: f64 = 2.0;
const SAMPLE_EVERY: Duration = Duration::from_secs(5);
/// Samples whose median stands for a moment.
const MOMENT: usize = 12;

/// What to do.
#[derive(Debug, Clone)]
pub struct Soak {
    /// Actors.
    pub actors: usize,
    /// How long.
    pub time: Duration,
    /// Configuration of the run, without `updates`.
    pub config: String,
}

/// The sizes of all processes of one program together.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Processes.
    pub processes: usize,
    /// Resident memory, KiB.
    pub resident: u64,
    /// Open files.
    pub files: usize,
    /// Threads.
    pub threads: u64,
}

/// A moment of the soak.
#[derive(Debug, Clone, Copy)]
struct Sample {
    at: Duration,
    learner: Sizes,
    actors: Sizes,
    sumos: Sizes,
    updates: u64,
    decisions: u64,
}

/// What a soak has shown.
#[derive(Debug, Clone)]
pub struct Soaked {
    samples: Vec<Sample>,
    settled: usize,
}

impl Soak {
    /// Runs it; `tell` gets a line a minute.
    ///
    /// # Errors
    /// An invariant that did not hold, with the ends of all logs.
    pub fn run(&self, mut tell: impl FnMut(&str)) -> Result<Soaked, Box<(Broken, String)>> {
        let setting = Setting {
            actors: self.actors,
            updates: 100_000_000,
            config: self.config.clone(),
            instrumented: false,
        };
        let mut world = World::new(setting);
        let watched = self.watch(&mut world, &mut tell);
        watched.map_err(|broken| Box::new((broken, world.tails(25))))
    }

    fn watch(&self, world: &mut World, tell: &mut impl FnMut(&str)) -> Result<Soaked, Broken> {
        world.until("the first update", 300, |world| {
            world.status().is_some_and(|status| status.updates > 0).then_some(())
        })?;
        let begun = Instant::now();
        let mut samples: Vec<Sample> = Vec::new();
        while begun.elapsed() < self.time {
            world.go_on(SAMPLE_EVERY)?;
            let Some(status) = world.status() else { continue };
            let sample = Sample {
                at: begun.elapsed(),
                learner: sizes(world.processes(), "cross-learner"),
                actors: sizes(world.processes(), "cross-actor"),
                sumos: sizes(world.processes(), "sumo"),
                updates: status.updates,
                decisions: status.decisions,
            };
            let minute = sample.at.as_secs() / 60;
            if samples.last().is_none_or(|last| last.at.as_secs() / 60 < minute) {
                tell(&line(&sample));
            }
            samples.push(sample);
        }
        let settled = samples.iter().position(|sample| sample.at >= SETTLED).unwrap_or(0);
        Ok(Soaked { samples, settled })
    }
}

fn sizes(processes: &[Seen], program: &str) -> Sizes {
    processes.iter().filter(|seen| seen.found.program() == program).fold(Sizes::default(), |sum, seen| {
        Sizes {
            processes: sum.processes + 1,
            resident: sum.resident + seen.resident,
            files: sum.files + seen.files,
            threads: sum.threads + seen.threads,
        }
    })
}

fn line(sample: &Sample) -> String {
    let part = |name: &str, sizes: &Sizes| {
        format!(
            "{} {name} {:.1} MiB, {} files, {} threads",
            sizes.processes,
            sizes.resident as f64 / 1024.0,
            sizes.files,
            sizes.threads
        )
    };
    format!(
        "{:>5.1} min  {} updates, {} decisions; {}; {}; {}",
        sample.at.as_secs_f64() / 60.0,
        sample.updates,
        sample.decisions,
        part("learner", &sample.learner),
        part("actors", &sample.actors),
        part("SUMOs", &sample.sumos)
    )
}

impl Soaked {
    /// Median of the learner's resident memory over a minute from a sample on, KiB.
    fn resident(&self, from: usize) -> f64 {
        let mut sizes: Vec<u64> =
            self.samples.iter().skip(from).take(MOMENT).map(|sample| sample.learner.resident).collect();
        sizes.sort_unstable();
        sizes.get(sizes.len() / 2).map_or(0.0, |&resident| resident as f64)
    }

    /// How much the learner has grown after its first five minutes, percent.
    #[must_use]
    pub fn growth(&self) -> f64 {
        let begin = self.resident(self.settled);
        let end = self.resident(self.samples.len().saturating_sub(MOMENT));
        if begin == 0.0 { 0.0 } else { 100.0 * (end / begin - 1.0) }
    }
}

impl std::fmt::Display for Soaked {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (Some(settled), Some(last)) = (self.samples.get(self.settled), self.samples.last()) else {
            return write!(f, "too short for a single sample");
        };
        let most = self.samples.iter().skip(self.settled).map(|sample| sample.learner.resident).max();
        writeln!(f, "{}\n{}", line(settled), line(last))?;
        write!(
            f,
            "learner: {:.1} MiB in the minute after {:.1} min, {:.1} MiB in the last, {:+.2} %, at most {:.1} MiB in between",
            self.resident(self.settled) / 1024.0,
            settled.at.as_secs_f64() / 60.0,
            self.resident(self.samples.len().saturating_sub(MOMENT)) / 1024.0,
            self.growth(),
            most.unwrap_or_default() as f64 / 1024.0
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_that_after_the_first_minutes() {
        let sample = |seconds: u64, resident| Sample {
            at: Duration::from_secs(seconds),
            learner: Sizes { resident, ..Sizes::default() },
            actors: Sizes::default(),
            sumos: Sizes::default(),
            updates: 0,
            decisions: 0,
        };
        let samples: Vec<Sample> =
            (0..240).map(|n| sample(5 * n, if n < 60 { 1000 + n } else { 2000 + n })).collect();
        let soaked = Soaked { settled: 60, samples };
        // 2066 in the minute after the first five, 2234 in the last.
        assert!((soaked.growth() - 8.13).abs() < 0.05, "{}", soaked.growth());
    }
}
