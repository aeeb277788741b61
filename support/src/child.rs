//! Child processes: started beside this program, logging into a file, gone when this process is.

use crate::options::TLS_VARIABLES;
use std::ffi::OsString;
use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Most bytes of a log that are read to find a process's last words.
const TAIL_BYTES: u64 = 16 * 1024;

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// By itself.
    Code(i32),
    /// By a signal.
    Signal(i32),
}

impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Code(code) => write!(f, "ended with exit code {code}"),
            Self::Signal(signal) => write!(f, "was killed by signal {signal}"),
        }
    }
}

/// Why a process cannot be started.
#[derive(Debug, thiserror::Error)]
pub enum ChildError {
    /// The operating system does not tell where this program is.
    #[error("cannot find the path of this program: {source}")]
    Own {
        /// Why not.
        source: std::io::Error,
    },
    /// Programs of CROSS lie in one folder; this one does not.
    #[error("{} is not there; build the whole project with `make build`", path.display())]
    Missing {
        /// Where it should be.
        path: PathBuf,
    },
    /// There is nowhere to log.
    #[error("cannot open the log {}: {source}", path.display())]
    Log {
        /// The log.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The operating system refused.
    #[error("cannot start {}: {source}", program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
}

/// The program `name` in the directory of this executable.
///
/// # Errors
/// [`ChildError::Missing`] if there is none.
pub fn sibling(name: &str) -> Result<PathBuf, ChildError> {
    let own = std::env::current_exe().map_err(|source| ChildError::Own { source })?;
    let path = own.with_file_name(name);
    if path.is_file() { Ok(path) } else { Err(ChildError::Missing { path }) }
}

/// A child process and its log.
#[derive(Debug)]
pub struct Process {
    child: Child,
    log: PathBuf,
    log_start: u64,
}

impl Process {
    /// Starts `program` with its output appended to `log`.
    ///
    /// The child gets a process group of its own, so that Ctrl-C in a terminal reaches this process alone and the
    /// shutdown keeps its order; and it dies with the calling thread, which must therefore live as long as the run.
    ///
    /// # Errors
    /// [`ChildError`] names the program or the log.
    pub fn start(program: &Path, arguments: &[OsString], log: &Path) -> Result<Self, ChildError> {
        let unusable = |source| ChildError::Log { path: log.to_owned(), source };
        let file = OpenOptions::new().create(true).append(true).open(log).map_err(unusable)?;
        let log_start = file.metadata().map(|metadata| metadata.len()).unwrap_or(0);
        let errors = file.try_clone().map_err(unusable)?;
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::null()).stdout(file).stderr(errors).process_group(0);
        // They are for a cluster; between processes of one machine nothing is encrypted.
        for variable in TLS_VARIABLES {
            command.env_remove(variable);
        }
        die_with_parent(&mut command);
        let child =
            command.spawn().map_err(|source| ChildError::Start { program: program.to_owned(), source })?;
        Ok(Self { child, log: log.to_owned(), log_start })
    }

    /// Its process id.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// How it ended, once it has.
    pub fn ended(&mut self) -> Option<Exit> {
        match self.child.try_wait() {
            Ok(None) => None,
            Ok(Some(status)) => Some(match (status.code(), status.signal()) {
                (Some(code), _) => Exit::Code(code),
                (None, signal) => Exit::Signal(signal.unwrap_or(0)),
            }),
            // Only a child that somebody else reaped cannot be waited for: it has ended, and how is not known.
            Err(_) => Some(Exit::Code(1)),
        }
    }

    /// SIGTERM. A child that has just ended is not yet reaped here, so the id cannot be another process's.
    pub fn terminate(&self) {
        self.signal(rustix::process::Signal::TERM);
    }

    /// SIGKILL.
    pub fn kill(&self) {
        self.signal(rustix::process::Signal::KILL);
    }

    fn signal(&self, signal: rustix::process::Signal) {
        if let Some(pid) = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw) {
            // Fails only if the process has ended, which is what was wanted.
            let _ = rustix::process::kill_process(pid, signal);
        }
    }

    /// The last line it logged, without the program's name in front; `None` if it said nothing.
    #[must_use]
    pub fn last_words(&self) -> Option<String> {
        last_line(&self.log, self.log_start)
    }
}

/// A run that ends early, by an error or a panic, leaves nothing behind.
impl Drop for Process {
    fn drop(&mut self) {
        if self.ended().is_none() {
            self.kill();
            let _ = self.child.wait();
        }
    }
}

/// Has the kernel kill the child when the thread that starts it ends, however that comes about.
fn die_with_parent(command: &mut Command) {
    let parent = rustix::process::getpid();
    let set = move || -> std::io::Result<()> {
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL))?;
        // The parent may have died before the line above.
        if rustix::process::getppid() == Some(parent) {
            Ok(())
        } else {
            Err(std::io::Error::from(rustix::io::Errno::SRCH))
        }
    };
    #[expect(unsafe_code, reason = "only between fork and exec can a child tie its life to its parent's")]
    // SAFETY: the closure makes two system calls; it neither allocates nor locks nor touches the parent's memory, which
    // is all that a forked child of a threaded process must refrain from.
    unsafe {
        command.pre_exec(set);
    }
}

fn last_line(log: &Path, from: u64) -> Option<String> {
    let mut file = File::open(log).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(from.max(length.saturating_sub(TAIL_BYTES)))).ok()?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    let line = text.lines().rev().map(str::trim).find(|line| !line.is_empty())?;
    let line = ["cross-learner: ", "cross-actor: ", "error: "]
        .into_iter()
        .fold(line, |line, prefix| line.strip_prefix(prefix).unwrap_or(line));
    Some(line.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wait(process: &mut Process) -> Exit {
        loop {
            if let Some(exit) = process.ended() {
                return exit;
            }
            std::thread::yield_now();
        }
    }

    fn shell(script: &str, log: &Path) -> Process {
        Process::start(Path::new("/bin/sh"), &["-c".into(), script.into()], log).unwrap()
    }

    #[test]
    fn last_words_are_this_process_s_own() {
        let directory = tempfile::tempdir().unwrap();
        let log = directory.path().join("x.log");
        let mut first = shell("echo first >&2; exit 2", &log);
        assert_eq!(wait(&mut first), Exit::Code(2));
        assert_eq!(first.last_words().as_deref(), Some("first"));
        let mut second = shell("exit 0", &log);
        assert_eq!(wait(&mut second), Exit::Code(0));
        assert_eq!(second.last_words(), None);
        let mut third = shell("echo; echo 'error: no net'; echo", &log);
        wait(&mut third);
        assert_eq!(third.last_words().as_deref(), Some("no net"));
    }

    #[test]
    fn a_dropped_process_is_killed() {
        let directory = tempfile::tempdir().unwrap();
        let process = shell("exec sleep 1000", &directory.path().join("x.log"));
        let path = PathBuf::from(format!("/proc/{}", process.pid()));
        assert!(path.exists());
        drop(process);
        assert!(!path.exists());
    }

    #[test]
    fn a_process_dies_with_the_thread_that_started_it() {
        let directory = tempfile::tempdir().unwrap();
        let log = directory.path().join("x.log");
        let mut process = std::thread::spawn(move || shell("exec sleep 1000", &log)).join().unwrap();
        assert_eq!(wait(&mut process), Exit::Signal(9));
    }
}
