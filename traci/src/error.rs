//! What can go wrong with a SUMO, in words a person can act on.

use crate::codec::DecodeError;
use std::fmt;
use std::path::PathBuf;
use std::process::ExitStatus;
use std::time::Duration;
use thiserror::Error;

/// Why a call failed, as one of few words: a label for metrics and for deciding whether another SUMO may help.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    /// SUMO ended or its connection broke.
    Crashed,
    /// SUMO did not answer within the deadline.
    Timeout,
    /// SUMO answered that it will not do that. The connection stays usable.
    Refused,
    /// What SUMO sent is not TraCI as this crate knows it.
    Protocol,
    /// SUMO could not be started, or ended before it was ready.
    Spawn,
}

impl ErrorKind {
    /// Every kind.
    pub const ALL: [Self; 5] = [Self::Crashed, Self::Timeout, Self::Refused, Self::Protocol, Self::Spawn];

    /// The word.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Crashed => "crashed",
            Self::Timeout => "timeout",
            Self::Refused => "refused",
            Self::Protocol => "protocol",
            Self::Spawn => "spawn",
        }
    }
}

impl fmt::Display for ErrorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// What is known of the SUMO process when something failed.
#[derive(Debug, Clone, Default)]
pub struct Evidence {
    /// Process id; absent for a SUMO that this crate did not start.
    pub pid: Option<u32>,
    /// How the process ended, if it has.
    pub exit: Option<ExitStatus>,
    /// SUMO's last lines on stderr, and its errors on stdout, oldest first.
    pub last_lines: Vec<String>,
    /// Lines before those, no longer kept.
    pub lines_dropped: u64,
}

impl Evidence {
    /// The exit code, if SUMO ended by itself.
    pub fn exit_code(&self) -> Option<i32> {
        self.exit.and_then(|status| status.code())
    }

    /// The signal that ended SUMO, if one did.
    pub fn signal(&self) -> Option<i32> {
        #[cfg(unix)]
        {
            use std::os::unix::process::ExitStatusExt;
            self.exit.and_then(|status| status.signal())
        }
        #[cfg(not(unix))]
        None
    }

    /// How it ended, in words that follow "SUMO".
    fn end(&self) -> impl fmt::Display {
        struct End<'a>(&'a Evidence);
        impl fmt::Display for End<'_> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                if let Some(pid) = self.0.pid {
                    write!(f, "(pid {pid}) ")?;
                }
                match (self.0.exit_code(), self.0.signal()) {
                    (Some(code), _) => write!(f, "ended with exit code {code}"),
                    (None, Some(signal)) => write!(f, "was killed by {}", SignalName(signal)),
                    (None, None) => f.write_str("is gone"),
                }
            }
        }
        End(self)
    }

    /// Its last lines, in words that follow a sentence. Only the newest few: a person reads this in one line.
    fn said(&self) -> impl fmt::Display {
        struct Said<'a>(&'a Evidence);
        impl fmt::Display for Said<'_> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                let lines = &self.0.last_lines;
                if lines.is_empty() {
                    // Of a SUMO that somebody else started, or that never ran, there is nothing to tell.
                    return if self.0.pid.is_some() { f.write_str("; it printed nothing") } else { Ok(()) };
                }
                write!(f, "; it printed: {}", lines[lines.len().saturating_sub(SHOWN)..].join(" | "))
            }
        }
        const SHOWN: usize = 6;
        Said(self)
    }
}

struct SignalName(i32);

impl fmt::Display for SignalName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Numbers of Linux on every architecture that SUMO is built for.
        let name = match self.0 {
            1 => "SIGHUP",
            2 => "SIGINT",
            4 => "SIGILL",
            6 => "SIGABRT",
            7 => "SIGBUS",
            8 => "SIGFPE",
            9 => "SIGKILL",
            11 => "SIGSEGV",
            13 => "SIGPIPE",
            15 => "SIGTERM",
            _ => return write!(f, "signal {}", self.0),
        };
        write!(f, "signal {} ({name})", self.0)
    }
}

/// A failed call, or a SUMO that could not be started.
#[derive(Debug, Clone, Error)]
#[non_exhaustive]
pub enum TraciError {
    /// SUMO ended, or the connection broke, during a command.
    #[error("SUMO {} during {command} ({detail}){}", evidence.end(), evidence.said())]
    Crashed {
        /// The last command, in words.
        command: String,
        /// What the socket or the process said.
        detail: String,
        /// The process's end and last lines.
        evidence: Box<Evidence>,
    },
    /// SUMO did not answer in time. It may still run; drop its owner to end it.
    #[error("SUMO did not finish {command} within {after:?}{}", evidence.said())]
    Timeout {
        /// The last command, in words.
        command: String,
        /// The deadline.
        after: Duration,
        /// The process's last lines.
        evidence: Box<Evidence>,
    },
    /// SUMO answered a command with an error. The connection stays usable.
    #[error("SUMO refused {command}: {message}{}", others(*refused, *sent))]
    Refused {
        /// The first refused command, in words.
        command: String,
        /// SUMO's own words.
        message: String,
        /// How many commands of the message were refused.
        refused: usize,
        /// How many commands the message held. Those not refused were carried out.
        sent: usize,
    },
    /// What SUMO sent cannot be understood, or what was to be sent cannot be.
    #[error("the answer to {command} is not TraCI: {source}{}", evidence.said())]
    Protocol {
        /// The last command, in words.
        command: String,
        /// What is wrong with the bytes.
        #[source]
        source: DecodeError,
        /// The process's last lines.
        evidence: Box<Evidence>,
    },
    /// SUMO is of a version that this crate was not written for.
    #[error(
        "{identifier} speaks TraCI API version {found}, this program versions {oldest} to {newest}: \
         unset SUMO_HOME to use the SUMO that `make build` installs, or name another with --sumo-home"
    )]
    Version {
        /// SUMO's API version.
        found: i32,
        /// SUMO's name and version.
        identifier: String,
        /// Oldest API version that is accepted.
        oldest: i32,
        /// Newest API version that is accepted.
        newest: i32,
    },
    /// SUMO could not be started, or ended before it was ready.
    #[error("cannot start {}: {reason}{}", binary.display(), evidence.said())]
    Spawn {
        /// The program.
        binary: PathBuf,
        /// What went wrong.
        reason: String,
        /// The process's end and last lines.
        evidence: Box<Evidence>,
    },
    /// The connection failed earlier; this command was not sent.
    #[error("{command} was not sent: the connection to this SUMO has ended ({earlier})")]
    Unusable {
        /// The command that was not sent.
        command: String,
        /// The kind of the failure that ended the connection.
        kind: ErrorKind,
        /// That failure, in words.
        earlier: String,
    },
}

fn others(refused: usize, sent: usize) -> String {
    match (refused, sent) {
        (_, ..=1) => String::new(),
        (1, sent) => format!(" (the other {} commands of the same message were carried out)", sent - 1),
        (refused, sent) => format!(" ({refused} of {sent} commands of the same message were refused)"),
    }
}

impl TraciError {
    /// The bounded reason.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Crashed { .. } => ErrorKind::Crashed,
            Self::Timeout { .. } => ErrorKind::Timeout,
            Self::Refused { .. } => ErrorKind::Refused,
            Self::Protocol { .. } | Self::Version { .. } => ErrorKind::Protocol,
            Self::Spawn { .. } => ErrorKind::Spawn,
            Self::Unusable { kind, .. } => *kind,
        }
    }

    /// What is known of the process, where that is part of the error.
    pub fn evidence(&self) -> Option<&Evidence> {
        match self {
            Self::Crashed { evidence, .. }
            | Self::Timeout { evidence, .. }
            | Self::Protocol { evidence, .. }
            | Self::Spawn { evidence, .. } => Some(evidence),
            Self::Refused { .. } | Self::Version { .. } | Self::Unusable { .. } => None,
        }
    }
}

/// A value of another type than expected, found while walking over subscription results.
impl From<DecodeError> for TraciError {
    fn from(source: DecodeError) -> Self {
        Self::Protocol { command: "a subscription".to_owned(), source, evidence: Box::default() }
    }
}
