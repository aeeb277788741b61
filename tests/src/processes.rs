//! Processes of a run, as `/proc` shows them.

use rustix::process::{Pid, Signal, kill_process};
use std::path::Path;
use std::time::{Duration, Instant};

/// How long processes may take to be gone after their run ended, however it ended.
const GONE_WITHIN: Duration = Duration::from_secs(5);

/// A process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Process id.
    pub pid: i32,
    /// Arguments, the program first.
    pub arguments: Vec<String>,
}

impl Found {
    /// File name of the program.
    #[must_use]
    pub fn program(&self) -> &str {
        self.arguments.first().and_then(|path| path.rsplit('/').next()).unwrap_or("")
    }

    /// The value that follows an option.
    #[must_use]
    pub fn option(&self, name: &str) -> Option<&str> {
        let at = self.arguments.iter().position(|argument| argument == name)?;
        self.arguments.get(at + 1).map(String::as_str)
    }
}

/// Every live process that has `marker` in its environment or its arguments, other than this one.
///
/// Children inherit the environment, so a marker set on the first process of a run finds all of them, whoever their
/// parent has become.
#[must_use]
pub fn marked(marker: &str) -> Vec<Found> {
    let own = std::process::id().to_string();
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").unwrap().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Ok(pid) = name.parse::<i32>() else { continue };
        if name == own || is_dead(&entry.path()) {
            continue;
        }
        // A process may end between being listed and being read.
        let read = |file: &str| std::fs::read(entry.path().join(file)).unwrap_or_default();
        let (environment, arguments) = (read("environ"), read("cmdline"));
        if contains(&environment, marker) || contains(&arguments, marker) {
            let arguments = arguments.split(|&byte| byte == 0).filter(|part| !part.is_empty());
            let arguments = arguments.map(|part| String::from_utf8_lossy(part).into_owned()).collect();
            found.push(Found { pid, arguments });
        }
    }
    found
}

/// The marked processes of this program.
#[must_use]
pub fn of_program(marker: &str, program: &str) -> Vec<Found> {
    marked(marker).into_iter().filter(|process| process.program() == program).collect()
}

/// SIGKILL; whether the process was there to be killed.
#[must_use]
pub fn kill(pid: i32) -> bool {
    send(pid, Signal::KILL)
}

/// Sends a signal; whether the process was there.
#[must_use]
pub fn send(pid: i32, signal: Signal) -> bool {
    Pid::from_raw(pid).is_some_and(|pid| kill_process(pid, signal).is_ok())
}

/// Asserts that no process of a run outlives it by more than five seconds.
///
/// # Panics
/// Names what is left.
pub fn assert_none_left(marker: &str) {
    let end = Instant::now() + GONE_WITHIN;
    loop {
        let left = marked(marker);
        if left.is_empty() {
            return;
        }
        assert!(
            Instant::now() < end,
            "still there {} s after the run ended: {left:?}",
            GONE_WITHIN.as_secs()
        );
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A zombie has ended; it only waits for its parent to notice.
fn is_dead(process: &Path) -> bool {
    let Ok(stat) = std::fs::read_to_string(process.join("stat")) else { return true };
    // The state follows the program's name, which is in parentheses and may hold anything.
    let state = stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().next());
    matches!(state, Some("Z" | "X") | None)
}

fn contains(haystack: &[u8], needle: &str) -> bool {
    haystack.windows(needle.len()).any(|window| window == needle.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marked_process_is_found_by_its_environment_until_it_ends() {
        let marker = format!("marker-{}", std::process::id());
        let mut child =
            std::process::Command::new("sleep").arg("1000").env("CROSS_TEST_RUN", &marker).spawn().unwrap();
        let found = crate::wait::until("the child", || of_program(&marker, "sleep").pop());
        assert_eq!(found.pid, i32::try_from(child.id()).unwrap());
        assert!(kill(found.pid));
        child.wait().unwrap();
        assert_none_left(&marker);
    }
}
