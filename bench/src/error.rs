//! Why a benchmark could not be made.

use cross_config::ConfigError;
use cross_model::ModelError;
use cross_sim::SimError;
use cross_sim::controller::ControllerError;
use cross_sim::metrics::TripInfoError;
use std::path::PathBuf;
use std::process::ExitStatus;

/// An error of a benchmark.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The model refused what the benchmark made for it.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The configuration that is measured cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A figure of this process that the kernel should tell.
    #[error("cannot read the peak memory from {}; this benchmark needs Linux with /proc mounted: {source}", path.display())]
    Memory {
        /// File of the kernel.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// SUMO or the environment failed.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// SUMO's record of trips cannot be used.
    #[error(transparent)]
    Trips(#[from] TripInfoError),
    /// A rule failed.
    #[error("the controller failed: {source}")]
    Controller {
        /// What it said.
        source: ControllerError,
    },
    /// CPU time of this process and its children that the kernel should tell.
    #[error("cannot read the CPU time from {}; this benchmark needs Linux with /proc mounted: {source}", path.display())]
    CpuTime {
        /// File of the kernel.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// SUMO's command line that the kernel should tell.
    #[error("cannot read SUMO's command line from {}; this benchmark needs Linux with /proc mounted: {source}", path.display())]
    CommandLine {
        /// File of the kernel.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// SUMO alone could not be started.
    #[error("cannot start SUMO alone: {source}")]
    Sumo {
        /// What went wrong.
        source: std::io::Error,
    },
    /// SUMO alone failed.
    #[error("SUMO alone ended with {status} on the signal plan of our episode, saying: {said}")]
    Replay {
        /// How it ended.
        status: ExitStatus,
        /// Its last line.
        said: String,
    },
    /// The two sides did not simulate the same.
    #[error(
        "the replay is not the same traffic: {different} records of trips differ, of {ours} in our episode and {bare} in the replay; their times cannot be compared"
    )]
    OtherTraffic {
        /// Records that differ.
        different: usize,
        /// Records of our episode.
        ours: usize,
        /// Records of the replay.
        bare: usize,
    },
    /// The program of another client could not be started.
    #[error("cannot start the program of {client}: {source}")]
    ClientStart {
        /// Which client.
        client: String,
        /// What went wrong.
        source: std::io::Error,
    },
    /// The program of another client failed.
    #[error("{client} ended with {status} in the middle of an episode, saying: {said}{sumo}")]
    Client {
        /// Which client.
        client: String,
        /// How it ended.
        status: ExitStatus,
        /// Its last line.
        said: String,
        /// What its SUMO said, as the end of a sentence.
        sumo: String,
    },
    /// The program of another client is not the one that this program was built with.
    #[error("{client} said {said:?}, which is no answer of its program; build it again")]
    ClientAnswer {
        /// Which client.
        client: String,
        /// What it said.
        said: String,
    },
    /// What another client saw cannot be read.
    #[error("line {line} of {} is no record of a vehicle; build the client's program again", path.display())]
    Seen {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
    },
    /// Another client did not see what ours saw.
    #[error(
        "{client} did not see the same traffic: at decision {decision} it saw on {lane} {theirs} where ours saw {ours}; their times cannot be compared"
    )]
    OtherObservations {
        /// Which client.
        client: String,
        /// The decision, counted from 1.
        decision: usize,
        /// The lane.
        lane: String,
        /// Our counts on it.
        ours: String,
        /// The client's.
        theirs: String,
    },
    /// No place for files.
    #[error("cannot make a temporary folder: {source}")]
    Folder {
        /// What went wrong.
        source: std::io::Error,
    },
    /// A file that could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// A file that could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
}

impl BenchError {
    /// A client's failure with what its SUMO said beside it.
    pub(crate) fn beside(self, said: &str) -> Self {
        match self {
            Self::Client { client, status, said: own, .. } => {
                Self::Client { client, status, said: own, sumo: format!("; beside it {said}") }
            }
            other => other,
        }
    }
}
