//! One fragment stream, from its hello to its end: moves messages between the wire, the uplink and the simulator.

use crate::link::{Directions, Record};
use crate::session::{Contact, Session};
use crate::telemetry::{Dropped, Telemetry};
use crate::uplink::{Accepted, Uplink};
use cross_proto::client::LearnerClient;
use cross_proto::v1::stream_fragments_response::Message;
use cross_proto::v1::{self, Outcome};
use cross_support::client::Connection;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::{Status, Streaming};

/// Filter that has every acknowledgement logged, `--log info,cross_actor::fragments=debug`: the other end of the learner's
/// journal of fragments.
const JOURNAL: &str = "cross_actor::fragments";
/// Time for the learner to answer a hello.
const HELLO_TIMEOUT: Duration = Duration::from_secs(30);
/// Time for the last acknowledgements once the simulator has ended.
const FLUSH: Duration = Duration::from_secs(2);

/// How a stream ended.
#[derive(Debug)]
pub(crate) enum StreamEnd {
    /// The learner says that training is complete.
    Complete,
    /// The learner leaves for now.
    Paused,
    /// The simulator has ended, and all it had is sent, or time was up.
    Flushed,
    /// Broken or refused.
    Lost(Status),
}

/// What a stream works with.
pub(crate) struct Stream<'a> {
    pub(crate) client: LearnerClient<Connection>,
    pub(crate) session: &'a Session,
    pub(crate) uplink: &'a mut Uplink,
    pub(crate) session_slot: &'a watch::Sender<Option<Arc<Session>>>,
    pub(crate) directions: &'a watch::Sender<Directions>,
    pub(crate) assignments: &'a mpsc::Sender<(u64, v1::EpisodeAssignment)>,
    pub(crate) records: &'a mut mpsc::Receiver<(u64, Record)>,
    pub(crate) telemetry: &'a Telemetry,
    pub(crate) contact: &'a mut Contact,
    pub(crate) stop: &'a CancellationToken,
}

impl Stream<'_> {
    /// Runs the stream.
    pub(crate) async fn run(mut self) -> StreamEnd {
        // One message in the queue, so that what waits, waits in the uplink's bounded bookkeeping.
        let (sender, receiver) = mpsc::channel(1);
        if let Some(hello) = self.uplink.next_message() {
            // The queue was made empty.
            let _ = sender.try_send(hello);
        }
        let opening = self.client.stream_fragments(ReceiverStream::new(receiver));
        let answer = tokio::select! {
            answer = tokio::time::timeout(HELLO_TIMEOUT, opening) => answer,
            () = self.stop.cancelled() => return self.flushed(),
        };
        let inbound = match answer {
            Ok(Ok(response)) => response.into_inner(),
            Ok(Err(status)) => return StreamEnd::Lost(status),
            Err(_) => return StreamEnd::Lost(Status::deadline_exceeded("no answer to the stream's hello")),
        };
        self.telemetry.connected();
        let end = self.exchange(sender, inbound).await;
        // However little it said, it was there until now: keepalive would have noticed otherwise.
        self.contact.heard = Instant::now();
        end
    }

    async fn exchange(
        &mut self,
        sender: mpsc::Sender<v1::StreamFragmentsRequest>,
        mut inbound: Streaming<v1::StreamFragmentsResponse>,
    ) -> StreamEnd {
        let mut sender = Some(sender);
        // Set once the simulator has ended.
        let mut flush_until: Option<Instant> = None;
        let mut stopping = false;
        let mut silence = tokio::time::interval(self.session.heartbeat);
        silence.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            if flush_until.is_some() && self.uplink.is_idle() {
                // Ends our direction; the learner answers by ending its own.
                sender = None;
            }
            tokio::select! {
                message = inbound.message() => match message {
                    Ok(Some(response)) => {
                        if let Some(end) = self.receive(response) {
                            return end;
                        }
                    }
                    Ok(None) if sender.is_none() => return StreamEnd::Flushed,
                    Ok(None) => {
                        return StreamEnd::Lost(Status::unavailable("the learner closed the fragment stream"));
                    }
                    Err(_) if sender.is_none() => return StreamEnd::Flushed,
                    Err(status) => return StreamEnd::Lost(status),
                },
                permit = reserve(sender.as_ref()), if sender.is_some() && self.uplink.has_message() => {
                    // If the receiving side is gone, the response stream says why.
                    if let (Some(permit), Some(message)) = (permit, self.uplink.next_message()) {
                        permit.send(message);
                        silence.reset();
                    }
                }
                // Of an actor that stops only a last fragment and an abort can come, and they must not wait for
                // acknowledgements that a learner with a full buffer withholds.
                record = self.records.recv(), if flush_until.is_none() && (stopping || self.uplink.has_room()) => {
                    match record {
                        Some((join, record)) => self.accept(join, record),
                        None => flush_until = Some(Instant::now() + FLUSH),
                    }
                }
                () = self.stop.cancelled(), if !stopping => stopping = true,
                _ = silence.tick() => self.uplink.heartbeat(),
                () = sleep_until(flush_until) => return self.flushed(),
            }
        }
    }

    /// Counts what the learner has not taken when the actor ends.
    fn flushed(&mut self) -> StreamEnd {
        let mut lost = self.uplink.unacked();
        while let Ok((_, record)) = self.records.try_recv() {
            lost += usize::from(matches!(record, Record::Fragment(_)));
        }
        self.telemetry.dropped(Dropped::Shutdown, lost);
        StreamEnd::Flushed
    }

    fn accept(&mut self, join: u64, record: Record) {
        if self.uplink.accept(join, record) == (Accepted::OtherSession { fragment: true }) {
            self.telemetry.dropped(Dropped::OldSession, 1);
        }
        self.telemetry.unacked(self.uplink.unacked());
    }

    /// Takes a message; gives the stream's end if it is one.
    fn receive(&mut self, response: v1::StreamFragmentsResponse) -> Option<StreamEnd> {
        match response.message {
            Some(Message::Ack(ack)) => self.acknowledged(&ack),
            Some(Message::Assignment(assignment)) => self.assigned(assignment),
            Some(Message::Goodbye(goodbye)) => {
                tracing::info!(complete = goodbye.complete, "the learner says goodbye");
                return Some(if goodbye.complete { StreamEnd::Complete } else { StreamEnd::Paused });
            }
            None => tracing::warn!("the learner sent a message of a kind that this version does not know"),
        }
        None
    }

    fn acknowledged(&mut self, ack: &v1::Ack) {
        let known = self.uplink.acknowledge(ack.episode, ack.sequence);
        self.telemetry.unacked(self.uplink.unacked());
        self.contact.progress = true;
        let outcome = ack.outcome();
        tracing::debug!(
            target: JOURNAL,
            session = self.session.epoch,
            episode = ack.episode,
            sequence = ack.sequence,
            outcome = outcome.as_str_name(),
            "fragment acknowledged"
        );
        // One fragment that was sent twice is acknowledged twice, but lost at most once.
        if known {
            match outcome {
                Outcome::Stale => self.telemetry.dropped(Dropped::Stale, 1),
                Outcome::OldSession => self.telemetry.dropped(Dropped::OldSession, 1),
                Outcome::UnknownEpisode => self.telemetry.dropped(Dropped::UnknownEpisode, 1),
                Outcome::Accepted | Outcome::Duplicate | Outcome::Unspecified => {}
            }
        }
        self.direct(|directions| {
            directions.min_policy_version = directions.min_policy_version.max(ack.min_policy_version);
            directions.acknowledged = Some((ack.episode, ack.sequence));
            if outcome == Outcome::UnknownEpisode {
                directions.unknown_episode = Some(ack.episode);
            }
        });
        if outcome == Outcome::OldSession {
            // The hello said otherwise, but the learner's word on fragments counts.
            self.session_slot.send_replace(None);
        }
    }

    /// Changes what the simulator has to heed.
    fn direct(&self, change: impl FnOnce(&mut Directions)) {
        let epoch = self.session.epoch;
        self.directions.send_modify(|directions| {
            if directions.epoch != epoch {
                *directions = Directions { epoch, ..Directions::default() };
            }
            change(directions);
        });
    }

    fn assigned(&mut self, assignment: v1::EpisodeAssignment) {
        self.contact.progress = true;
        let episode = assignment.episode;
        // It may be one that this actor failed at before: what was said of the first try does not hold for the second.
        self.direct(|directions| {
            directions.acknowledged = None;
            directions.unknown_episode = None;
        });
        // The simulator asks for one episode at a time, so there is room for an assignment that it asked for.
        let taken =
            self.uplink.assigned() && self.assignments.try_send((self.session.join, assignment)).is_ok();
        if !taken {
            tracing::warn!(episode, "the learner assigned an episode that nobody asked for");
            self.accept(
                self.session.join,
                Record::Aborted { episode, reason: crate::episode::REASON_SESSION_CHANGED },
            );
        }
    }
}

async fn reserve<T>(sender: Option<&mpsc::Sender<T>>) -> Option<mpsc::Permit<'_, T>> {
    match sender {
        Some(sender) => match sender.reserve().await {
            Ok(permit) => Some(permit),
            // The call is over, and the response stream is about to tell how; until then there is nothing to do here.
            Err(_) => std::future::pending().await,
        },
        None => std::future::pending().await,
    }
}

async fn sleep_until(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => tokio::time::sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}
