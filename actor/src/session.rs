//! The actor's life with a learner that may come and go.
//!
//! ```text
//!        ┌─────────────────────────── back off, give up after a while ───────────────────────────┐
//!        v                                                                                       │
//!      connect ── same session? ── no ──> join, check the scenarios ──> streams: fragments ──────┤ lost
//!                        └──────── yes: just open the streams again ──>          weights         │
//!                                                                                   └─ goodbye, complete: end
//! ```
//! A session is one life of a learner process. While the connection is away the simulator goes on until the bounded
//! queues are full; when another session begins it abandons its episode.

use crate::backoff::Backoff;
use crate::error::ActorError;
use crate::join::{self, Attempt, Joined, Joiner};
use crate::link::{Directions, NetworkEnd};
use crate::stream::{self, StreamEnd};
use crate::telemetry::{Dropped, Telemetry};
use crate::uplink::Uplink;
use crate::weights;
use cross_config::Config;
use cross_proto::status::Reason;
use cross_sim::layout::NetworkLayout;
use cross_sim::scenario::Scenario;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// How often in a row the learner may refuse a fragment before the actor takes itself for broken.
const MAX_REFUSALS: u32 = 5;

/// Time for a goodbye after the stream of weights has ended.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// A learner process's session, as this actor joined it.
#[derive(Debug)]
pub struct Session {
    /// Number of this join within the process. Joining again, in the same session too, means that the learner has given
    /// up whatever episode this actor was at.
    pub join: u64,
    /// Tells it from the sessions of the same learner before and after.
    pub epoch: u64,
    /// The training run.
    pub run_id: String,
    /// The learner's configuration.
    pub config: Config,
    /// Fragments that may be in flight.
    pub unacked_fragments: usize,
    /// Most steps in a fragment.
    pub fragment_steps: u32,
    /// Largest message, bytes.
    pub max_message_bytes: usize,
    /// How often to speak when there is nothing to say.
    pub heartbeat: Duration,
    /// The scenarios that this actor runs, by name.
    pub scenarios: BTreeMap<String, Prepared>,
}

#[cfg(test)]
impl Session {
    /// A session without scenarios.
    pub(crate) fn bare(join: u64, epoch: u64) -> Arc<Self> {
        Arc::new(Self {
            join,
            epoch,
            run_id: "test".to_owned(),
            config: Config::default(),
            unacked_fragments: 4,
            fragment_steps: 4,
            max_message_bytes: 1 << 24,
            heartbeat: Duration::from_secs(5),
            scenarios: BTreeMap::new(),
        })
    }
}

/// A scenario whose net is known to be the learner's.
#[derive(Debug, Clone)]
pub struct Prepared {
    /// The scenario.
    pub scenario: Arc<Scenario>,
    /// Its intersections.
    pub layout: Arc<NetworkLayout>,
    /// Hash of the layout, as fragments carry it.
    pub layout_hash: String,
}

/// How an actor's life with its learner ends well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// Training is complete.
    Complete,
    /// It was told to stop, or the simulator ended.
    Stopped,
}

/// The network half of an actor.
#[derive(Debug)]
pub(crate) struct Network {
    pub(crate) joiner: Joiner,
    pub(crate) link: NetworkEnd,
    pub(crate) telemetry: Arc<Telemetry>,
    pub(crate) stop: CancellationToken,
    /// Overrides the configuration's; also holds before the first join.
    pub(crate) give_up: Option<Duration>,
}

/// Where one connection left the actor.
enum After {
    Ended(Ending),
    /// Try again, after at least this long.
    Retry {
        why: String,
        at_least: Duration,
    },
}

impl Network {
    /// Serves the simulator until training is complete, the actor stops, or it gives up.
    pub(crate) async fn run(mut self) -> Result<Ending, ActorError> {
        let mut uplink = Uplink::new(self.joiner.actor_id.clone());
        let mut backoff = Backoff::new(self.joiner.jitter_seed());
        let mut refusals = 0;
        let mut outage = Outage::default();
        let mut heard = Instant::now();
        loop {
            let mut contact = Contact { heard, progress: false, another_session: false, refused: None };
            let after = self.connection(&mut uplink, &mut contact).await;
            self.telemetry.disconnected();
            heard = contact.heard;
            if contact.another_session {
                // The outage is over: a learner waits to be joined.
                backoff.reset();
            }
            if contact.progress {
                outage = Outage::default();
                backoff.reset();
                refusals = 0;
            }
            if let Some(message) = contact.refused {
                refusals += 1;
                if refusals >= MAX_REFUSALS {
                    let learner = self.joiner.learner.clone();
                    return Err(ActorError::FragmentsRefused { learner, times: refusals, message });
                }
            }
            let (why, at_least) = match after? {
                After::Ended(ending) => return Ok(ending),
                After::Retry { why, at_least } => (why, at_least),
            };
            if self.stop.is_cancelled() {
                return Ok(Ending::Stopped);
            }
            let alone = heard.elapsed();
            if alone >= self.give_up() {
                let learner = self.joiner.learner.clone();
                return Err(ActorError::GaveUp { learner, seconds: alone.as_secs(), last: why });
            }
            let pause = backoff.pause().max(at_least).min(self.give_up() - alone);
            self.telemetry.reconnect();
            outage.report(&self.joiner.learner, &why, self.give_up() - alone);
            tokio::select! {
                () = self.stop.cancelled() => return Ok(Ending::Stopped),
                () = tokio::time::sleep(pause) => {}
            }
        }
    }

    /// One connection from its start to its end.
    async fn connection(&mut self, uplink: &mut Uplink, contact: &mut Contact) -> Result<After, ActorError> {
        let stop = self.stop.clone();
        let known = self.link.session.borrow().clone();
        let attempt = tokio::select! {
            () = stop.cancelled() => return Ok(After::Ended(Ending::Stopped)),
            attempt = self.joiner.connect(known.as_ref()) => attempt?,
        };
        let Joined { client, session } = match attempt {
            Attempt::Joined(joined) => joined,
            Attempt::NotYet { why, at_least, answered } => {
                if answered {
                    contact.heard = Instant::now();
                }
                return Ok(After::Retry { why, at_least });
            }
        };
        if known.is_none() {
            // It has just been joined.
            contact.heard = Instant::now();
        }
        self.adopt(&session);
        let dropped = uplink.open(session.join, session.epoch, session.unacked_fragments);
        self.telemetry.dropped(Dropped::OldSession, dropped);

        let end = {
            let watching = weights::watch(
                client.clone(),
                &self.joiner.actor_id,
                session.epoch,
                &self.link.snapshot,
                &self.telemetry,
                Backoff::new(self.joiner.jitter_seed()),
            );
            let streaming = stream::Stream {
                client,
                session: &session,
                uplink,
                session_slot: &self.link.session,
                directions: &self.link.directions,
                assignments: &self.link.assignments,
                records: &mut self.link.records,
                telemetry: &self.telemetry,
                contact,
                stop: &stop,
            }
            .run();
            let mut streaming = std::pin::pin!(streaming);
            tokio::select! {
                end = &mut streaming => end,
                status = watching => {
                    // A learner that leaves closes both streams; its goodbye may still be on the way.
                    tokio::time::timeout(LAST_WORDS, streaming).await.unwrap_or(StreamEnd::Lost(status))
                }
            }
        };
        Ok(match end {
            StreamEnd::Complete => After::Ended(Ending::Complete),
            StreamEnd::Flushed => After::Ended(Ending::Stopped),
            StreamEnd::Paused => {
                self.forget_session();
                After::Retry { why: "it stops for now".to_owned(), at_least: Duration::ZERO }
            }
            StreamEnd::Lost(status) => self.lost(&status, uplink, contact)?,
        })
    }

    /// Decides what a broken connection means.
    fn lost(
        &mut self,
        status: &tonic::Status,
        uplink: &mut Uplink,
        contact: &mut Contact,
    ) -> Result<After, ActorError> {
        let at_least = cross_proto::status::retry_delay(status).unwrap_or_default();
        if cross_proto::status::reason(status).is_some() {
            contact.heard = Instant::now();
        }
        match cross_proto::status::reason(status) {
            // The lease or the session is over: the next connection joins anew.
            Some(Reason::NotJoined | Reason::Draining) => self.forget_session(),
            Some(Reason::OldSession) => {
                self.forget_session();
                contact.another_session = true;
            }
            Some(Reason::InvalidField | Reason::UnexpectedMessage | Reason::MessageTooLarge) => {
                // Sending the same again would be refused again; the episode cannot be continued without it.
                let dropped = uplink.discard_unacked();
                self.telemetry.dropped(Dropped::Refused, dropped);
                self.forget_session();
                contact.refused = Some(join::sentence(status));
            }
            _ if join::is_fatal(status) => {
                let learner = self.joiner.learner.clone();
                return Err(ActorError::Refused { learner, message: join::sentence(status) });
            }
            _ => {}
        }
        Ok(After::Retry { why: join::sentence(status), at_least })
    }

    /// Makes `session` the one that the simulator works for.
    fn adopt(&self, session: &Arc<Session>) {
        let epoch = session.epoch;
        self.link.directions.send_if_modified(|directions| {
            let changed = directions.epoch != epoch;
            if changed {
                *directions = Directions { epoch, ..Directions::default() };
            }
            changed
        });
        self.telemetry.scenarios(session.scenarios.keys());
        self.link.session.send_replace(Some(Arc::clone(session)));
    }

    /// Has the simulator abandon its episode and wait for another session.
    fn forget_session(&self) {
        self.link.session.send_replace(None);
    }

    fn give_up(&self) -> Duration {
        self.give_up.unwrap_or_else(|| {
            let seconds = match self.link.session.borrow().as_ref() {
                Some(session) => session.config.actor.give_up_seconds,
                None => cross_config::ActorConfig::default().give_up_seconds,
            };
            Duration::from_secs(seconds)
        })
    }
}

/// A time without a learner. Thousands of lines of retries would bury the one that says why it began.
#[derive(Debug, Default)]
struct Outage {
    last: Option<String>,
}

impl Outage {
    /// Logs a failed attempt, loudly if it tells something new.
    fn report(&mut self, learner: &str, why: &str, left: Duration) {
        if self.last.as_deref() == Some(why) {
            tracing::debug!(learner, "still not working for a learner: {why}");
        } else {
            tracing::warn!(
                learner,
                give_up_seconds = left.as_secs(),
                "not working for a learner, trying again: {why}"
            );
            self.last = Some(why.to_owned());
        }
    }
}

/// Signs of life of the learner during one connection.
#[derive(Debug)]
pub(crate) struct Contact {
    /// When it last said anything.
    pub(crate) heard: Instant,
    /// True once it took or gave something: then the connection was worth something, and back-off starts over.
    pub(crate) progress: bool,
    /// True if another learner process than before has answered.
    pub(crate) another_session: bool,
    /// What it said if it refused a fragment.
    pub(crate) refused: Option<String>,
}
