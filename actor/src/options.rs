//! The command line.

use crate::error::ActorError;
use clap::{Parser, ValueEnum};
use cross_support::options::ClientOptions;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::LazyLock;

/// What `--version` prints: learner and actors have to speak the same protocol.
static VERSION: LazyLock<String> = LazyLock::new(|| {
    let (protocol, libtorch) = (cross_proto::PROTOCOL_VERSION, cross_model::libtorch_version());
    format!("{} (protocol {protocol}, libtorch {libtorch})", env!("CARGO_PKG_VERSION"))
});

/// Simulates traffic for a learner: runs one SUMO, acts with the newest policy, and sends what happened.
///
/// Needs nothing but the learner's address: configuration, scenarios and weights come from there. It reconnects when the
/// learner goes away and comes back, and ends when training is complete.
///
/// Exit codes: 0 training complete or stopped by a signal; 2 wrong usage, bad input, or refused by the learner; 1 otherwise.
#[derive(Debug, Clone, Parser)]
#[command(name = "cross-actor", version = VERSION.as_str(), max_term_width = 110)]
pub struct Options {
    /// Address of the learner, as https://HOST:PORT, or http://HOST:PORT if it does not speak TLS
    #[arg(long, value_name = "URL", env = "CROSS_LEARNER")]
    pub learner: String,

    /// Name of this actor, unique among those of the learner [default: HOST-PID]
    #[arg(long, value_name = "ID")]
    pub actor_id: Option<String>,

    /// Run only this scenario of the learner's; may be repeated [default: all]
    #[arg(long = "scenario", value_name = "NAME")]
    pub scenario: Vec<String>,

    /// Directory that holds scenarios, searched before $CROSS_SCENARIOS and the installed ones
    #[arg(long, value_name = "DIR")]
    pub scenarios: Option<PathBuf>,

    /// SUMO installation [default: $SUMO_HOME, then .deps/sumo/sumo, then PATH]
    #[arg(long, value_name = "DIR")]
    pub sumo_home: Option<PathBuf>,

    /// Configuration that the learner must agree with in its env and model sections [default: the learner's]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Address for /metrics, /ready and /live; port 0 takes a free one, which the log names
    #[arg(long, value_name = "ADDR", default_value_t = LOOPBACK, env = "CROSS_ACTOR_METRICS_LISTEN")]
    pub metrics_listen: SocketAddr,

    /// Write the address of /metrics to this file once it is known
    #[arg(long, value_name = "FILE")]
    pub address_file: Option<PathBuf>,

    /// Allow --metrics-listen on an address that other machines reach, and a token sent to another machine over http://:
    /// neither is encrypted
    #[arg(long, env = "CROSS_INSECURE")]
    pub insecure: bool,

    /// Seconds without a learner after which the actor ends [default: actor.give_up_seconds of the configuration]
    #[arg(long, value_name = "SECONDS")]
    pub give_up_seconds: Option<u64>,

    /// Seconds that the end may take after SIGTERM or Ctrl-C before SUMO is killed
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    pub grace_seconds: u64,

    /// Format of the log on stderr
    #[arg(long, value_enum, default_value_t = LogFormat::Text, env = "CROSS_LOG_FORMAT")]
    pub log_format: LogFormat,

    /// What is logged: error, warn, info, debug, trace, or a filter like cross_actor=debug
    #[arg(long, value_name = "FILTER", default_value = "info", env = "CROSS_LOG")]
    pub log: String,

    /// TLS and token.
    #[command(flatten)]
    pub security: ClientOptions,
}

const LOOPBACK: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

impl Options {
    /// Checks what does not depend on the machine.
    ///
    /// # Errors
    /// [`ActorError::Option`] names the option.
    pub fn validate(&self) -> Result<(), ActorError> {
        if !self.metrics_listen.ip().is_loopback() && !self.insecure {
            return Err(ActorError::Option {
                option: "--metrics-listen",
                problem: format!(
                    "is {}, which other machines reach without encryption; use a loopback address, or add --insecure",
                    self.metrics_listen
                ),
            });
        }
        if let Some(id) = &self.actor_id {
            cross_proto::ids::ActorId::parse(id, "--actor-id").map_err(|violation| ActorError::Option {
                option: "--actor-id",
                problem: violation.description,
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(arguments: &[&str]) -> Result<Options, clap::Error> {
        Options::try_parse_from(["cross-actor", "--learner", "http://127.0.0.1:1"].iter().chain(arguments))
    }

    #[test]
    fn the_learner_is_all_that_must_be_given() {
        let options = parse(&[]).unwrap();
        assert!(options.validate().is_ok());
        assert_eq!(options.metrics_listen, LOOPBACK);
    }

    #[test]
    fn other_addresses_than_loopback_need_a_word() {
        let open = parse(&["--metrics-listen", "0.0.0.0:9000"]).unwrap();
        assert!(open.validate().unwrap_err().to_string().contains("--insecure"));
        assert!(parse(&["--metrics-listen", "0.0.0.0:9000", "--insecure"]).unwrap().validate().is_ok());
    }

    #[test]
    fn a_bad_actor_id_is_refused_before_anything_starts() {
        for id in ["", "a b", "a/b"] {
            let error = parse(&["--actor-id", id]).unwrap().validate().unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().starts_with("the option --actor-id "), "{error}");
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Options::command().debug_assert();
    }
}
