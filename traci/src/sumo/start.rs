//! Starting SUMO and connecting to it.

use super::SumoHome;
use super::launch::{Attempt, Words, launch, on_free_port};
use super::port::PortReservation;
use super::process::Process;
use crate::client::Client;
use crate::connection::Connection;
use crate::error::TraciError;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Plain SUMO arguments. [`Sumo::start`] adds `--remote-port`, `--num-clients 1` and, unless it is given,
/// `--no-step-log true`, since nobody reads the progress that SUMO prints each step.
#[derive(Debug, Clone, Default)]
pub struct SumoCommand {
    args: Vec<OsString>,
    directory: Option<PathBuf>,
}

impl SumoCommand {
    /// No arguments yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an argument.
    #[must_use]
    pub fn arg(mut self, arg: impl AsRef<OsStr>) -> Self {
        self.args.push(arg.as_ref().to_owned());
        self
    }

    /// Adds arguments.
    #[must_use]
    pub fn args<A: AsRef<OsStr>>(mut self, args: impl IntoIterator<Item = A>) -> Self {
        self.args.extend(args.into_iter().map(|arg| arg.as_ref().to_owned()));
        self
    }

    /// Adds an option and its value.
    #[must_use]
    pub fn option(self, name: impl AsRef<OsStr>, value: impl AsRef<OsStr>) -> Self {
        self.arg(name).arg(value)
    }

    /// Starts SUMO in this directory rather than in the owner's.
    #[must_use]
    pub fn current_dir(mut self, directory: impl AsRef<Path>) -> Self {
        self.directory = Some(directory.as_ref().to_owned());
        self
    }

    /// The arguments so far.
    pub fn arguments(&self) -> &[OsString] {
        &self.args
    }

    fn has(&self, option: &str) -> bool {
        self.args
            .iter()
            .filter_map(|arg| arg.to_str())
            .any(|arg| arg.strip_prefix(option).is_some_and(|rest| rest.is_empty() || rest.starts_with('=')))
    }

    pub(super) fn command(&self, home: &SumoHome, port: u16) -> Command {
        let mut command = home.command("sumo");
        command.args(&self.args);
        command.arg("--remote-port").arg(port.to_string()).args(["--num-clients", "1"]);
        if !self.has("--no-step-log") {
            command.args(["--no-step-log", "true"]);
        }
        if let Some(directory) = &self.directory {
            command.current_dir(directory);
        }
        command
    }
}

/// How a SUMO ended that was closed in order.
#[derive(Debug, Clone)]
pub struct ExitReport {
    /// Exit status; always success.
    pub status: ExitStatus,
    /// SUMO's last lines on stderr, warnings mostly, oldest first.
    pub last_lines: Vec<String>,
    /// Lines before those, no longer kept.
    pub lines_dropped: u64,
}

/// A running SUMO with the connection to it.
///
/// It is never left behind: dropping this value kills and reaps it, and on Linux the kernel kills it when this process
/// dies in any way, `SIGKILL` included. It may be started on one thread and used or dropped on another.
#[derive(Debug)]
pub struct Sumo {
    process: Arc<Process>,
    client: Client,
    port: u16,
}

impl Sumo {
    /// Starts SUMO on a fresh port and waits until it has loaded its files. `timeout` is the deadline for that, and
    /// for every later call unless [`Client::set_timeout`] changes it. A port that somebody takes in the last moment is
    /// replaced by another.
    ///
    /// # Errors
    /// [`TraciError::Spawn`] with what SUMO printed if it cannot be started or ends while loading,
    /// [`TraciError::Timeout`], [`TraciError::Version`].
    pub fn start(home: &SumoHome, command: &SumoCommand, timeout: Duration) -> Result<Self, TraciError> {
        start_on(home, command, timeout, &mut PortReservation::new)
    }

    /// The connection.
    pub fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// SUMO's process id.
    pub fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// The port it listens on.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Whether the process still runs.
    pub fn is_running(&self) -> bool {
        self.process.exit().is_none()
    }

    /// Closes the connection, waits until SUMO has written its outputs and ended, within the client's timeout, and
    /// kills it if it does not.
    ///
    /// # Errors
    /// [`TraciError::Crashed`] if SUMO ended with anything but success, [`TraciError::Timeout`] if it had to be
    /// killed. SUMO has ended in every case.
    pub fn close(mut self) -> Result<ExitReport, TraciError> {
        let begun = Instant::now();
        let timeout = self.client.timeout();
        if let Err(error) = self.client.close() {
            self.process.kill();
            return Err(error);
        }
        ended(&self.process, timeout.saturating_sub(begun.elapsed()), timeout)
    }

    /// Ends SUMO at once, outputs unwritten, and reaps it.
    pub fn kill(self) {
        drop(self);
    }
}

impl Drop for Sumo {
    fn drop(&mut self) {
        self.process.kill();
    }
}

/// Waits for the end of a SUMO whose connection was closed, and kills it if it has not come when nothing is `left` of the
/// `timeout`.
pub(super) fn ended(process: &Process, left: Duration, timeout: Duration) -> Result<ExitReport, TraciError> {
    let command = || "ending after close".to_owned();
    let Some(status) = process.wait(left) else {
        let evidence = Box::new(process.evidence(Duration::ZERO));
        process.kill();
        return Err(TraciError::Timeout { command: command(), after: timeout, evidence });
    };
    let evidence = process.evidence(Duration::ZERO);
    if !status.success() {
        let detail = "it did not end well".to_owned();
        return Err(TraciError::Crashed { command: command(), detail, evidence: Box::new(evidence) });
    }
    Ok(ExitReport { status, last_lines: evidence.last_lines, lines_dropped: evidence.lines_dropped })
}

/// As [`Sumo::start`], with ports from `reserve`.
fn start_on(
    home: &SumoHome,
    command: &SumoCommand,
    timeout: Duration,
    reserve: &mut dyn FnMut() -> std::io::Result<PortReservation>,
) -> Result<Sumo, TraciError> {
    let begun = Instant::now();
    let sumo =
        on_free_port(home, timeout, reserve, |port, left| try_port(home, command, port, left, timeout))?;
    tracing::debug!(pid = sumo.pid(), port = sumo.port, took = ?begun.elapsed(), "SUMO started");
    Ok(sumo)
}

fn try_port(
    home: &SumoHome,
    command: &SumoCommand,
    port: u16,
    left: Duration,
    timeout: Duration,
) -> Result<Sumo, Attempt> {
    let begun = Instant::now();
    let words = Words { binary: home.binary("sumo"), timeout };
    let connect = |address, left| Connection::connect(address, left).ok();
    let (process, connection) = launch(command.command(home, port), port, left, &words, connect)?;
    let left = left.saturating_sub(begun.elapsed());
    match Client::attach(connection, left, timeout, Some(Arc::clone(&process))) {
        Ok(client) => Ok(Sumo { process, client, port }),
        Err(TraciError::Crashed { evidence, .. }) => Err(words.ended("it ended while loading", *evidence)),
        Err(TraciError::Timeout { evidence, .. }) if evidence.exit.is_none() => Err(words.late(*evidence)),
        Err(error) => match error.evidence() {
            Some(evidence) if evidence.exit.is_some() => {
                Err(words.ended("it ended while loading", evidence.clone()))
            }
            _ => Err(Attempt::Failed(error)),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ErrorKind;
    use crate::sumo::launch::ATTEMPTS;
    use std::net::{Ipv4Addr, TcpListener};

    fn home() -> SumoHome {
        SumoHome::locate(None).expect("run `make build` first")
    }

    fn grid() -> SumoCommand {
        let map = Path::new(env!("CARGO_MANIFEST_DIR")).join("../.deps/resco/grid4x4");
        SumoCommand::new().option("-n", map.join("grid4x4.net.xml"))
    }

    #[test]
    fn a_port_taken_at_the_last_moment_is_replaced() {
        let squatter = TcpListener::bind((Ipv4Addr::UNSPECIFIED, 0)).unwrap();
        let taken = squatter.local_addr().unwrap().port();
        let mut given =
            vec![PortReservation::new().unwrap(), PortReservation::of(taken), PortReservation::of(taken)];
        let mut reserve = || Ok(given.pop().expect("at most three ports are needed"));
        let mut sumo = start_on(&home(), &grid(), Duration::from_secs(60), &mut reserve).unwrap();
        assert_ne!(sumo.port(), taken);
        assert_eq!(sumo.client().time().unwrap(), 0.0);
        // The stranger on the port was never talked to.
        squatter.set_nonblocking(true).unwrap();
        assert_eq!(squatter.accept().unwrap_err().kind(), std::io::ErrorKind::WouldBlock);
    }

    #[test]
    fn ports_that_are_always_taken_end_in_an_error_and_not_in_a_loop() {
        let squatter = TcpListener::bind((Ipv4Addr::UNSPECIFIED, 0)).unwrap();
        let taken = squatter.local_addr().unwrap().port();
        let mut tries = 0;
        let mut reserve = || {
            tries += 1;
            Ok(PortReservation::of(taken))
        };
        let error = start_on(&home(), &grid(), Duration::from_secs(60), &mut reserve).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Spawn);
        assert!(error.to_string().contains("taken"), "{error}");
        assert_eq!(tries, ATTEMPTS);
    }

    #[test]
    fn an_option_given_by_the_caller_is_not_given_twice() {
        let count = |command: &SumoCommand| {
            let command = command.command(&home(), 1);
            command.get_args().filter(|arg| arg.to_string_lossy().starts_with("--no-step-log")).count()
        };
        assert_eq!(count(&SumoCommand::new()), 1);
        assert_eq!(count(&SumoCommand::new().option("--no-step-log", "false")), 1);
        assert_eq!(count(&SumoCommand::new().arg("--no-step-log=false")), 1);
    }
}
