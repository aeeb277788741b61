//! Which of this process's threads the CPU time goes to, and how much to its child processes.
//!
//! A learner's `trainer` computes updates, an actor's `simulator` decides and talks to SUMO, its child is SUMO; everything
//! else is the wire. What is left of the cores' time was idle or somebody else's.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::sync::{Mutex, PoisonError};

/// Most names that are told apart; threads of further names count together.
const MOST_NAMES: usize = 16;
const OTHERS: &str = "other";
/// What child processes are called, running and ended ones together.
const CHILDREN: &str = "child processes";

/// Ticks of threads and children as of the last look: what one had used counts after it has ended, too.
static SEEN: Mutex<Option<Seen>> = Mutex::new(None);

/// The `cross_thread_cpu_seconds_total` metric in Prometheus' text format; nothing where the kernel does not tell.
#[must_use]
pub(crate) fn metrics() -> String {
    // A panic while it was held leaves counts that are at worst a look old.
    let mut seen = SEEN.lock().unwrap_or_else(PoisonError::into_inner);
    let seen = seen.get_or_insert_default();
    seen.look(threads(), children());
    render(&seen.by_name(), rustix::param::clock_ticks_per_second() as f64)
}

/// A thread or a child process: its id, and the time at which it began, since ids are used again.
type Key = (u32, u64);

#[derive(Debug, Default)]
struct Seen {
    alive: HashMap<Key, (String, u64)>,
    ended: BTreeMap<String, u64>,
}

impl Seen {
    fn look(&mut self, threads: Vec<(Key, String, u64)>, children: Vec<(Key, u64)>) {
        let children = children.into_iter().map(|(key, ticks)| (key, CHILDREN.to_owned(), ticks));
        let now: HashMap<Key, (String, u64)> =
            threads.into_iter().chain(children).map(|(key, name, ticks)| (key, (name, ticks))).collect();
        for (key, (name, ticks)) in std::mem::replace(&mut self.alive, now) {
            if !self.alive.contains_key(&key) {
                *self.ended.entry(name).or_default() += ticks;
            }
        }
    }

    fn by_name(&self) -> BTreeMap<&str, u64> {
        let mut sums: BTreeMap<&str, u64> = BTreeMap::new();
        for (name, ticks) in self.alive.values().map(|(name, ticks)| (name, ticks)).chain(&self.ended) {
            let known = sums.contains_key(name.as_str()) || sums.len() < MOST_NAMES;
            *sums.entry(if known { name } else { OTHERS }).or_default() += ticks;
        }
        sums
    }
}

fn render(sums: &BTreeMap<&str, u64>, ticks_per_second: f64) -> String {
    const NAME: &str = "cross_thread_cpu_seconds_total";
    if sums.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "# HELP {NAME} CPU time, user and system, by name of thread; child processes as one, seconds\n# TYPE {NAME} counter\n"
    );
    for (thread, ticks) in sums {
        let thread = thread.replace(['\\', '"', '\n'], "_");
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{NAME}{{thread=\"{thread}\"}} {}", *ticks as f64 / ticks_per_second);
    }
    text
}

/// This process's threads: key, name, ticks.
fn threads() -> Vec<(Key, String, u64)> {
    let thread = |id: u32| {
        let stat = std::fs::read_to_string(format!("/proc/self/task/{id}/stat")).ok()?;
        let (name, start, ticks) = parse(&stat)?;
        Some(((id, start), name, ticks))
    };
    ids("/proc/self/task").into_iter().filter_map(thread).collect()
}

/// Its child processes: key, ticks.
fn children() -> Vec<(Key, u64)> {
    let of_thread = |id: u32| {
        // A file of its own that not every kernel has.
        let text = std::fs::read_to_string(format!("/proc/self/task/{id}/children")).unwrap_or_default();
        text.split_whitespace().filter_map(|id| id.parse().ok()).collect::<Vec<u32>>()
    };
    let child = |id: u32| {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        let (_, start, ticks) = parse(&stat)?;
        Some(((id, start), ticks))
    };
    ids("/proc/self/task").into_iter().flat_map(of_thread).filter_map(child).collect()
}

fn ids(folder: &str) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
}

/// Name, start and ticks used, from a `stat` file (proc(5), fields 2, 22, and 14 and 15).
fn parse(stat: &str) -> Option<(String, u64, u64)> {
    // The name, in parentheses, may hold anything.
    let (front, rest) = stat.rsplit_once(") ")?;
    let (_, name) = front.split_once('(')?;
    let fields: Vec<&str> = rest.split(' ').collect();
    let field = |number: usize| fields.get(number - 3)?.trim_end().parse::<u64>().ok();
    Some((name.to_owned(), field(22)?, field(14)? + field(15)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_ended_keeps_what_it_had_used() {
        let mut seen = Seen::default();
        let thread = |id, start, ticks| ((id, start), "worker".to_owned(), ticks);
        seen.look(vec![thread(1, 5, 10), thread(2, 6, 3)], vec![((9, 7), 100)]);
        assert_eq!(seen.by_name(), BTreeMap::from([("child processes", 100), ("worker", 13)]));
        // Thread 2 has ended, and another has its id; so with the child.
        seen.look(vec![thread(1, 5, 11), thread(2, 60, 1)], vec![((9, 70), 1)]);
        assert_eq!(seen.by_name(), BTreeMap::from([("child processes", 101), ("worker", 15)]));
    }

    #[test]
    fn names_are_bounded() {
        let mut seen = Seen::default();
        let thread = |id: u32| ((id, 0), format!("t{id:03}"), 1);
        seen.look((0..100).map(thread).collect(), Vec::new());
        let sums = seen.by_name();
        assert_eq!((sums.len(), sums.values().sum::<u64>()), (MOST_NAMES + 1, 100));
    }

    #[test]
    fn a_name_may_hold_anything() {
        let numbers: Vec<String> = (4..=52).map(|number| number.to_string()).collect();
        let stat = format!("7 (a) \"b ( c) R {}\n", numbers.join(" "));
        assert_eq!(parse(&stat), Some(("a) \"b ( c".to_owned(), 22, 29)));
        assert_eq!(parse("7 (a"), None);
        let text = render(&BTreeMap::from([("a\"b", 150)]), 100.0);
        assert!(text.ends_with("cross_thread_cpu_seconds_total{thread=\"a_b\"} 1.5\n"), "{text}");
        assert_eq!(render(&BTreeMap::new(), 100.0), "");
    }

    #[test]
    fn this_process_has_threads() {
        assert!(metrics().contains("cross_thread_cpu_seconds_total{thread="), "{}", metrics());
    }
}
