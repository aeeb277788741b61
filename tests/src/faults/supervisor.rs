//! Starts a process again when it ends, as an orchestrator would.

use crate::processes;
use rustix::process::Signal;
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

/// Pause before the first restart; doubles with each that did not help, as Docker's does.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(2);
/// Whoever has run for this long has started well.
const WELL: Duration = Duration::from_secs(10);

type Start = Box<dyn FnMut() -> Command>;

/// A process that is kept running.
pub(super) struct Service {
    name: String,
    start: Start,
    child: Option<Child>,
    since: Instant,
    pause: Duration,
    next: Instant,
    lives: u32,
    /// Whether its end is its last.
    held: bool,
    /// Whether it was killed by the suite since it was started.
    struck: bool,
}

/// The end of a process.
#[derive(Debug, Clone)]
pub(super) struct Exit {
    /// Of which service.
    pub name: String,
    /// Exit code, or none if a signal ended it.
    pub code: Option<i32>,
    /// How it ended, in words.
    pub how: String,
    /// Whether the suite had signalled it.
    pub struck: bool,
}

impl Exit {
    /// Whether nobody asked it to end. At the end of a run (`ending`) training is complete, and all end well by themselves.
    pub(super) fn by_itself(&self, ending: bool) -> bool {
        let ends_well = ending && self.code == Some(0);
        !self.struck && !ends_well
    }
}

impl std::fmt::Display for Exit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ended with {}", self.name, self.how)
    }
}

impl Service {
    pub(super) fn new(name: &str, start: impl FnMut() -> Command + 'static) -> Self {
        Self {
            name: name.to_owned(),
            start: Box::new(start),
            child: None,
            since: Instant::now(),
            pause: FIRST_PAUSE,
            next: Instant::now(),
            lives: 0,
            held: false,
            struck: false,
        }
    }

    /// Starts what is due, and tells if the process has ended.
    pub(super) fn look(&mut self) -> Option<Exit> {
        let now = Instant::now();
        if self.child.is_none() && !self.held && now >= self.next {
            self.child = Some((self.start)().spawn().unwrap());
            self.since = now;
            self.lives += 1;
            self.struck = false;
        }
        let status = self.child.as_mut()?.try_wait().unwrap()?;
        Some(self.ended(status))
    }

    fn ended(&mut self, status: ExitStatus) -> Exit {
        self.child = None;
        if self.since.elapsed() >= WELL {
            self.pause = FIRST_PAUSE;
        }
        self.next = Instant::now() + self.pause;
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
        Exit { name: self.name.clone(), code: status.code(), how: status.to_string(), struck: self.struck }
    }

    /// Its process, while there is one.
    pub(super) fn pid(&self) -> Option<i32> {
        self.child.as_ref().map(|child| i32::try_from(child.id()).unwrap())
    }

    /// How often it was started.
    pub(super) fn lives(&self) -> u32 {
        self.lives
    }

    /// Signals it; whether it was there.
    pub(super) fn signal(&mut self, signal: Signal) -> bool {
        let Some(pid) = self.pid() else { return false };
        self.struck |= signal == Signal::KILL || signal == Signal::TERM;
        processes::send(pid, signal)
    }

    /// Ends are final from now on, or no longer.
    pub(super) fn hold(&mut self, held: bool) {
        self.held = held;
        if !held {
            self.next = Instant::now();
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_good_end_that_nobody_asked_for_is_one_too_many() {
        let exit = |code, struck| Exit { name: "actor-0".to_owned(), code, how: String::new(), struck };
        assert!(exit(Some(0), false).by_itself(false));
        assert!(!exit(Some(0), false).by_itself(true));
        assert!(exit(Some(1), false).by_itself(true));
        assert!(exit(None, false).by_itself(true));
        assert!(!exit(None, true).by_itself(false));
    }
}
