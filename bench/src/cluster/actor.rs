//! A simulated actor: joins, asks for episodes, and sends recorded fragments under the rules of a real one.
//!
//! The bookkeeping is the actor crate's own ([`Uplink`]): how many fragments may be in flight, what is kept until it is
//! acknowledged. In place of the simulator there is a [`Script`] that always has the next fragment ready.

use super::client::{self, failed};
use super::recording::Recording;
use crate::error::BenchError;
use cross_actor::link::Record;
use cross_actor::uplink::Uplink;
use cross_proto::client::LearnerClient;
use cross_proto::v1::stream_fragments_response::Message;
use cross_proto::v1::{self, Outcome};
use cross_support::client::Connection;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

/// Number of the join, of which a simulated actor has one.
const JOIN: u64 = 1;
/// What the learner's default configuration allows, for the bare server, which allows anything.
const UNACKED: usize = 2;
/// How often to speak when there is nothing to say; leases are longer.
const HEARTBEAT: Duration = Duration::from_secs(5);

/// Whom an actor speaks to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Peer {
    /// A learner, which admits it and hands out episodes.
    Learner,
    /// The bare server, which only acknowledges, in order.
    Bare,
}

/// A fragment that was acknowledged.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Acknowledged {
    /// From the moment the stream took it until the word came back.
    pub(crate) after: Duration,
    /// Decisions in it.
    pub(crate) decisions: usize,
}

/// A fragment that waits for its acknowledgement.
#[derive(Debug)]
struct InFlight {
    episode: u64,
    sequence: u32,
    at: Instant,
    decisions: usize,
}

impl InFlight {
    /// Of a message that is about to be sent; `None` if it holds no fragment.
    fn of(request: &v1::StreamFragmentsRequest) -> Option<Self> {
        let Some(v1::stream_fragments_request::Message::Fragment(fragment)) = &request.message else {
            return None;
        };
        let v1::Fragment { episode, sequence, actions, .. } = fragment;
        Some(Self { episode: *episode, sequence: *sequence, at: Instant::now(), decisions: actions.len() })
    }
}

/// A simulated actor with its streams open.
#[derive(Debug)]
pub(crate) struct Actor {
    script: Script,
    uplink: Uplink,
    sender: mpsc::Sender<v1::StreamFragmentsRequest>,
    inbound: Streaming<v1::StreamFragmentsResponse>,
    /// Sent and not acknowledged, oldest first.
    in_flight: VecDeque<InFlight>,
    limit: usize,
    /// Held open as a real actor's is; nothing new comes on it unless the learner learns.
    _weights: Streaming<v1::WatchWeightsResponse>,
    heartbeat: tokio::time::Interval,
}

impl Actor {
    /// Connects, joins and opens both streams.
    pub(crate) async fn open(
        peer: Peer,
        address: &str,
        id: String,
        recording: Arc<Recording>,
    ) -> Result<Self, BenchError> {
        let mut learner = client::learner(client::connect(address).await?);
        let joined = match peer {
            Peer::Learner => join(&mut learner, &id, &recording).await?,
            Peer::Bare => v1::JoinResponse { policy_version: 1, ..v1::JoinResponse::default() },
        };
        let limits = joined.limits.unwrap_or_default();
        let limit = match peer {
            Peer::Learner => usize::try_from(limits.unacked_fragments).unwrap_or(UNACKED),
            Peer::Bare => UNACKED,
        };
        let mut uplink = Uplink::new(id.clone());
        // An actor that has sent nothing yet has nothing to drop.
        let _ = uplink.open(JOIN, joined.session_epoch, limit);
        // One message in the queue, as a real actor's stream has.
        let (sender, receiver) = mpsc::channel(1);
        if let Some(hello) = uplink.next_message() {
            // The queue was made empty.
            let _ = sender.try_send(hello);
        }
        let inbound = learner
            .stream_fragments(ReceiverStream::new(receiver))
            .await
            .map_err(failed("StreamFragments"))?;
        let request = v1::WatchWeightsRequest { actor_id: id.clone(), known_version: joined.policy_version };
        let weights = learner.watch_weights(request).await.map_err(failed("WatchWeights"))?;
        let mut heartbeat = tokio::time::interval(HEARTBEAT);
        heartbeat.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        heartbeat.reset();
        Ok(Self {
            script: Script::new(peer, id, &joined, recording),
            uplink,
            sender,
            inbound: inbound.into_inner(),
            in_flight: VecDeque::new(),
            limit,
            _weights: weights.into_inner(),
            heartbeat,
        })
    }

    /// Version of the policy that its next fragments claim to be of.
    pub(crate) fn acts_on(&mut self, policy_version: u64) {
        self.script.policy_version = policy_version;
    }

    /// Hands the next record to the uplink, if there is room for one; whether that was a fragment.
    pub(crate) fn offer(&mut self) -> bool {
        if !self.uplink.has_room() {
            return false;
        }
        let Some(record) = self.script.next() else { return false };
        let fragment = matches!(record, Record::Fragment(_));
        // Made under the only join that there is.
        let _ = self.uplink.accept(JOIN, record);
        fragment
    }

    /// True when everything is sent and acknowledged.
    pub(crate) fn is_idle(&self) -> bool {
        self.uplink.is_idle()
    }

    /// True when as many fragments are in flight as may be.
    pub(crate) fn is_held_back(&self) -> bool {
        self.in_flight.len() >= self.limit
    }

    /// Waits until a message has come or one could be sent; the fragment that it acknowledges, if it does. Nothing is lost
    /// if it is dropped before.
    pub(crate) async fn turn(&mut self) -> Result<Option<Acknowledged>, BenchError> {
        let Self { script, uplink, sender, inbound, in_flight, heartbeat, .. } = self;
        let message = tokio::select! {
            message = inbound.message() => message.map_err(failed("StreamFragments"))?,
            permit = sender.reserve(), if uplink.has_message() => {
                // If the receiving side is gone, the response stream says why at the next turn.
                if let (Ok(permit), Some(message)) = (permit, uplink.next_message()) {
                    in_flight.extend(InFlight::of(&message));
                    permit.send(message);
                    heartbeat.reset();
                }
                return Ok(None);
            }
            _ = heartbeat.tick(), if script.peer == Peer::Learner => {
                uplink.heartbeat();
                return Ok(None);
            }
        };
        match message {
            Some(response) => self.heard(response),
            None => Err(failed("StreamFragments")(Status::unavailable("the stream ended"))),
        }
    }

    fn heard(&mut self, response: v1::StreamFragmentsResponse) -> Result<Option<Acknowledged>, BenchError> {
        let ack = match response.message {
            Some(Message::Ack(ack)) => ack,
            Some(Message::Assignment(assignment)) => {
                self.script.assigned(assignment.episode);
                let _ = self.uplink.assigned();
                return Ok(None);
            }
            Some(Message::Goodbye(_)) | None => {
                return Err(failed("StreamFragments")(Status::unavailable("the learner leaves")));
            }
        };
        let is_meant = |sent: &InFlight| (sent.episode, sent.sequence) == (ack.episode, ack.sequence);
        let at = match self.script.peer {
            Peer::Learner => self.in_flight.iter().position(is_meant),
            Peer::Bare => Some(0),
        };
        let Some(sent) = at.and_then(|at| self.in_flight.remove(at)) else {
            return Err(BenchError::AcknowledgedTwice { episode: ack.episode, sequence: ack.sequence });
        };
        let _ = self.uplink.acknowledge(sent.episode, sent.sequence);
        if ack.outcome() != Outcome::Accepted {
            return Err(BenchError::NotAccepted { outcome: ack.outcome().as_str_name() });
        }
        Ok(Some(Acknowledged { after: sent.at.elapsed(), decisions: sent.decisions }))
    }
}

async fn join(
    learner: &mut LearnerClient<Connection>,
    id: &str,
    recording: &Recording,
) -> Result<v1::JoinResponse, BenchError> {
    let request = v1::JoinRequest {
        actor_id: id.to_owned(),
        host: "bench".to_owned(),
        versions: Some(v1::Versions {
            protocol: cross_proto::PROTOCOL_VERSION,
            cross: env!("CARGO_PKG_VERSION").to_owned(),
            ..v1::Versions::default()
        }),
        scenarios: recording
            .fragments
            .first()
            .map(|fragment| fragment.scenario.clone())
            .into_iter()
            .collect(),
        config_hash: String::new(),
    };
    Ok(learner.join(request).await.map_err(failed("Join"))?.into_inner())
}

/// What an actor has to say: a request, then the episode's fragments, and again.
#[derive(Debug)]
struct Script {
    peer: Peer,
    id: String,
    session_epoch: u64,
    policy_version: u64,
    recording: Arc<Recording>,
    /// The episode that was assigned, and its next fragment.
    episode: Option<(u64, usize)>,
    /// Episodes that it gave itself.
    own: u64,
    requested: bool,
}

impl Script {
    fn new(peer: Peer, id: String, joined: &v1::JoinResponse, recording: Arc<Recording>) -> Self {
        Self {
            peer,
            id,
            session_epoch: joined.session_epoch,
            policy_version: joined.policy_version,
            recording,
            episode: None,
            own: 0,
            requested: false,
        }
    }

    fn assigned(&mut self, episode: u64) {
        self.requested = false;
        self.episode = Some((episode, 0));
    }

    /// The next record; `None` while it waits for an episode.
    fn next(&mut self) -> Option<Record> {
        let Some((episode, at)) = self.episode else {
            if self.peer == Peer::Bare {
                // Nobody there to ask.
                self.own += 1;
                self.episode = Some((self.own, 0));
                return self.next();
            }
            return (!std::mem::replace(&mut self.requested, true)).then_some(Record::Request);
        };
        let mut fragment = self.recording.fragments.get(at)?.clone();
        self.episode = (at + 1 < self.recording.fragments.len()).then_some((episode, at + 1));
        fragment.actor_id.clone_from(&self.id);
        fragment.session_epoch = self.session_epoch;
        fragment.episode = episode;
        fragment.policy_version = self.policy_version;
        Some(Record::Fragment(Box::new(fragment)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn script(peer: Peer) -> Script {
        let joined = v1::JoinResponse { session_epoch: 7, policy_version: 3, ..v1::JoinResponse::default() };
        Script::new(peer, "a".to_owned(), &joined, Arc::new(Recording::made_up(2)))
    }

    fn fragment(record: Option<Record>) -> v1::Fragment {
        match record {
            Some(Record::Fragment(fragment)) => *fragment,
            other => panic!("{other:?} is no fragment"),
        }
    }

    #[test]
    fn a_learner_is_asked_once_for_each_episode() {
        let mut script = script(Peer::Learner);
        assert_eq!(script.next(), Some(Record::Request));
        assert_eq!(script.next(), None, "it waits for the answer");
        script.assigned(5);
        let first = fragment(script.next());
        assert_eq!((first.episode, first.session_epoch, first.policy_version), (5, 7, 3));
        assert_eq!(first.actor_id, "a");
        let _ = fragment(script.next());
        assert_eq!(script.next(), Some(Record::Request));
    }

    #[test]
    fn nobody_assigns_at_the_bare_server() {
        let mut script = script(Peer::Bare);
        let episodes: Vec<u64> = (0..5).map(|_| fragment(script.next()).episode).collect();
        assert_eq!(episodes, [1, 1, 2, 2, 3]);
    }
}
