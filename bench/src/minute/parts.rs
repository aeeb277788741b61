//! Whose CPU time it is: every thread of every process below one, sorted by what it does.

use std::collections::HashMap;
use std::path::Path;

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

    /// By the names of process and thread, as the kernel has them (15 bytes at most).
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
    /// Those of all processes below `root`, itself included. What ends meanwhile is left out.
    pub(super) fn below(root: u32) -> Self {
        let mut ticks = HashMap::new();
        for process in family(root, &parents()) {
            let Some(name) = word(&format!("/proc/{process}/comm")) else { continue };
            for thread in numbers(Path::new(&format!("/proc/{process}/task"))) {
                let folder = format!("/proc/{process}/task/{thread}");
                let used =
                    std::fs::read_to_string(format!("{folder}/stat")).ok().and_then(|stat| used(&stat));
                if let (Some(used), Some(thread_name)) = (used, word(&format!("{folder}/comm"))) {
                    ticks.insert((process, thread), (used, Part::of(&name, &thread_name)));
                }
            }
        }
        Self(ticks)
    }

    /// Ticks used by each part, in the order of [`Part::ALL`], since `before`. A thread that began since counts in full;
    /// one that ended since is lost, so that the two must not be far apart.
    pub(super) fn since(&self, before: &Self) -> [u64; 5] {
        Part::ALL.map(|part| {
            let own = self.0.iter().filter(|(_, (_, of))| *of == part);
            own.map(|(key, (now, _))| now.saturating_sub(before.0.get(key).map_or(0, |(then, _)| *then)))
                .sum()
        })
    }
}

/// Every process with its parent.
fn parents() -> Vec<(u32, u32)> {
    let parent = |process: u32| {
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
        Some((process, fields(&stat)?.nth(1)?.parse().ok()?))
    };
    numbers(Path::new("/proc")).into_iter().filter_map(parent).collect()
}

/// `root` and all below it.
fn family(root: u32, parents: &[(u32, u32)]) -> Vec<u32> {
    let mut found = vec![root];
    let mut next = 0;
    while let Some(&process) = found.get(next) {
        found.extend(parents.iter().filter(|(_, parent)| *parent == process).map(|(child, _)| *child));
        next += 1;
    }
    found
}

/// Entries of a folder that are numbers.
fn numbers(folder: &Path) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
}

fn word(path: &str) -> Option<String> {
    std::fs::read_to_string(path).ok().map(|text| text.trim_end().to_owned())
}

/// Fields of a `stat` file from the third on (proc(5)); the second, in parentheses, may hold anything.
fn fields(stat: &str) -> Option<impl Iterator<Item = &str>> {
    Some(stat.rsplit_once(") ")?.1.split(' '))
}

/// User and system time, fields 14 and 15.
fn used(stat: &str) -> Option<u64> {
    let mut fields = fields(stat)?.skip(11);
    let mut next = || fields.next()?.parse::<u64>().ok();
    Some(next()? + next()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_read_behind_any_name() {
        assert_eq!(used("42 (a ) b) S 1 42 42 0 -1 4194304 113 0 0 0 5 7 11 13 20 0 1 0"), Some(12));
        assert_eq!(used("42 (a"), None);
    }

    #[test]
    fn a_family_is_found_over_generations() {
        let parents = [(1, 0), (5, 1), (6, 5), (7, 6), (8, 1), (9, 6)];
        assert_eq!(family(5, &parents), [5, 6, 7, 9]);
    }

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
