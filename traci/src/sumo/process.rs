//! A child process that is watched, and reaped whatever happens.

use super::output::{Keep, Output};
use super::spawn::spawn;
use crate::error::Evidence;
use std::io;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long the last lines may take to arrive once the process has ended.
const OUTPUT_PATIENCE: Duration = Duration::from_millis(500);
/// How long a killed process may take to disappear before the wait for it is given up.
const KILL_PATIENCE: Duration = Duration::from_secs(5);

/// A running or ended child. Dropping it kills and reaps it.
#[derive(Debug)]
pub(crate) struct Process {
    pid: u32,
    child: Mutex<Child>,
    output: Arc<Output>,
}

impl Process {
    /// Starts `command`; its output is collected.
    pub(crate) fn start(mut command: Command) -> io::Result<Self> {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = spawn(command)?;
        let pipes = (child.stdout.take(), child.stderr.take());
        let process = Self { pid: child.id(), child: Mutex::new(child), output: Arc::default() };
        // From here on an error drops `process`, which kills the child.
        if let Some(stdout) = pipes.0 {
            process.output.read("sumo-stdout", stdout, Keep::Errors)?;
        }
        if let Some(stderr) = pipes.1 {
            process.output.read("sumo-stderr", stderr, Keep::All)?;
        }
        Ok(process)
    }

    /// Runs `command` to its end and gives the first line it printed on stdout.
    pub(crate) fn first_line(mut command: Command, patience: Duration) -> io::Result<(Self, Option<String>)> {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = spawn(command)?;
        let pipes = (child.stdout.take(), child.stderr.take());
        let process = Self { pid: child.id(), child: Mutex::new(child), output: Arc::default() };
        if let Some(stderr) = pipes.1 {
            process.output.read("sumo-stderr", stderr, Keep::All)?;
        }
        let head = Arc::new(Output::default());
        if let Some(stdout) = pipes.0 {
            head.read("sumo-stdout", stdout, Keep::All)?;
        }
        if process.wait(patience).is_none() {
            return Err(io::Error::new(
                io::ErrorKind::TimedOut,
                format!("it did not end within {patience:?}"),
            ));
        }
        // The line is what all this is for: on a busy machine whoever reads it may come late.
        let (lines, _) = head.last_lines(patience);
        Ok((process, lines.into_iter().next()))
    }

    /// Process id.
    pub(crate) fn pid(&self) -> u32 {
        self.pid
    }

    /// How it ended, if it has.
    pub(crate) fn exit(&self) -> Option<ExitStatus> {
        // An error would mean that somebody else reaped our child; then there is nothing to know.
        self.child.lock().unwrap_or_else(PoisonError::into_inner).try_wait().ok().flatten()
    }

    /// Waits for the end, at most for `patience`.
    pub(crate) fn wait(&self, patience: Duration) -> Option<ExitStatus> {
        let begun = Instant::now();
        let mut pause = Duration::from_micros(200);
        loop {
            if let Some(status) = self.exit() {
                return Some(status);
            }
            let left = patience.checked_sub(begun.elapsed())?;
            std::thread::sleep(pause.min(left));
            pause = (pause * 2).min(Duration::from_millis(10));
        }
    }

    /// Kills it if it runs, and reaps it.
    pub(crate) fn kill(&self) -> Option<ExitStatus> {
        if let Some(status) = self.exit() {
            return Some(status);
        }
        // Fails only if the process has ended in between.
        let _ = self.child.lock().unwrap_or_else(PoisonError::into_inner).kill();
        let status = self.wait(KILL_PATIENCE);
        if status.is_none() {
            tracing::warn!(pid = self.pid, "SUMO was killed but has not ended yet");
        }
        status
    }

    /// What is known now, or, if the process is about to end, at most `patience` later.
    pub(crate) fn evidence(&self, patience: Duration) -> Evidence {
        let exit = self.wait(patience);
        let patience = if exit.is_some() { OUTPUT_PATIENCE } else { Duration::ZERO };
        let (last_lines, lines_dropped) = self.output.last_lines(patience);
        Evidence { pid: Some(self.pid), exit, last_lines, lines_dropped }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}
