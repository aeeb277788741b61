//! What goes up the fragment stream, and what has to go up again: bookkeeping without I/O.
//!
//! ```text
//!   accept ──> unacked ──────────────> acknowledge   (leaves)
//!        └──> outbox ──> next_message      │
//!               ^── open: a new stream starts with hello and everything unacked
//! ```
//! A fragment stays in `unacked` until the learner has acknowledged it, whatever happens to the connection. What belongs
//! to an earlier session of the learner is dropped, and the drop is returned so that the caller counts it.

use crate::link::Record;
use cross_proto::v1::{self, stream_fragments_request::Message};
use std::collections::VecDeque;

/// State of the uplink of one actor over all its connections.
#[derive(Debug)]
pub struct Uplink {
    actor_id: String,
    /// Number of the join that the simulator's records have to be of.
    join: u64,
    epoch: u64,
    limit: usize,
    /// Sent or waiting to be sent, oldest first; at most `limit`.
    unacked: VecDeque<v1::Fragment>,
    /// True from an episode request to its assignment.
    requested: bool,
    /// Messages for the open stream, in order. Bounded by `limit` and a few words: see [`Uplink::has_room`].
    outbox: VecDeque<Message>,
}

/// What became of a record that the simulator handed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Accepted {
    /// It will be sent.
    Queued,
    /// It was made under another join and is dropped; true if it was a fragment.
    OtherSession {
        /// Whether data was lost with it.
        fragment: bool,
    },
}

impl Uplink {
    /// An uplink that has not met a learner yet.
    #[must_use]
    pub fn new(actor_id: String) -> Self {
        Self {
            actor_id,
            join: 0,
            epoch: 0,
            limit: 1,
            unacked: VecDeque::new(),
            requested: false,
            outbox: VecDeque::new(),
        }
    }

    /// Starts a stream of session `epoch`, which this actor entered by its join number `join`, with at most `limit`
    /// fragments in flight; returns how many fragments of an earlier session are dropped.
    ///
    /// In the same session everything unacknowledged is sent again. So is a request that was not answered, unless the
    /// actor had to join anew: its simulator then asks by itself.
    pub fn open(&mut self, join: u64, epoch: u64, limit: usize) -> usize {
        let mut dropped = 0;
        if join != self.join {
            self.join = join;
            self.requested = false;
        }
        if epoch != self.epoch {
            dropped = self.unacked.len();
            self.unacked.clear();
            self.epoch = epoch;
        }
        self.limit = limit.max(1);
        self.outbox.clear();
        self.outbox.push_back(Message::Hello(v1::StreamHello {
            actor_id: self.actor_id.clone(),
            session_epoch: epoch,
        }));
        self.outbox.extend(self.unacked.iter().cloned().map(Message::Fragment));
        if self.requested {
            self.outbox.push_back(Message::EpisodeRequest(v1::EpisodeRequest {}));
        }
        dropped
    }

    /// True when the next record may be accepted: all is sent, and one more fragment may be in flight.
    #[must_use]
    pub fn has_room(&self) -> bool {
        self.outbox.is_empty() && self.unacked.len() < self.limit
    }

    /// Takes a record that the simulator made under join number `join`.
    pub fn accept(&mut self, join: u64, record: Record) -> Accepted {
        if join != self.join {
            return Accepted::OtherSession { fragment: matches!(record, Record::Fragment(_)) };
        }
        let message = match record {
            Record::Request => {
                self.requested = true;
                Message::EpisodeRequest(v1::EpisodeRequest {})
            }
            Record::Fragment(fragment) => {
                self.unacked.push_back((*fragment).clone());
                Message::Fragment(*fragment)
            }
            Record::Aborted { episode, reason } => {
                Message::EpisodeAborted(v1::EpisodeAborted { episode, reason: reason.to_owned() })
            }
        };
        self.outbox.push_back(message);
        Accepted::Queued
    }

    /// A sign of life, if nothing else is waiting to be sent.
    pub fn heartbeat(&mut self) {
        if self.outbox.is_empty() {
            self.outbox.push_back(Message::Heartbeat(v1::Heartbeat {}));
        }
    }

    /// True when [`Uplink::next_message`] has something.
    #[must_use]
    pub fn has_message(&self) -> bool {
        !self.outbox.is_empty()
    }

    /// What to send next on the open stream.
    pub fn next_message(&mut self) -> Option<v1::StreamFragmentsRequest> {
        self.outbox.pop_front().map(|message| v1::StreamFragmentsRequest { message: Some(message) })
    }

    /// Takes an acknowledgement; false if it is of no fragment in flight (one that was sent twice, say).
    pub fn acknowledge(&mut self, episode: u64, sequence: u32) -> bool {
        match self.unacked.iter().position(|f| f.episode == episode && f.sequence == sequence) {
            Some(index) => {
                self.unacked.remove(index);
                // It may wait to be sent again: the acknowledgement of the first sending makes that needless.
                self.outbox.retain(|message| {
                    !matches!(message, Message::Fragment(f) if f.episode == episode && f.sequence == sequence)
                });
                true
            }
            None => false,
        }
    }

    /// Takes an assignment; false if none was asked for.
    pub fn assigned(&mut self) -> bool {
        std::mem::take(&mut self.requested)
    }

    /// Drops everything unacknowledged, since the learner finds fault with it; returns how many fragments that were.
    pub fn discard_unacked(&mut self) -> usize {
        self.outbox.clear();
        std::mem::take(&mut self.unacked).len()
    }

    /// Fragments that are not acknowledged.
    #[must_use]
    pub fn unacked(&self) -> usize {
        self.unacked.len()
    }

    /// True when everything is sent and acknowledged.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.outbox.is_empty() && self.unacked.is_empty()
    }
}

#[cfg(test)]
#[path = "uplink_tests.rs"]
mod tests;
