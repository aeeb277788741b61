//! The actor: one SUMO, one policy, a stream of trajectory fragments to the learner.
//!
//! ```text
//!   main ── options, process            simulator thread                       network tasks
//!     └─ run ──────────────┬──> rollout ── episode ── recorder      session ── join ── scenarios
//!                          │       │  SUMO, libtorch                   ├── stream ── uplink ──> fragments
//!                          │       └────────── link ───────────────────┤
//!                          └──> admin ── telemetry                     └── weights <── snapshots
//! ```
//! The simulator thread owns SUMO and the networks and never sees a socket of the learner; the network tasks own the
//! connection and never wait for SUMO. [`link`] is all that lies between, and every queue in it is bounded.

mod admin;
pub mod backoff;
mod episode;
pub mod error;
mod join;
pub mod link;
pub mod options;
pub mod process;
pub mod recorder;
mod rollout;
mod scenarios;
pub mod session;
mod stream;
pub mod telemetry;
pub mod uplink;
mod weights;

pub use error::ActorError;
pub use join::endpoint;
pub use options::Options;
pub use session::Ending;
pub use telemetry::Telemetry;

use cross_config::Config;
use cross_support::client::ClientSecurity;
use cross_support::server::{Protocol, ServerSecurity};
use cross_support::token::Tokens;
use cross_traci::sumo::SumoHome;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio_util::sync::CancellationToken;

/// Runs an actor until training is complete, `stop` is cancelled, or it cannot go on.
///
/// # Errors
/// [`ActorError`], whose exit code tells bad input from failure.
pub async fn run(options: Options, stop: CancellationToken) -> Result<Ending, ActorError> {
    options.validate()?;
    let security = ClientSecurity::load(&options.security, Tokens::variable())?;
    let endpoint = join::endpoint(&options.learner, &security, options.insecure)?;
    let config_hash = match &options.config {
        Some(path) => Config::from_file(path)?.compatibility_hash(),
        None => String::new(),
    };
    let home = SumoHome::locate(options.sumo_home.as_deref())?;
    let sumo_version = sumo_version(home.clone()).await?;
    let actor_id = options.actor_id.clone().unwrap_or_else(join::default_actor_id);
    let telemetry = Telemetry::new()
        .map_err(|error| ActorError::Thread { problem: format!("has no metrics to write to: {error}") })?;
    let telemetry = Arc::new(telemetry);
    tracing::info!(actor = %actor_id, learner = %options.learner, sumo = %sumo_version, "starting");

    let listener = admin::bind(options.metrics_listen, options.address_file.as_deref()).await?;
    let admin_stop = CancellationToken::new();
    // The port tells counts and is open: on loopback, or where --insecure allows more.
    let open = ServerSecurity::default();
    let incoming = open
        .incoming(listener, Protocol::Http, cross_support::admin::CONNECTIONS)
        .map_err(|source| ActorError::Listen { address: options.metrics_listen, source })?;
    let subject = admin::Admin(Arc::clone(&telemetry));
    let until = admin_stop.clone().cancelled_owned();
    let admin = tokio::spawn(cross_support::admin::serve(incoming, open, subject, until));

    let (simulator_end, network_end) = link::pair(stop.clone(), Handle::current());
    let network = session::Network {
        joiner: join::Joiner {
            learner: options.learner.clone(),
            endpoint,
            security,
            actor_id: actor_id.clone(),
            scenarios: options.scenario.clone(),
            scenario_dir: options.scenarios.clone(),
            config_hash,
            sumo_version,
            joins: 0,
        },
        link: network_end,
        telemetry: Arc::clone(&telemetry),
        stop: stop.clone(),
        give_up: options.give_up_seconds.map(Duration::from_secs),
    };
    let simulator = rollout::spawn(rollout::Rollout { link: simulator_end, home, actor_id, telemetry })?;
    let ended = both(network, simulator, &stop, Duration::from_secs(options.grace_seconds)).await;
    admin_stop.cancel();
    // It ends at once and has nothing to say that is not in the log.
    let _ = admin.await;
    ended
}

/// Waits for the first half to end, tells the other, and gives it the grace period.
async fn both(
    network: session::Network,
    simulator: tokio::sync::oneshot::Receiver<Result<(), ActorError>>,
    stop: &CancellationToken,
    grace: Duration,
) -> Result<Ending, ActorError> {
    let simulator = async {
        simulator.await.unwrap_or_else(|_| {
            Err(ActorError::Thread { problem: "panicked; its message is in the log above".to_owned() })
        })
    };
    let mut network = tokio::spawn(network.run());
    let mut simulator = std::pin::pin!(simulator);
    let (mut network_ended, mut simulator_ended) = (None, None);
    tokio::select! {
        result = &mut network => network_ended = Some(flatten(result)),
        result = &mut simulator => simulator_ended = Some(result),
        () = stop.cancelled() => {}
    }
    stop.cancel();
    let rest = async {
        if network_ended.is_none() {
            network_ended = Some(flatten((&mut network).await));
        }
        if simulator_ended.is_none() {
            simulator_ended = Some((&mut simulator).await);
        }
    };
    let in_time = tokio::time::timeout(grace, rest).await.is_ok();
    network.abort();
    // What went wrong first is what a person wants to know; a late end is only said if nothing else is.
    if let Some(Err(error)) = simulator_ended {
        return Err(error);
    }
    match network_ended {
        Some(Err(error)) => Err(error),
        _ if !in_time => Err(ActorError::Grace { seconds: grace.as_secs() }),
        Some(Ok(ending)) => Ok(ending),
        None => Ok(Ending::Stopped),
    }
}

fn flatten(result: Result<Result<Ending, ActorError>, tokio::task::JoinError>) -> Result<Ending, ActorError> {
    result.unwrap_or_else(|error| {
        Err(ActorError::Thread { problem: format!("lost its network tasks: {error}") })
    })
}

/// Asks SUMO for its version, which also shows that it starts.
async fn sumo_version(home: SumoHome) -> Result<String, ActorError> {
    let failed = |problem: String| ActorError::Option { option: "--sumo-home", problem };
    tokio::task::spawn_blocking(move || home.version())
        .await
        .map_err(|error| failed(format!("could not be checked: {error}")))?
        .map_err(|error| failed(format!("names no SUMO that works: {error}")))
}
