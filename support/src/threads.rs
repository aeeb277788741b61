//! Which of this process's threads the CPU time goes to, and how much to its child processes.
//!
//! A learner's `trainer` computes updates, an actor's `simulator` decides and talks to SUMO, its child is SUMO; everything
//! else is the wire. What is left of the cores' time was idle or somebody else's.

use crate::proc::{Stat, children, threads};
use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::sync::{Mutex, PoisonError};

/// What child processes are called, running and ended ones together.
const CHILDREN: &str = "child processes";

/// Ticks of threads and children as of the last look: what one had used counts after it has ended, too.
static SEEN: Mutex<Option<Seen>> = Mutex::new(None);

/// The `cross_thread_cpu_seconds_total` metric in Prometheus' text format; nothing where the kernel does not tell.
#[must_use]
pub(crate) fn metrics() -> String {
    let own = std::process::id();
    let named = |(id, stat): (u32, Stat)| ((id, stat.began), (stat.name, stat.ticks));
    let child = |(id, stat): (u32, Stat)| ((id, stat.began), (CHILDREN.to_owned(), stat.ticks));
    let now = threads(own).into_iter().map(named).chain(children(own).into_iter().map(child)).collect();
    // A panic while it was held leaves counts that are at worst a look old.
    let mut seen = SEEN.lock().unwrap_or_else(PoisonError::into_inner);
    let seen = seen.get_or_insert_default();
    seen.look(now);
    render(&seen.by_name(), rustix::param::clock_ticks_per_second() as f64)
}

/// Name and ticks of each thread and child process, by id and beginning.
type Alive = HashMap<(u32, u64), (String, u64)>;

#[derive(Debug, Default)]
struct Seen {
    alive: Alive,
    ended: BTreeMap<String, u64>,
}

impl Seen {
    fn look(&mut self, now: Alive) {
        for (key, (name, ticks)) in std::mem::replace(&mut self.alive, now) {
            if !self.alive.contains_key(&key) {
                *self.ended.entry(name).or_default() += ticks;
            }
        }
    }

    /// The names are those that our own code and libraries give: few, and the same every time.
    fn by_name(&self) -> BTreeMap<&str, u64> {
        let mut sums: BTreeMap<&str, u64> = BTreeMap::new();
        for (name, ticks) in self.alive.values().map(|(name, ticks)| (name, ticks)).chain(&self.ended) {
            *sums.entry(name).or_default() += ticks;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_ended_keeps_what_it_had_used() {
        let mut seen = Seen::default();
        let thread = |id, began, ticks| ((id, began), ("worker".to_owned(), ticks));
        let child = |id, began, ticks| ((id, began), (CHILDREN.to_owned(), ticks));
        seen.look(Alive::from([thread(1, 5, 10), thread(2, 6, 3), child(9, 7, 100)]));
        assert_eq!(seen.by_name(), BTreeMap::from([("child processes", 100), ("worker", 13)]));
        // Thread 2 has ended, and another has its id; so with the child.
        seen.look(Alive::from([thread(1, 5, 11), thread(2, 60, 1), child(9, 70, 1)]));
        assert_eq!(seen.by_name(), BTreeMap::from([("child processes", 101), ("worker", 15)]));
    }

    #[test]
    fn a_name_cannot_break_the_line() {
        let text = render(&BTreeMap::from([("a\"b", 150)]), 100.0);
        assert!(text.ends_with("cross_thread_cpu_seconds_total{thread=\"a_b\"} 1.5\n"), "{text}");
        assert_eq!(render(&BTreeMap::new(), 100.0), "");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_has_threads() {
        assert!(metrics().contains("cross_thread_cpu_seconds_total{thread="), "{}", metrics());
    }
}
