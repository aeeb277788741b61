//! Where answers to actors go: one bounded queue per stream.

use crate::admission::{CloseReason, Outcome, StreamId};
use cross_proto::Violation;
use cross_proto::status::{self, Reason};
use cross_proto::v1::{self, stream_fragments_response::Message};
use std::collections::HashMap;
use tokio::sync::mpsc;
use tokio_util::sync::{CancellationToken, DropGuard};
use tonic::Status;

/// The coordinator's end of a stream. Dropping it ends the stream in both directions.
#[derive(Debug)]
pub(crate) struct Outbox {
    sender: mpsc::Sender<Result<v1::StreamFragmentsResponse, Status>>,
    _reader: DropGuard,
}

impl Outbox {
    /// `reader` stops whoever reads the stream's other direction.
    pub(crate) fn new(
        sender: mpsc::Sender<Result<v1::StreamFragmentsResponse, Status>>,
        reader: CancellationToken,
    ) -> Self {
        Self { sender, _reader: reader.drop_guard() }
    }
}

/// All open streams.
#[derive(Debug, Default)]
pub(super) struct Outboxes(HashMap<StreamId, Outbox>);

impl Outboxes {
    pub(super) fn open(&mut self, stream: StreamId, outbox: Outbox) {
        self.0.insert(stream, outbox);
    }

    pub(super) fn forget(&mut self, stream: StreamId) {
        self.0.remove(&stream);
    }

    /// Queues a message; false if the stream's reader is gone or too slow, and the stream with it.
    pub(super) fn send(&mut self, stream: StreamId, message: Message) -> bool {
        let Some(outbox) = self.0.get(&stream) else { return false };
        let sent = outbox.sender.try_send(Ok(v1::StreamFragmentsResponse { message: Some(message) })).is_ok();
        if !sent {
            self.0.remove(&stream);
        }
        sent
    }

    /// Ends a stream with an error.
    pub(super) fn close(&mut self, stream: StreamId, status: Status) {
        if let Some(outbox) = self.0.remove(&stream) {
            // If its queue is full the actor learns only that the stream is over, and asks again.
            let _ = outbox.sender.try_send(Err(status));
        }
    }

    /// Ends every stream in friendship.
    pub(super) fn goodbye(&mut self, complete: bool) {
        for (_, outbox) in self.0.drain() {
            let message = Some(Message::Goodbye(v1::Goodbye { complete }));
            // As in `close`.
            let _ = outbox.sender.try_send(Ok(v1::StreamFragmentsResponse { message }));
        }
    }
}

pub(super) fn wire_outcome(outcome: Outcome) -> v1::Outcome {
    match outcome {
        Outcome::Accepted => v1::Outcome::Accepted,
        Outcome::Duplicate => v1::Outcome::Duplicate,
        Outcome::Stale => v1::Outcome::Stale,
        Outcome::OldSession => v1::Outcome::OldSession,
        Outcome::UnknownEpisode => v1::Outcome::UnknownEpisode,
        // An invalid fragment is answered by the end of its stream.
        Outcome::Invalid => v1::Outcome::Unspecified,
    }
}

pub(super) fn close_status(reason: CloseReason) -> Status {
    match reason {
        CloseReason::Replaced => {
            status::error(Reason::Superseded, "the same actor id joined or opened a stream elsewhere")
        }
        CloseReason::LeaseEnded => {
            status::error(Reason::NotJoined, "the lease ended after silence; join again")
        }
        CloseReason::Invalid { field, description } => {
            status::invalid(&Violation::new(format!("fragment.{field}"), description))
        }
        CloseReason::TooManyUnacked { limit } => status::error(
            Reason::TooManyInFlight,
            format!("more than {limit} fragments are not acknowledged, which is Limits.unacked_fragments"),
        ),
    }
}
