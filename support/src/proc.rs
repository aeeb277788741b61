//! Processes and threads as Linux tells of them in `/proc` (proc(5)). Elsewhere there is nothing to read.

use std::path::Path;

/// A line of a `stat` file, of a process or of one of its threads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stat {
    /// Its name, 15 bytes at most.
    pub name: String,
    /// The parent process.
    pub parent: u32,
    /// CPU time so far, user and system, in [clock ticks](rustix::param::clock_ticks_per_second).
    pub ticks: u64,
    /// The same of its child processes that have ended.
    pub ended_children_ticks: u64,
    /// When it began, in ticks since the machine started: ids are used again, id and beginning together are not.
    pub began: u64,
}

impl Stat {
    /// Reads `/proc/PROCESS/stat`; `None` if it has ended.
    #[must_use]
    pub fn of(process: u32) -> Option<Self> {
        Self::read(Path::new(&format!("/proc/{process}/stat")))
    }

    /// Reads a `stat` file.
    #[must_use]
    pub fn read(path: &Path) -> Option<Self> {
        Self::parse(&std::fs::read_to_string(path).ok()?)
    }

    /// Reads the line.
    #[must_use]
    pub fn parse(line: &str) -> Option<Self> {
        // The name, in parentheses, may hold anything; the third field follows it. Numbered as in proc(5).
        let (front, rest) = line.rsplit_once(") ")?;
        let fields: Vec<&str> = rest.split_whitespace().collect();
        let field = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
        Some(Self {
            name: front.split_once('(')?.1.to_owned(),
            parent: field(4)?.try_into().ok()?,
            ticks: field(14)? + field(15)?,
            ended_children_ticks: field(16)? + field(17)?,
            began: field(22)?,
        })
    }
}

/// The threads of a process that run now, by id.
#[must_use]
pub fn threads(process: u32) -> Vec<(u32, Stat)> {
    let folder = format!("/proc/{process}/task");
    let thread = |id: u32| Some((id, Stat::read(Path::new(&format!("{folder}/{id}/stat")))?));
    numbers(Path::new(&folder)).into_iter().filter_map(thread).collect()
}

/// The child processes of a process that run now, by id; of the children's children none.
#[must_use]
pub fn children(process: u32) -> Vec<(u32, Stat)> {
    processes().into_iter().filter(|(_, stat)| stat.parent == process).collect()
}

/// A process and all below it, by id.
#[must_use]
pub fn family(process: u32) -> Vec<u32> {
    let all: Vec<(u32, u32)> = processes().into_iter().map(|(id, stat)| (id, stat.parent)).collect();
    below(process, &all)
}

/// All processes that run now, by id.
fn processes() -> Vec<(u32, Stat)> {
    numbers(Path::new("/proc")).into_iter().filter_map(|id| Some((id, Stat::of(id)?))).collect()
}

fn below(process: u32, parents: &[(u32, u32)]) -> Vec<u32> {
    let mut found = vec![process];
    let mut next = 0;
    while let Some(&parent) = found.get(next) {
        found.extend(parents.iter().filter(|(_, own)| *own == parent).map(|(child, _)| *child));
        next += 1;
    }
    found
}

/// Entries of a folder that are numbers.
fn numbers(folder: &Path) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_may_hold_anything_and_shifts_nothing() {
        let numbers: Vec<String> = (4..=52).map(|number| number.to_string()).collect();
        let line = format!("7 (a) \"b ( c) R {}\n", numbers.join(" "));
        let stat = Stat::parse(&line).unwrap();
        assert_eq!((stat.name.as_str(), stat.parent, stat.began), ("a) \"b ( c", 4, 22));
        assert_eq!((stat.ticks, stat.ended_children_ticks), (14 + 15, 16 + 17));
        for broken in ["", "7 (a", "7 (a) R 1", "7 (a) R x"] {
            assert_eq!(Stat::parse(broken), None, "{broken:?}");
        }
    }

    #[test]
    fn a_family_is_found_over_generations() {
        let parents = [(1, 0), (5, 1), (6, 5), (7, 6), (8, 1), (9, 6)];
        assert_eq!(below(5, &parents), [5, 6, 7, 9]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_its_threads_and_its_child_are_seen() {
        let mut child = std::process::Command::new("sleep").arg("1000").spawn().unwrap();
        let (own, id) = (std::process::id(), child.id());
        assert!(threads(own).iter().any(|(thread, _)| *thread == own));
        assert!(children(own).iter().any(|(found, _)| *found == id));
        assert!(family(own).contains(&id) && family(own).contains(&own));
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(Stat::of(id).is_none() && !family(own).contains(&id));
    }
}
