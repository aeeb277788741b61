//! `cross.v1.Learner`: admission and the two long streams.

use super::{COME_AGAIN, Shared, fragments, weights};
use crate::admission::JoinRefusal;
use crate::coordinator::{JoinInfo, Request as Ask};
use cross_proto::ids::ActorId;
use cross_proto::status::{self, Reason};
use cross_proto::{PROTOCOL_VERSION, v1};
use futures::stream::BoxStream;
use tonic::{Request, Response, Status, Streaming};

#[derive(Debug)]
pub(super) struct LearnerService {
    shared: Shared,
}

impl LearnerService {
    pub(super) fn new(shared: Shared) -> Self {
        Self { shared }
    }

    /// What must agree before an actor may be of use.
    fn check(&self, request: &v1::JoinRequest) -> Result<(), Status> {
        ActorId::parse(&request.actor_id, "actor_id")?;
        let protocol = request.versions.as_ref().map_or(0, |versions| versions.protocol);
        if protocol != PROTOCOL_VERSION {
            return Err(status::protocol_mismatch(protocol, PROTOCOL_VERSION));
        }
        let own = self.shared.config.compatibility_hash();
        if !request.config_hash.is_empty() && request.config_hash != own {
            return Err(status::config_mismatch(&request.config_hash, &own));
        }
        Ok(())
    }

    fn answer(&self) -> v1::JoinResponse {
        let config = &self.shared.config;
        let small = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
        v1::JoinResponse {
            run_id: self.shared.run_id.clone(),
            session_epoch: self.shared.session_epoch,
            config_json: config.to_json(),
            config_hash: config.compatibility_hash(),
            scenarios: self
                .shared
                .specs
                .iter()
                .map(|spec| v1::ScenarioInfo {
                    name: spec.scenario.clone(),
                    layout_hash: spec.layout_hash.clone(),
                    agents: small(spec.agents()),
                })
                .collect(),
            limits: Some(v1::Limits {
                unacked_fragments: small(self.shared.unacked_fragments),
                fragment_steps: config.actor.fragment_steps,
                max_message_bytes: config.learner.max_message_bytes as u64,
                lease_seconds: u32::try_from(config.learner.lease_seconds).unwrap_or(u32::MAX),
            }),
            versions: Some(v1::Versions {
                protocol: PROTOCOL_VERSION,
                cross: env!("CARGO_PKG_VERSION").to_owned(),
                sumo: String::new(),
                libtorch: cross_model::libtorch_version().to_owned(),
            }),
            policy_version: self.shared.newest.borrow().as_ref().map_or(0, |newest| newest.policy_version),
        }
    }
}

/// A refusal as the wire tells it.
fn refused(refusal: &JoinRefusal) -> Status {
    match refusal {
        JoinRefusal::TooManyActors { limit } => status::too_many_actors(*limit, COME_AGAIN),
        JoinRefusal::SerialTaken { .. } => {
            status::retry_after(Reason::TooManyActors, refusal.to_string(), COME_AGAIN)
        }
        JoinRefusal::NoScenario { .. } => status::error(Reason::NoScenario, refusal.to_string()),
    }
}

#[tonic::async_trait]
impl cross_proto::server::Learner for LearnerService {
    type StreamFragmentsStream = BoxStream<'static, Result<v1::StreamFragmentsResponse, Status>>;
    type WatchWeightsStream = BoxStream<'static, Result<v1::WatchWeightsResponse, Status>>;

    async fn join(&self, request: Request<v1::JoinRequest>) -> Result<Response<v1::JoinResponse>, Status> {
        let request = request.into_inner();
        self.check(&request)?;
        self.shared.serving().await?;
        let join = JoinInfo {
            actor: request.actor_id,
            host: request.host,
            scenarios: request.scenarios,
            sumo: request.versions.unwrap_or_default().sumo,
        };
        let admitted = self.shared.coordinator.ask(|reply| Ask::Join(join, reply)).await?;
        admitted.map_err(|refusal| refused(&refusal))?;
        Ok(Response::new(self.answer()))
    }

    async fn stream_fragments(
        &self,
        request: Request<Streaming<v1::StreamFragmentsRequest>>,
    ) -> Result<Response<Self::StreamFragmentsStream>, Status> {
        self.shared.serving().await?;
        let answers = fragments::open(&self.shared, request.into_inner()).await?;
        Ok(Response::new(Box::pin(answers)))
    }

    async fn watch_weights(
        &self,
        request: Request<v1::WatchWeightsRequest>,
    ) -> Result<Response<Self::WatchWeightsStream>, Status> {
        let request = request.into_inner();
        ActorId::parse(&request.actor_id, "actor_id")?;
        let (newest, closing) = (self.shared.newest.clone(), self.shared.closing.clone());
        Ok(weights::subscribe(newest, request.known_version, closing))
    }
}
