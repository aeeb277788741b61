//! Whose CPU time it is: every thread of every process below one, sorted by what it does.

use cross_support::proc::{Stat, family, threads};
use std::collections::HashMap;

/// What CPU time of a training goes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Part {
    /// SUMO simulating, and answering.
    Sumo,
    /// The learner's updates: libtorch, and the loops that stand in for it.
    Update,
    /// The actors' simulator threads: decisions of the policy, TraCI, observations, recording.
    Simulator,
    /// Everything that talks gRPC or HTTP: serialisation, validation, sockets.
    Wire,
    /// The supervisor, and whatever else there is.
    Rest,
}

impl Part {
    /// All, in the order of a report.
    pub(super) const ALL: [Self; 5] = [Self::Sumo, Self::Update, Self::Simulator, Self::Wire, Self::Rest];

    /// In words.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Sumo => "SUMO",
            Self::Update => "updates (libtorch and its loops)",
            Self::Simulator => "actors' decisions, TraCI, recording",
            Self::Wire => "gRPC and metrics",
            Self::Rest => "the rest",
        }
    }

    /// Whether this is the work itself, and not what it costs to have it done.
    pub(super) fn is_work(self) -> bool {
        matches!(self, Self::Sumo | Self::Update)
    }

    /// By the names of process and thread, as the kernel has them.
    fn of(process: &str, thread: &str) -> Self {
        match (process, thread) {
            ("sumo", _) => Self::Sumo,
            // libtorch's own threads, if it has any, carry the name of the thread that started them.
            ("cross-learner", "trainer") => Self::Update,
            ("cross-actor", "simulator") => Self::Simulator,
            ("cross-learner" | "cross-actor", thread) if thread.starts_with("tokio-") => Self::Wire,
            _ => Self::Rest,
        }
    }
}

/// Clock ticks that each thread has used, by process and thread.
#[derive(Debug, Clone, Default)]
pub(super) struct Ticks(HashMap<(u32, u32), (u64, Part)>);

impl Ticks {
    /// Those of all processes below `root`, itself included.
    pub(super) fn below(root: u32) -> Self {
        let mut ticks = HashMap::new();
        for process in family(root) {
            let Some(Stat { name, .. }) = Stat::of(process) else { continue };
            for (thread, stat) in threads(process) {
                ticks.insert((process, thread), (stat.ticks, Part::of(&name, &stat.name)));
            }
        }
        Self(ticks)
    }

    /// Ticks used by each part, in the order of [`Part::ALL`], since `before`. A thread that began since counts in full;
    /// what one used that ended since is lost, so that the two must not be far apart.
    pub(super) fn since(&self, before: &Self) -> [u64; 5] {
        Part::ALL.map(|part| {
            let own = self.0.iter().filter(|(_, (_, of))| *of == part);
            own.map(|(key, (now, _))| now.saturating_sub(before.0.get(key).map_or(0, |(then, _)| *then)))
                .sum()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_told_by_process_and_name() {
        assert_eq!(Part::of("cross-learner", "trainer"), Part::Update);
        assert_eq!(Part::of("cross-actor", "tokio-rt-worker"), Part::Wire);
        assert_eq!(Part::of("cross", "tokio-rt-worker"), Part::Rest);
    }

    #[test]
    fn work_of_this_process_is_seen_in_its_thread() {
        let (own, before) = (std::process::id(), Ticks::below(std::process::id()));
        let begun = std::time::Instant::now();
        while Ticks::below(own).since(&before).iter().sum::<u64>() == 0 {
            assert!(begun.elapsed().as_secs() < 60, "a minute of work does not show");
            std::hint::black_box((0..1_000_000u64).map(std::hint::black_box).sum::<u64>());
        }
    }
}
