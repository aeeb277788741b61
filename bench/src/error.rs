//! Why a benchmark could not be made.

use cross_config::ConfigError;
use cross_model::ModelError;
use cross_sim::SimError;
use cross_sim::controller::ControllerError;
use cross_sim::metrics::TripInfoError;
use cross_support::child::{ChildError, Exit};
use std::net::SocketAddr;
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
    #[error("cannot read the memory from {}; this benchmark needs Linux with /proc mounted: {source}", path.display())]
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
    /// CPU time that the kernel should tell.
    #[error(
        "cannot read the CPU time of process {pid} from /proc/{pid}/stat: it has ended, or this is no Linux with /proc mounted"
    )]
    CpuTime {
        /// Whose.
        pid: u32,
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
    /// A server could not be started.
    #[error(transparent)]
    Child(#[from] ChildError),
    /// No threads or sockets.
    #[error("cannot set up threads or sockets: {source}")]
    Runtime {
        /// What went wrong.
        source: std::io::Error,
    },
    /// Somebody asked to stop.
    #[error("stopped by a signal before the end; nothing of it is left")]
    Stopped,
    /// So many clients do not fit.
    #[error(
        "{clients} clients need {needed} open files and this process may have {allowed}; raise the hard limit (ulimit -Hn, LimitNOFILE), or measure with fewer"
    )]
    OpenFiles {
        /// Clients at a time.
        clients: usize,
        /// Files for them and for the server's side.
        needed: usize,
        /// The limit.
        allowed: u64,
    },
    /// A server did not come up.
    #[error("{server} did not serve within {seconds} s of its start; the machine is too busy to measure")]
    NotReady {
        /// Which.
        server: &'static str,
        /// How long it was waited for.
        seconds: u64,
    },
    /// A server did not go away.
    #[error("{server} did not end within {seconds} s of being told to; it was killed")]
    NotEnded {
        /// Which.
        server: &'static str,
        /// How long it was waited for.
        seconds: u64,
    },
    /// A server went away.
    #[error("{server} {exit} while it was measured, its last words: {said}")]
    ServerEnded {
        /// Which.
        server: &'static str,
        /// How.
        exit: Exit,
        /// The last line of its log.
        said: String,
    },
    /// The baseline cannot serve.
    #[error("the bare server cannot serve: {source}")]
    BareServer {
        /// What went wrong.
        source: tonic::transport::Error,
    },
    /// A server's address that is none.
    #[error(transparent)]
    Address {
        /// What is wrong with it.
        source: Box<cross_actor::ActorError>,
    },
    /// No connection.
    #[error("cannot connect to {address}: {source}")]
    Connect {
        /// `host:port`.
        address: String,
        /// What went wrong.
        source: tonic::transport::Error,
    },
    /// A call failed.
    #[error("the call {call} failed ({code}): {problem}")]
    Call {
        /// Method.
        call: &'static str,
        /// The status's sentence.
        problem: String,
        /// The status's code.
        code: tonic::Code,
    },
    /// The learner's counters.
    #[error("cannot read the learner's metrics at {address}: {source}")]
    Metrics {
        /// Its metrics port.
        address: SocketAddr,
        /// What went wrong.
        source: std::io::Error,
    },
    /// A fragment that was refused or dropped: then what is measured is not what it says.
    #[error("the learner answered a fragment with {outcome} where it should have accepted it")]
    NotAccepted {
        /// As the wire names it.
        outcome: &'static str,
    },
    /// An acknowledgement of nothing in flight.
    #[error(
        "the learner acknowledged a fragment twice, or one that it was not sent: episode {episode}, sequence {sequence}"
    )]
    AcknowledgedTwice {
        /// Its episode.
        episode: u64,
        /// Its position there.
        sequence: u32,
    },
    /// Counts of both sides that differ.
    #[error(
        "{sent} fragments were sent and {acknowledged} acknowledged, but the learner counts {counted} accepted"
    )]
    Miscounted {
        /// By the simulated actors.
        sent: u64,
        /// To them.
        acknowledged: u64,
        /// By the learner's own metrics.
        counted: u64,
    },
    /// Somebody was left out.
    #[error("{waiting} of {clients} clients did not get {what} within {seconds} s")]
    Unserved {
        /// How many.
        waiting: usize,
        /// Of how many.
        clients: usize,
        /// What they waited for.
        what: &'static str,
        /// How long.
        seconds: u64,
    },
    /// A version that was encoded more than once.
    #[error("the learner encoded {encoded} snapshots for {versions} versions; it should be one for each")]
    Encodings {
        /// By its own metric.
        encoded: u64,
        /// Versions that came.
        versions: u64,
    },
    /// A snapshot that did not come through.
    #[error("a snapshot came damaged: {problem}")]
    Snapshot {
        /// What is wrong with it.
        problem: String,
    },
    /// The training that was to be looked at.
    #[error("the training cannot be looked at: {problem}")]
    Training {
        /// What it did.
        problem: String,
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
