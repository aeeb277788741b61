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
/// Minutes below which there would be nothing to compare: the first five, and a moment at either end of the rest.
pub const LEAST_MINUTES: f64 = 7.0;

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
    /// An invariant that did not hold, or too little seen to say anything, with the ends of all logs.
    pub fn run(&self, mut tell: impl FnMut(&str)) -> Result<Soaked, Box<(Broken, String)>> {
        let setting = Setting {
            actors: self.actors,
            updates: 100_000_000,
            config: self.config.clone(),
            instrumented: false,
            patience: 1,
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
        Soaked::new(samples, self.time).map_err(|seen| Broken::new("the soak measures", seen))
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
    /// Only of what says something: samples enough, of a learner that was there, and that trained to the end.
    fn new(samples: Vec<Sample>, time: Duration) -> Result<Self, String> {
        let settled = samples.iter().position(|sample| sample.at >= SETTLED);
        let settled = settled.ok_or("there is no sample after the first five minutes")?;
        let (measured, due) = (&samples[settled..], time.as_secs() / SAMPLE_EVERY.as_secs());
        // A learner may be too busy to answer now and then.
        if 2 * measured.len() < 3 * MOMENT || 2 * samples.len() as u64 <= due {
            return Err(format!(
                "{} samples of {due}, {} of them after the first five minutes, are too few",
                samples.len(),
                measured.len()
            ));
        }
        if let Some(empty) = measured.iter().find(|sample| sample.learner.resident == 0) {
            return Err(format!("no learner was seen after {:.1} min", empty.at.as_secs_f64() / 60.0));
        }
        let (first, rest) = measured.split_at(measured.len() / 2);
        for part in [first, rest] {
            if let [from, .., to] = part
                && from.updates >= to.updates
            {
                let minutes = [from, to].map(|sample| sample.at.as_secs_f64() / 60.0);
                return Err(format!(
                    "updates stood still at {} from {:.1} to {:.1} min",
                    to.updates, minutes[0], minutes[1]
                ));
            }
        }
        Ok(Self { samples, settled })
    }

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

    fn sample(seconds: u64, resident: u64) -> Sample {
        Sample {
            at: Duration::from_secs(seconds),
            learner: Sizes { resident, ..Sizes::default() },
            actors: Sizes::default(),
            sumos: Sizes::default(),
            updates: seconds,
            decisions: 0,
        }
    }

    fn soaked(samples: impl IntoIterator<Item = Sample>) -> Result<Soaked, String> {
        Soaked::new(samples.into_iter().collect(), Duration::from_secs(20 * 60))
    }

    #[test]
    fn growth_is_that_after_the_first_minutes() {
        let samples = (0..240).map(|n| sample(5 * n, if n < 60 { 1000 + n } else { 2000 + n }));
        let growth = soaked(samples).unwrap().growth();
        // 2066 in the minute after the first five, 2234 in the last.
        assert!((growth - 8.13).abs() < 0.05, "{growth}");
    }

    #[test]
    fn a_soak_that_has_seen_too_little_is_none() {
        let problem = |samples: Vec<Sample>| soaked(samples).unwrap_err();
        assert!(problem(Vec::new()).contains("no sample"));
        assert!(problem((0..59).map(|n| sample(5 * n, 1)).collect()).contains("no sample"));
        assert!(problem((0..77).map(|n| sample(5 * n, 1)).collect()).contains("too few"));
        assert!(problem((0..80).map(|n| sample(15 * n, 1)).collect()).contains("too few"));
        assert!(problem((0..240).map(|n| sample(5 * n, 240 - n - 1)).collect()).contains("no learner"));
    }

    #[test]
    fn a_soak_in_which_nothing_is_learned_is_none() {
        for (from, to) in [(300, 750), (750, 1200)] {
            let still = (0..240).map(|n| {
                let sample = sample(5 * n, 1);
                let updates = if (from..to).contains(&sample.updates) { from } else { sample.updates };
                Sample { updates, ..sample }
            });
            assert!(soaked(still).unwrap_err().contains("stood still"), "{from}");
        }
    }
}
