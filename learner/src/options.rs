//! Command line.

use clap::{Parser, ValueEnum};
use cross_config::ComputeDevice;
use cross_support::options::ServerOptions;
use cross_support::server::ServerSecurity;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::LazyLock;

/// What `--version` prints: learner and actors have to speak the same protocol.
static VERSION: LazyLock<String> = LazyLock::new(|| {
    let (protocol, libtorch) = (cross_proto::PROTOCOL_VERSION, cross_model::libtorch_version());
    format!("{} (protocol {protocol}, libtorch {libtorch})", env!("CARGO_PKG_VERSION"))
});

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line, for machines.
    Json,
}

/// Trains CROSS on what actors send: the learner process.
///
/// `cross train` starts it together with actors on one machine, so most people never type this. On a cluster, start one
/// learner, then point any number of actors at its address.
#[derive(Debug, Parser)]
#[command(version = VERSION.as_str(), after_help = AFTER_HELP)]
pub(crate) struct Options {
    /// Configuration of the run, TOML; unknown keys are refused by name
    #[arg(long, value_name = "FILE")]
    pub(crate) config: PathBuf,

    /// Run directory: checkpoints, metrics.jsonl, learner.json; created if missing
    #[arg(long, value_name = "DIR")]
    pub(crate) run: PathBuf,

    /// Go on from the newest checkpoint in the run directory or under --checkpoints; without one, start at the beginning
    #[arg(long)]
    pub(crate) resume: bool,

    /// Where checkpoints are copied besides the run directory, whatever learner.checkpoint_url says: s3://BUCKET/PATH,
    /// gs://BUCKET/PATH, az://CONTAINER/PATH or file:///FOLDER; empty for nowhere. Credentials come from the environment
    #[arg(long, value_name = "URL", env = "CROSS_CHECKPOINTS")]
    pub(crate) checkpoints: Option<String>,

    /// Where updates are computed, whatever learner.device says: auto (CUDA if there is a device), cpu or cuda
    #[arg(long, value_name = "DEVICE")]
    pub(crate) device: Option<ComputeDevice>,

    /// Address for actors and clients (gRPC); port 0 takes a free one, which learner.json tells
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:0", env = "CROSS_LEARNER_LISTEN")]
    pub(crate) listen: SocketAddr,

    /// Address for /metrics, /ready and /live (HTTP)
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:0", env = "CROSS_LEARNER_METRICS_LISTEN")]
    pub(crate) metrics_listen: SocketAddr,

    /// Allow addresses that other machines can reach without TLS, or without a token or client certificates: only inside
    /// a network that you trust
    #[arg(long, env = "CROSS_INSECURE")]
    pub(crate) insecure: bool,

    /// Folder with scenarios, searched before $CROSS_SCENARIOS and the ones beside the program
    #[arg(long, value_name = "DIR")]
    pub(crate) scenarios: Option<PathBuf>,

    /// Log lines on standard error: text or json
    #[arg(long, value_name = "FORMAT", default_value = "text", env = "CROSS_LOG_FORMAT")]
    pub(crate) log_format: LogFormat,

    /// What is logged: error, warn, info, debug, trace, or a filter like cross_learner=debug
    #[arg(long, value_name = "FILTER", default_value = "info", env = "CROSS_LOG")]
    pub(crate) log: String,

    #[command(flatten)]
    pub(crate) security: ServerOptions,
}

const AFTER_HELP: &str = "\
Life of the process:
  It reads the networks of all scenarios (SUMO is not needed), takes up the newest checkpoint with
  --resume, listens, and writes RUN/learner.json: {\"pid\", \"grpc\", \"metrics\", \"session_epoch\", \"run_id\"}.
  It ends by itself when config.updates are done. SIGTERM or Ctrl-C lets the update in progress finish,
  writes a checkpoint, sends the actors away and ends within learner.drain_seconds; a second signal ends it at once.

  With --checkpoints every checkpoint is copied there as well. A store that is down stops nothing; what it lacks is
  copied later, and the end of the process waits up to 30 s for the last copy, without which it ends with 1.

Exit codes:
  0 training is complete, or was stopped and can be resumed
  2 an option, the configuration, a scenario, the run directory or a checkpoint cannot be used
  1 anything else

Examples:
  cross-learner --config configs/paper.toml --run runs/first
  cross-learner --config runs/first/config.toml --run runs/first --resume
  cross-learner --config c.toml --run r --checkpoints s3://bucket/first
  cross-learner --config c.toml --run r --listen 0.0.0.0:7400 --metrics-listen 0.0.0.0:7401 \
      --tls-cert learner.pem --tls-key learner.key --token-file token
  cross-actor --learner http://127.0.0.1:7400 --actor-id a0";

impl Options {
    /// The first address that other machines could reach though strangers are not kept out, unless that was allowed.
    pub(crate) fn exposed(&self, security: &ServerSecurity) -> Option<(&'static str, SocketAddr)> {
        let allowed = self.insecure || security.keeps_strangers_out();
        [("--listen", self.listen), ("--metrics-listen", self.metrics_listen)]
            .into_iter()
            .find(|(_, address)| !allowed && !address.ip().is_loopback())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn parse(more: &[&str]) -> Options {
        let fixed = ["cross-learner", "--config", "c.toml", "--run", "r"];
        Options::try_parse_from(fixed.iter().chain(more)).unwrap()
    }

    #[test]
    fn the_command_line_is_well_formed() {
        Options::command().debug_assert();
    }

    #[test]
    fn a_device_is_named_like_in_the_configuration() {
        assert_eq!(parse(&["--device", "cuda"]).device, Some(ComputeDevice::Cuda));
        assert_eq!(parse(&[]).device, None);
        let wrong = ["cross-learner", "--config", "c.toml", "--run", "r", "--device", "gpu"];
        assert!(Options::try_parse_from(wrong).unwrap_err().to_string().contains("auto, cpu or cuda"));
    }

    #[test]
    fn other_machines_need_a_word_of_consent() {
        let open = ServerSecurity::default();
        assert_eq!(parse(&[]).exposed(&open), None);
        assert_eq!(parse(&["--listen", "[::1]:1"]).exposed(&open), None);
        let exposed = parse(&["--metrics-listen", "0.0.0.0:1"]).exposed(&open).unwrap();
        assert_eq!(exposed.0, "--metrics-listen");
        assert_eq!(parse(&["--listen", "0.0.0.0:1", "--insecure"]).exposed(&open), None);
        // A token alone would be read on the way.
        let token = Some("0123456789abcdef".to_owned());
        let token = ServerSecurity::load(&ServerOptions::default(), token).unwrap();
        assert!(parse(&["--listen", "0.0.0.0:1"]).exposed(&token).is_some());
    }
}
