//! A SUMO process that listens on a port of its own.

use super::SumoHome;
use super::listening::listens;
use super::port::PortReservation;
use super::process::Process;
use crate::error::{Evidence, TraciError};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Ports tried before a start is given up.
pub(super) const ATTEMPTS: usize = 5;

/// Why one attempt failed.
pub(super) enum Attempt {
    /// Another port may help.
    PortTaken,
    /// Nothing will help.
    Failed(TraciError),
}

/// Makes an attempt on one free port after another, until one was not taken in the meantime. An attempt is given its port
/// and the time left.
pub(super) fn on_free_port<T>(
    home: &SumoHome,
    timeout: Duration,
    reserve: &mut dyn FnMut() -> std::io::Result<PortReservation>,
    attempt: impl Fn(u16, Duration) -> Result<T, Attempt>,
) -> Result<T, TraciError> {
    let begun = Instant::now();
    let spawn_error =
        |reason: String| TraciError::Spawn { binary: home.binary("sumo"), reason, evidence: Box::default() };
    for number in 1..=ATTEMPTS {
        let reservation = reserve().map_err(|error| spawn_error(format!("no free TCP port: {error}")))?;
        match attempt(reservation.port(), timeout.saturating_sub(begun.elapsed())) {
            Ok(started) => return Ok(started),
            Err(Attempt::Failed(error)) => return Err(error),
            Err(Attempt::PortTaken) => {
                tracing::debug!(port = reservation.port(), number, "port taken, trying another");
            }
        }
    }
    Err(spawn_error(format!("{ATTEMPTS} free ports were taken before it could listen")))
}

/// Starts SUMO and waits until it listens on its port and `knock`, given its address and the time left, has an answer.
pub(super) fn launch<T>(
    command: Command,
    port: u16,
    left: Duration,
    words: &Words,
    knock: impl Fn(SocketAddr, Duration) -> Option<T>,
) -> Result<(Arc<Process>, T), Attempt> {
    let begun = Instant::now();
    let process = Process::start(command).map_err(|error| {
        let (reason, evidence) = (error.to_string(), Box::default());
        Attempt::Failed(TraciError::Spawn { binary: words.binary.clone(), reason, evidence })
    })?;
    let process = Arc::new(process);
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let mut pause = Duration::from_millis(1);
    let answer = loop {
        // Where the system does not tell who listens, knocking has to tell whether somebody does. There is one
        // connection only: SUMO takes the first for its client.
        if listens(process.pid(), port) != Some(false)
            && let Some(answer) = knock(address, left.saturating_sub(begun.elapsed()))
        {
            break answer;
        }
        if process.exit().is_some() {
            return Err(words.ended("it ended before it listened", process.evidence(Duration::ZERO)));
        }
        if begun.elapsed() >= left {
            return Err(words.late(process.evidence(Duration::ZERO)));
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(Duration::from_millis(8));
    };
    // On a port that was taken it is not SUMO who accepts, and SUMO has ended or is about to.
    if process.exit().is_some() {
        return Err(words.ended("it ended before it listened", process.evidence(Duration::ZERO)));
    }
    Ok((process, answer))
}

/// How a start that failed is told.
pub(super) struct Words {
    pub(super) binary: PathBuf,
    pub(super) timeout: Duration,
}

impl Words {
    pub(super) fn ended(&self, reason: &str, evidence: Evidence) -> Attempt {
        if port_taken(&evidence) {
            return Attempt::PortTaken;
        }
        let reason = match (evidence.exit_code(), evidence.signal()) {
            (Some(code), _) => format!("{reason} with exit code {code}"),
            (None, Some(signal)) => format!("{reason} by signal {signal}"),
            (None, None) => reason.to_owned(),
        };
        let binary = self.binary.clone();
        Attempt::Failed(TraciError::Spawn { binary, reason, evidence: Box::new(evidence) })
    }

    pub(super) fn late(&self, evidence: Evidence) -> Attempt {
        let (command, evidence) = ("its start".to_owned(), Box::new(evidence));
        Attempt::Failed(TraciError::Timeout { command, after: self.timeout, evidence })
    }
}

/// Whether SUMO ended because it could not listen.
fn port_taken(evidence: &Evidence) -> bool {
    evidence.exit.is_some()
        && evidence.last_lines.iter().any(|line| {
            line.contains("Address already in use") || line.contains("Unable to create listening socket")
        })
}
