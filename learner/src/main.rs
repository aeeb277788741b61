//! The learner process: options, configuration, checkpoint, sockets, serve, drain.

mod options;

use anyhow::Context;
use clap::Parser;
use cross_config::Config;
use cross_learner::checkpoint::CheckpointError;
use cross_learner::checkpoint::remote::{Fetched, Remote};
use cross_learner::run_dir::{Listening, RunDir};
use cross_learner::{
    Ending, Learner, MirrorSetup, Setup, checkpoint, fetch_checkpoint, find_checkpoint, load_scenarios,
};
use cross_model::Placement;
use cross_support::server::ServerSecurity;
use cross_support::token::Tokens;
use options::{LogFormat, Options};
use std::io::Write;
use std::net::SocketAddr;
use std::process::ExitCode;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// How long a repeated signal counts as an echo of the first and not as impatience.
const ECHO: Duration = Duration::from_secs(1);

/// Why the process ends without having done its work.
enum Failure {
    /// What was asked for cannot be done; a person has to change it.
    Input(anyhow::Error),
    /// Anything else.
    Other(anyhow::Error),
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::Other(error)
    }
}

/// For `map_err`: the user's to mend.
fn input(error: impl Into<anyhow::Error>) -> Failure {
    Failure::Input(error.into())
}

fn main() -> ExitCode {
    let options = Options::parse();
    if let Err(failure) = init_logging(&options) {
        return end(&options, &failure);
    }
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return end(&options, &Failure::Other(error.into())),
    };
    cross_support::open_files::raise();
    let result = runtime.block_on(run(&options));
    // What still runs now is a client's idle connection or a thread that is past its deadline.
    runtime.shutdown_timeout(Duration::from_millis(200));
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => end(&options, &failure),
    }
}

async fn run(options: &Options) -> Result<(), Failure> {
    let security = ServerSecurity::load(&options.security, Tokens::variable()).map_err(input)?;
    if let Some((option, address)) = options.exposed(&security) {
        return Err(input(anyhow::anyhow!(
            "{option} {address} can be reached from other machines, and strangers are not kept out (protection: {}); \
             give --tls-cert, --tls-key and --token-file or --tls-client-ca, or use a loopback address, \
             or pass --insecure inside a network that you trust",
            security.describe()
        )));
    }
    let mut config = Config::from_file(&options.config).map_err(input)?;
    config.learner.device = options.device.unwrap_or(config.learner.device);
    if let Some(url) = &options.checkpoints {
        config.learner.checkpoint_url.clone_from(url);
        config.validate().map_err(input)?;
    }
    // Before anything is touched; the trainer comes to the same.
    let placement = Placement::resolve(&config.learner).map_err(input)?;
    let scenarios = load_scenarios(&config, options.scenarios.as_deref()).map_err(input)?;
    let run = RunDir::open(&options.run).map_err(input)?;
    // Before the store is asked, which may take minutes: a stop must not wait for it, nor end the process by the signal itself.
    let mut signals = Signals::new()?;
    let found = tokio::select! {
        found = find(options, &run, &config) => found?,
        () = signals.next() => {
            tracing::info!("stopped before anything began; what was being fetched is fetched again at the next start");
            return Ok(());
        }
    };
    let (resumed, mirror, owner) = (found.resumed, found.mirror, found.owner);
    if options.resume && resumed.is_none() {
        tracing::warn!(run = %run.path().display(), "there is no checkpoint to resume; starting at the beginning");
    }
    let known = resumed.as_ref().map(|resumed| resumed.checkpoint.metadata.run_id.as_str());
    let run_id = run.identity(known.or(owner.as_deref())).map_err(input)?;

    let grpc = bind("--listen", options.listen).await?;
    let metrics = bind("--metrics-listen", options.metrics_listen).await?;
    let addresses = (address(&grpc)?, address(&metrics)?);
    let drain_deadline = Duration::from_secs(config.learner.drain_seconds);
    tracing::info!(
        run = %run.path().display(),
        run_id,
        scenarios = ?scenarios.iter().map(|(name, layout)| (name, layout.agents())).collect::<Vec<_>>(),
        updates = config.updates,
        seed = config.seed,
        serial = config.learner.serial,
        config_hash = config.hash(),
        device = placement.device_name(),
        precision = placement.precision_name(),
        protection = security.describe(),
        "starting"
    );
    let setup = Setup {
        config,
        scenarios,
        run: run.path().to_owned(),
        run_id: run_id.clone(),
        resumed,
        mirror,
        security,
    };
    let learner = Learner::start(setup, grpc, metrics)
        .map_err(|error| if error.is_input() { input(error) } else { Failure::Other(error.into()) })?;
    let (session_epoch, drain) = (learner.session_epoch(), learner.drain());

    // From here on a signal drains; a second one, or a drain that takes too long, ends the process at once.
    let stopping = tokio::spawn(async move {
        signals.next().await;
        drain.cancel();
        // Who signals every process of a run lets `cross train` repeat the first signal a moment later.
        let until = tokio::time::Instant::now() + ECHO;
        while tokio::time::timeout_at(until, signals.next()).await.is_ok() {}
        tokio::select! {
            () = signals.next() => "a second signal came: ended without waiting for the checkpoint".to_owned(),
            () = tokio::time::sleep(drain_deadline) => {
                format!("the drain took longer than learner.drain_seconds = {}: ended as it is", drain_deadline.as_secs())
            }
        }
    });
    if learner.ready().await {
        let (grpc, metrics) = addresses;
        // On a full disk there may be no room for it. Whoever has the address from elsewhere is served all the same.
        if let Err(error) =
            run.announce(&Listening { pid: std::process::id(), grpc, metrics, session_epoch, run_id })
        {
            tracing::error!("nobody can read there where the learner listens: {error}");
        }
        tracing::info!(%grpc, %metrics, "serving");
    }
    let ending = tokio::select! {
        ending = learner.finished() => ending,
        Ok(problem) = stopping => Ending::Failed(problem),
    };
    if let Err(error) = run.withdraw() {
        tracing::warn!("{error}");
    }
    match ending {
        Ending::Complete => tracing::info!("training is complete"),
        Ending::Drained => tracing::info!("stopped; --resume goes on from here"),
        Ending::Failed(problem) => return Err(Failure::Other(anyhow::anyhow!(problem))),
        Ending::Unusable(problem) => return Err(input(anyhow::anyhow!(problem))),
    }
    Ok(())
}

/// What a run goes on from, and where its checkpoints are copied.
struct Found {
    resumed: Option<checkpoint::Resumed>,
    mirror: Option<MirrorSetup>,
    /// The run that the place of the copies belongs to.
    owner: Option<String>,
}

async fn find(options: &Options, run: &RunDir, config: &Config) -> Result<Found, Failure> {
    // A store that does not answer may do so later; everything else is for a person to mend.
    let failed = |error: CheckpointError| {
        if error.is_passing() { Failure::Other(error.into()) } else { input(error) }
    };
    let remote = match config.learner.checkpoint_url.as_str() {
        "" => None,
        url => Some(Remote::open(url).map_err(failed)?),
    };
    if !options.resume {
        refuse_old_checkpoints(run)?;
    }
    let Some(remote) = remote else {
        let resumed = if options.resume { find_checkpoint(run.path(), config).map_err(input)? } else { None };
        return Ok(Found { resumed, mirror: None, owner: None });
    };
    let mut fetched = Fetched::default();
    if options.resume {
        fetched = fetch_checkpoint(run, &remote, config).await.map_err(failed)?;
        if let Some(error) = &fetched.unreachable {
            tracing::error!("{error}; going on from the run directory's own checkpoint");
        }
    } else {
        remote.refuse_used().await.map_err(failed)?;
    }
    let mirror = Some(MirrorSetup::new(remote, &fetched));
    Ok(Found { resumed: fetched.resumed, mirror, owner: fetched.owner })
}

/// A new run must not mix its checkpoints with those of an earlier one.
fn refuse_old_checkpoints(run: &RunDir) -> Result<(), Failure> {
    let found = checkpoint::reader::list(run.path()).map_err(input)?.len();
    if found == 0 {
        return Ok(());
    }
    Err(input(anyhow::anyhow!(
        "the run directory {} already holds {found} checkpoints; pass --resume to go on, or name another directory",
        run.path().display()
    )))
}

async fn bind(option: &str, address: SocketAddr) -> anyhow::Result<TcpListener> {
    let remedy = "choose another port, or 0 for a free one";
    TcpListener::bind(address).await.with_context(|| format!("cannot listen on {option} {address}; {remedy}"))
}

fn address(listener: &TcpListener) -> anyhow::Result<SocketAddr> {
    listener.local_addr().context("cannot tell the address of a listening socket")
}

/// SIGTERM and SIGINT, which mean the same here.
struct Signals {
    terminate: Signal,
    interrupt: Signal,
}

impl Signals {
    fn new() -> anyhow::Result<Self> {
        let listen = |kind| signal(kind).context("cannot listen for signals");
        Ok(Self { terminate: listen(SignalKind::terminate())?, interrupt: listen(SignalKind::interrupt())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}

fn init_logging(options: &Options) -> Result<(), Failure> {
    let filter = tracing_subscriber::EnvFilter::try_new(&options.log)
        .map_err(|problem| input(anyhow::anyhow!("the option --log is not a filter: {problem}")))?;
    // Whoever reads the log may go away; that must not end the training, which complaining on the same stream would.
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .log_internal_errors(false);
    match options.log_format {
        LogFormat::Text => builder.with_target(false).with_ansi(false).init(),
        LogFormat::Json => builder.json().init(),
    }
    Ok(())
}

/// The last line of the log, and the exit code.
fn end(options: &Options, failure: &Failure) -> ExitCode {
    let (error, code) = match failure {
        Failure::Input(error) => (error, 2),
        Failure::Other(error) => (error, 1),
    };
    match options.log_format {
        LogFormat::Json if tracing::enabled!(tracing::Level::ERROR) => tracing::error!("{error:#}"),
        // Also where --log keeps errors out of the log, or made no sense.
        LogFormat::Json | LogFormat::Text => {
            // As for the log: nobody may be there to read it.
            let _ = writeln!(std::io::stderr(), "error: {error:#}");
        }
    }
    ExitCode::from(code)
}
