//! Why an actor ends, in words for people, and the exit code that goes with it.

use std::net::SocketAddr;
use std::path::PathBuf;

/// Why an actor could not go on.
#[derive(Debug, thiserror::Error)]
pub enum ActorError {
    /// An option has a value that cannot work.
    #[error("the option {option} {problem}")]
    Option {
        /// The option, as typed.
        option: &'static str,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The configuration file given with `--config`, or the one that the learner sent, is not usable.
    #[error(transparent)]
    Config(#[from] cross_config::ConfigError),
    /// Certificates, keys, the token or the learner's address cannot be used.
    #[error(transparent)]
    Security(#[from] cross_support::SecurityError),
    /// Learner and actor do not trust each other's certificates.
    #[error("no TLS with the learner: {problem}")]
    Certificate {
        /// Whose certificate is at fault, and what to do.
        problem: String,
    },
    /// No SUMO was found, or it does not start at all.
    #[error(transparent)]
    Locate(#[from] cross_traci::sumo::LocateError),
    /// The admin address is taken or not ours.
    #[error("cannot listen on {address} for metrics: {source}; choose another address with --metrics-listen")]
    Listen {
        /// Address that was asked for.
        address: SocketAddr,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file of `--address-file` could not be written.
    #[error("cannot write the metrics address to {}: {source}; name a file that can be written with --address-file", path.display())]
    AddressFile {
        /// File that was asked for.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The learner will not have this actor, now or later.
    #[error("the learner at {learner} refuses this actor: {message}")]
    Refused {
        /// Address of the learner.
        learner: String,
        /// The learner's reason.
        message: String,
    },
    /// A scenario of the run cannot be loaded here.
    #[error("cannot run the scenario {scenario}, which the learner trains on: {source}")]
    Scenario {
        /// Name of the scenario.
        scenario: String,
        /// What is wrong with it.
        source: Box<cross_sim::SimError>,
    },
    /// Learner and actor read different networks under the same name.
    #[error(
        "the scenario {scenario} is not the learner's: its layout hash is {own} here and {learner} there; \
         install the same scenario files on both machines"
    )]
    Layout {
        /// Name of the scenario.
        scenario: String,
        /// Hash of the layout of this actor's net.
        own: String,
        /// Hash that the learner announced.
        learner: String,
    },
    /// The learner wants a scenario simulated that it has not announced.
    #[error(
        "the learner assigned the scenario {scenario}, which it did not announce when this actor joined; \
         restart both from one release of CROSS"
    )]
    UnknownScenario {
        /// Name of the scenario.
        scenario: String,
    },
    /// The learner stayed away.
    #[error(
        "no learner at {learner} for {seconds} s, the last attempt said: {last}; \
         start the learner or correct --learner, then start this actor again, with more --give-up-seconds if need be"
    )]
    GaveUp {
        /// Address of the learner.
        learner: String,
        /// Seconds since the last sign of life.
        seconds: u64,
        /// What the last attempt ended with.
        last: String,
    },
    /// The learner finds fault with fragment after fragment.
    #[error("the learner at {learner} refused fragments {times} times in a row, giving up: {message}")]
    FragmentsRefused {
        /// Address of the learner.
        learner: String,
        /// How often in a row.
        times: u32,
        /// What it said last.
        message: String,
    },
    /// SUMO fails at every start.
    #[error(
        "SUMO failed {failures} times in a row on {scenario}, the last time: {source}; \
         check the scenario's files and the SUMO installation (--sumo-home), then start this actor again"
    )]
    SumoKeepsFailing {
        /// Scenario of the last failure.
        scenario: String,
        /// Failures in a row.
        failures: u32,
        /// The last failure.
        source: Box<cross_sim::SimError>,
    },
    /// The simulation cannot go on, and another SUMO would not help.
    #[error(
        "cannot simulate {scenario}: {source}; correct the scenario's files or the run's configuration, \
         then start this actor again"
    )]
    Simulation {
        /// Scenario that was being simulated.
        scenario: String,
        /// What happened.
        source: Box<cross_sim::SimError>,
    },
    /// The policy cannot be loaded or evaluated.
    #[error("cannot run policy version {version}: {source}")]
    Policy {
        /// Version of the snapshot.
        version: u64,
        /// What happened.
        source: cross_model::ModelError,
    },
    /// A snapshot was made for other decisions or observations than the session's configuration describes.
    #[error(
        "policy version {version} was made under another configuration than the learner announced; \
         restart the learner and its actors from one build"
    )]
    ForeignPolicy {
        /// Version of the snapshot.
        version: u64,
    },
    /// The simulator thread could not be started, or ended without a word.
    #[error("the simulator thread {problem}")]
    Thread {
        /// What happened to it.
        problem: String,
    },
    /// Something did not end within the grace period.
    #[error(
        "the actor did not come to a clean end within {seconds} s and its SUMO is killed; \
         the learner gives the unfinished episode out again, and a larger --grace-seconds allows more time"
    )]
    Grace {
        /// Length of the period.
        seconds: u64,
    },
}

impl ActorError {
    /// Exit code of the process: 2 for wrong usage and bad input, 1 for the rest.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Option { .. }
            | Self::Config(_)
            | Self::Security(_)
            | Self::Certificate { .. }
            | Self::Locate(_)
            | Self::Listen { .. }
            | Self::AddressFile { .. }
            | Self::Refused { .. }
            | Self::Scenario { .. }
            | Self::Layout { .. } => 2,
            Self::UnknownScenario { .. }
            | Self::GaveUp { .. }
            | Self::FragmentsRefused { .. }
            | Self::SumoKeepsFailing { .. }
            | Self::Simulation { .. }
            | Self::Policy { .. }
            | Self::ForeignPolicy { .. }
            | Self::Thread { .. }
            | Self::Grace { .. } => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_input_exits_with_2_and_failure_with_1() {
        let refused = ActorError::Refused { learner: "http://a".into(), message: "no".into() };
        let gave_up = ActorError::GaveUp { learner: "http://a".into(), seconds: 3, last: "refused".into() };
        assert_eq!((refused.exit_code(), gave_up.exit_code()), (2, 1));
    }

    #[test]
    fn a_foreign_layout_is_named_with_both_hashes() {
        let error = ActorError::Layout { scenario: "grid".into(), own: "aa".into(), learner: "bb".into() };
        let text = error.to_string();
        assert!(text.contains("grid") && text.contains("aa here") && text.contains("bb there"), "{text}");
    }
}
