//! Reaching the learner and being admitted.

use crate::error::ActorError;
use crate::session::{Prepared, Session};
use cross_config::Config;
use cross_proto::client::LearnerClient;
use cross_proto::status::Reason;
use cross_proto::v1;
use cross_support::client::{ClientSecurity, Connection};
use cross_support::{SecurityError, problem};
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use std::time::Duration;
use tonic::transport::Endpoint;
use tonic::{Code, Status};

/// Time to open a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Time for the answer to a Join; the learner has nothing to compute for it.
const JOIN_TIMEOUT: Duration = Duration::from_secs(30);
/// A connection on which nothing comes back for this and [`KEEPALIVE_TIMEOUT`] is given up: a cut cable sends no word.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(10);
/// Time for the answer to a keepalive ping.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// Room for what surrounds a chunk or a fragment in a message.
const MESSAGE_MARGIN: usize = 64 * 1024;

/// Who asks for admission, and where.
#[derive(Debug, Clone)]
pub(crate) struct Joiner {
    /// Address of the learner, for people.
    pub(crate) learner: String,
    /// The same, ready to connect.
    pub(crate) endpoint: Endpoint,
    /// Adds the token to what is sent there.
    pub(crate) security: ClientSecurity,
    pub(crate) actor_id: String,
    /// Scenarios this actor may run; empty for all.
    pub(crate) scenarios: Vec<String>,
    /// Directory that holds the scenarios, where it is not the usual one.
    pub(crate) scenario_dir: Option<std::path::PathBuf>,
    /// Compatibility hash of the actor's own configuration; empty if it takes the learner's.
    pub(crate) config_hash: String,
    /// Version of SUMO, for the learner's records.
    pub(crate) sumo_version: String,
    /// Joins so far.
    pub(crate) joins: u64,
}

/// A connection that has been admitted.
#[derive(Debug)]
pub(crate) struct Joined {
    pub(crate) client: LearnerClient<Connection>,
    pub(crate) session: Arc<Session>,
}

/// What came of an attempt.
pub(crate) enum Attempt {
    Joined(Joined),
    /// Nobody there, or not now.
    NotYet {
        why: String,
        at_least: Duration,
        /// True if it was the learner who said so.
        answered: bool,
    },
}

/// The endpoint of an address as typed, with the patience that an actor has.
///
/// # Errors
/// [`ActorError::Option`] or [`ActorError::Security`] if it cannot be used.
pub fn endpoint(learner: &str, security: &ClientSecurity, insecure: bool) -> Result<Endpoint, ActorError> {
    let endpoint = security.endpoint(learner, insecure).map_err(|error| match error {
        SecurityError::Address { address, problem } => {
            ActorError::Option { option: "--learner", problem: format!("is {address:?}, which {problem}") }
        }
        error => error.into(),
    })?;
    Ok(endpoint
        .connect_timeout(CONNECT_TIMEOUT)
        .http2_keep_alive_interval(KEEPALIVE_INTERVAL)
        .keep_alive_timeout(KEEPALIVE_TIMEOUT)
        .keep_alive_while_idle(true)
        .tcp_nodelay(true)
        .tcp_keepalive(Some(Duration::from_secs(60))))
}

impl Joiner {
    /// Different for every actor, so that they do not all come back at the same moment.
    pub(crate) fn jitter_seed(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        (&self.actor_id, std::process::id()).hash(&mut hasher);
        hasher.finish()
    }

    /// Connects; joins unless `known` is given, a session that this actor has joined and not left.
    ///
    /// # Errors
    /// [`ActorError`] if trying again cannot help: refused for good, or the scenarios are not the learner's.
    pub(crate) async fn connect(&mut self, known: Option<&Arc<Session>>) -> Result<Attempt, ActorError> {
        let channel = match self.endpoint.connect().await {
            Ok(channel) => channel,
            Err(error) => {
                if let Some(problem) = problem::of_server(&error, &self.learner) {
                    return Err(ActorError::Certificate { problem });
                }
                let why = format!("cannot connect ({})", root_cause(&error));
                return Ok(Attempt::NotYet { why, at_least: Duration::ZERO, answered: false });
            }
        };
        if let Some(session) = known {
            let client = client(self.security.connection(channel), session.max_message_bytes);
            return Ok(Attempt::Joined(Joined { client, session: Arc::clone(session) }));
        }
        let mut request = tonic::Request::new(self.request());
        request.set_timeout(JOIN_TIMEOUT);
        let connection = self.security.connection(channel);
        let response = match LearnerClient::new(connection.clone()).join(request).await {
            Ok(response) => response.into_inner(),
            Err(status) if is_fatal(&status) => {
                return Err(ActorError::Refused {
                    learner: self.learner.clone(),
                    message: sentence(&status),
                });
            }
            Err(status) => {
                // In TLS 1.3 a server looks at the client's certificate when the client already thinks itself connected.
                if let Some(problem) = problem::of_server(&status, &self.learner) {
                    return Err(ActorError::Certificate { problem });
                }
                let at_least = cross_proto::status::retry_delay(&status).unwrap_or_default();
                // Only a learner gives reasons; what transports and proxies say on their own has none.
                let answered = cross_proto::status::reason(&status).is_some();
                return Ok(Attempt::NotYet { why: sentence(&status), at_least, answered });
            }
        };
        self.joins += 1;
        let session = Arc::new(self.prepare(response).await?);
        tracing::info!(
            learner = %self.learner,
            run = %session.run_id,
            session = session.epoch,
            scenarios = ?session.scenarios.keys().collect::<Vec<_>>(),
            "joined"
        );
        let client = client(connection, session.max_message_bytes);
        Ok(Attempt::Joined(Joined { client, session }))
    }

    fn request(&self) -> v1::JoinRequest {
        v1::JoinRequest {
            actor_id: self.actor_id.clone(),
            host: host_name(),
            versions: Some(v1::Versions {
                protocol: cross_proto::PROTOCOL_VERSION,
                cross: env!("CARGO_PKG_VERSION").to_owned(),
                sumo: self.sumo_version.clone(),
                libtorch: cross_model::libtorch_version().to_owned(),
            }),
            scenarios: self.scenarios.clone(),
            config_hash: self.config_hash.clone(),
        }
    }

    /// Checks the learner's answer against what is installed here.
    async fn prepare(&self, response: v1::JoinResponse) -> Result<Session, ActorError> {
        let origin = format!("that the learner at {} sent", self.learner);
        let config = Config::from_json(&response.config_json, &origin)?;
        let limits = response.limits.unwrap_or_default();
        let lease = Duration::from_secs(u64::from(limits.lease_seconds.max(1)));
        let wanted = |name: &str| self.scenarios.is_empty() || self.scenarios.iter().any(|s| s == name);
        let infos: Vec<_> = response.scenarios.into_iter().filter(|info| wanted(&info.name)).collect();
        let scenarios = {
            let (env, names, dir) = (config.env.clone(), config.scenarios.clone(), self.scenario_dir.clone());
            // Reading nets takes up to seconds, which the I/O tasks must not wait for.
            tokio::task::spawn_blocking(move || prepare_scenarios(&infos, &names, dir.as_deref(), &env))
                .await
                .map_err(|error| ActorError::Thread { problem: format!("failed to read nets: {error}") })??
        };
        Ok(Session {
            join: self.joins,
            epoch: response.session_epoch,
            run_id: response.run_id,
            unacked_fragments: usize::try_from(limits.unacked_fragments).unwrap_or(1).max(1),
            fragment_steps: match limits.fragment_steps {
                0 => config.actor.fragment_steps,
                steps => steps.min(config.actor.fragment_steps),
            },
            max_message_bytes: usize::try_from(limits.max_message_bytes)
                .unwrap_or(usize::MAX)
                .clamp(4 * 1024 * 1024, 1 << 30),
            heartbeat: (lease / 3).min(Duration::from_secs(5)),
            config,
            scenarios,
        })
    }
}

/// Loads the scenarios and compares their layouts with the learner's.
fn prepare_scenarios(
    infos: &[v1::ScenarioInfo],
    configured: &[String],
    dir: Option<&std::path::Path>,
    env: &cross_config::EnvConfig,
) -> Result<BTreeMap<String, Prepared>, ActorError> {
    infos
        .iter()
        .map(|info| {
            let scenario = crate::scenarios::load(&info.name, configured, dir)?;
            let layout = cross_sim::layout::load_layout(&scenario, env)
                .map_err(|error| crate::scenarios::unusable(&info.name, error))?;
            let own = layout.hash();
            if own != info.layout_hash {
                let (scenario, learner) = (info.name.clone(), info.layout_hash.clone());
                return Err(ActorError::Layout { scenario, own, learner });
            }
            let prepared = Prepared { scenario: Arc::new(scenario), layout, layout_hash: own };
            Ok((info.name.clone(), prepared))
        })
        .collect()
}

fn client(connection: Connection, max_message_bytes: usize) -> LearnerClient<Connection> {
    // Explicit at both ends: the default of 4 MiB holds for streams too and would break large networks.
    LearnerClient::new(connection)
        .max_decoding_message_size(max_message_bytes + MESSAGE_MARGIN)
        .max_encoding_message_size(max_message_bytes)
}

/// True if coming again cannot help until a person has changed something.
pub(crate) fn is_fatal(status: &Status) -> bool {
    match cross_proto::status::reason(status) {
        // Two actors with one id would throw each other out for ever.
        Some(Reason::Superseded) => true,
        Some(reason) => !reason.heals(),
        None => matches!(
            status.code(),
            Code::Unauthenticated | Code::PermissionDenied | Code::Unimplemented | Code::InvalidArgument
        ),
    }
}

/// A status in words.
pub(crate) fn sentence(status: &Status) -> String {
    match status.code() {
        Code::Unimplemented => "there is a gRPC server, but not a learner of this version".to_owned(),
        _ if cross_proto::status::reason(status).is_some() => status.message().to_owned(),
        _ if std::error::Error::source(status).is_some() => {
            format!("{} ({})", status.message(), root_cause(status))
        }
        code if status.message().is_empty() => format!("{code}"),
        _ => status.message().to_owned(),
    }
}

/// The innermost error: transports wrap what matters ("connection refused") in layers of nothing.
fn root_cause(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}

/// An id that no other actor has, made of characters that ids may have.
pub(crate) fn default_actor_id() -> String {
    let host: String = host_name()
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-') { c } else { '-' })
        .take(100)
        .collect();
    format!("{host}-{}", std::process::id())
}

fn host_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    match name.trim() {
        "" => "unknown".to_owned(),
        name => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_address_is_bad_input() {
        let error = endpoint("learner", &ClientSecurity::default(), false).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("--learner"), "{error}");
    }

    #[test]
    fn mismatches_are_fatal_and_a_draining_learner_is_not() {
        let mismatch = cross_proto::status::protocol_mismatch(1, 2);
        assert!(is_fatal(&mismatch));
        assert!(is_fatal(&cross_proto::status::config_mismatch("a", "b")));
        assert!(is_fatal(&Status::unauthenticated("no token")));
        assert!(!is_fatal(&cross_proto::status::draining(Duration::from_secs(1))));
        assert!(!is_fatal(&cross_proto::status::too_many_actors(1, Duration::from_secs(1))));
        assert!(!is_fatal(&Status::unavailable("connection reset")));
        assert!(!is_fatal(&Status::unknown("h2 protocol error")));
    }
}
