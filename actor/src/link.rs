//! What lies between the two halves of an actor: the simulator thread and the network tasks.
//!
//! ```text
//!   network tasks                                    simulator thread
//!     session      ── watch, latest only ──>           which learner session to work for
//!     snapshot     ── watch, latest only ──>           newest weights; what nobody took in time is replaced
//!     directions   ── watch, latest only ──>           acknowledgements, least policy version
//!     assignments  ── queue of 2 ──────────>           episodes to simulate
//!     records      <────────── queue of 1 ──           fragments, requests, aborts
//! ```
//! Nothing here grows: a simulator that is faster than the learner stops in [`SimulatorEnd::send`]. Every wait of the
//! simulator also ends when the actor stops or the learner's session changes, as a [`Halt`].

use crate::session::Session;
use cross_proto::v1;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

/// Weights as they came, with the session they belong to: after a learner's restart a version may mean other weights.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Session that published it.
    pub epoch: u64,
    /// Policy version and bytes.
    pub weights: cross_proto::weights::Snapshot,
}

/// What the learner has said that the simulator must heed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Directions {
    /// Session that said it.
    pub epoch: u64,
    /// No step may be taken under an older policy version.
    pub min_policy_version: u64,
    /// Newest fragment that was acknowledged, as episode and sequence number.
    pub acknowledged: Option<(u64, u32)>,
    /// An episode that the learner knows nothing of: its fragments are dropped there.
    pub unknown_episode: Option<u64>,
}

/// What the simulator tells the learner.
#[derive(Debug, Clone, PartialEq)]
pub enum Record {
    /// Ready for an episode.
    Request,
    /// A piece of trajectory.
    Fragment(Box<v1::Fragment>),
    /// The episode will not be finished.
    Aborted {
        /// Number of the episode.
        episode: u64,
        /// Reason, as the wire names it.
        reason: &'static str,
    },
}

/// Why the simulator must leave what it is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// The actor ends.
    Stop,
    /// The learner's session is over; another one may have begun.
    SessionChanged,
    /// The learner does not know the episode.
    UnknownEpisode,
}

/// The simulator thread's end. Its methods block.
#[derive(Debug)]
pub struct SimulatorEnd {
    runtime: Handle,
    stop: CancellationToken,
    session: watch::Receiver<Option<Arc<Session>>>,
    snapshot: watch::Receiver<Option<Snapshot>>,
    directions: watch::Receiver<Directions>,
    assignments: mpsc::Receiver<(u64, v1::EpisodeAssignment)>,
    records: mpsc::Sender<(u64, Record)>,
}

/// The network tasks' end.
#[derive(Debug)]
pub struct NetworkEnd {
    /// The session that the simulator works for; `None` while there is none.
    pub session: watch::Sender<Option<Arc<Session>>>,
    /// Slot of the newest weights.
    pub snapshot: watch::Sender<Option<Snapshot>>,
    /// What the learner said.
    pub directions: watch::Sender<Directions>,
    /// Episodes for the simulator, with the number of the join they belong to.
    pub assignments: mpsc::Sender<(u64, v1::EpisodeAssignment)>,
    /// What the simulator has for the learner, likewise.
    pub records: mpsc::Receiver<(u64, Record)>,
}

/// Makes both ends; `stop` halts the simulator.
#[must_use]
pub fn pair(stop: CancellationToken, runtime: Handle) -> (SimulatorEnd, NetworkEnd) {
    let (session, session_seen) = watch::channel(None);
    let (snapshot, snapshot_seen) = watch::channel(None);
    let (directions, directions_seen) = watch::channel(Directions::default());
    let (assignments, assigned) = mpsc::channel(2);
    let (record, records) = mpsc::channel(1);
    let simulator = SimulatorEnd {
        runtime,
        stop,
        session: session_seen,
        snapshot: snapshot_seen,
        directions: directions_seen,
        assignments: assigned,
        records: record,
    };
    (simulator, NetworkEnd { session, snapshot, directions, assignments, records })
}

// === impl SimulatorEnd ===

impl SimulatorEnd {
    /// Waits for a session to work for; `None` when the actor ends.
    pub fn session(&mut self) -> Option<Arc<Session>> {
        let Self { runtime, stop, session, .. } = self;
        runtime.block_on(async {
            tokio::select! {
                biased;
                () = stop.cancelled() => None,
                found = session.wait_for(Option::is_some) => found.ok().and_then(|found| found.clone()),
            }
        })
    }

    /// Whether to go on with `episode` of `session`; to be asked before every step.
    ///
    /// # Errors
    /// [`Halt`] says why not.
    pub fn check(&self, session: &Session, episode: u64) -> Result<(), Halt> {
        if self.stop.is_cancelled() {
            return Err(Halt::Stop);
        }
        if !is_current(self.session.borrow().as_ref(), session.join) {
            return Err(Halt::SessionChanged);
        }
        let directions = self.directions.borrow();
        if directions.epoch == session.epoch && directions.unknown_episode == Some(episode) {
            return Err(Halt::UnknownEpisode);
        }
        Ok(())
    }

    /// Asks for an episode and waits for it.
    ///
    /// # Errors
    /// [`Halt`] says why there will be none.
    pub fn next_episode(&mut self, session: &Session) -> Result<v1::EpisodeAssignment, Halt> {
        // Left over if the session ended between an assignment's arrival and its episode's start.
        while self.assignments.try_recv().is_ok() {}
        self.send(session, Record::Request)?;
        let Self { runtime, stop, session: current, assignments, .. } = self;
        wait(runtime, stop, current, session.join, async {
            loop {
                match assignments.recv().await {
                    Some((join, assignment)) if join == session.join => return Ok(assignment),
                    Some(_) => {}
                    None => return Err(Halt::Stop),
                }
            }
        })?
    }

    /// The newest weights, once they are at least as new as both `at_least` and what the learner last asked for.
    ///
    /// # Errors
    /// [`Halt`] says why there will be none.
    pub fn weights(
        &mut self,
        session: &Session,
        at_least: u64,
    ) -> Result<cross_proto::weights::Snapshot, Halt> {
        let Self { runtime, stop, session: current, snapshot, directions, .. } = self;
        let at_least = {
            let directions = directions.borrow();
            if directions.epoch == session.epoch {
                at_least.max(directions.min_policy_version)
            } else {
                at_least
            }
        };
        let new_enough = |slot: &Option<Snapshot>| {
            slot.as_ref().is_some_and(|s| s.epoch == session.epoch && s.weights.policy_version >= at_least)
        };
        wait(runtime, stop, current, session.join, async {
            let slot = snapshot.wait_for(new_enough).await.map_err(|_| Halt::Stop)?;
            // `wait_for` returned, so the slot is filled; an empty one would only mean to wait again.
            slot.as_ref().map(|s| s.weights.clone()).ok_or(Halt::SessionChanged)
        })?
    }

    /// Hands a record to the network; blocks while the learner is behind.
    ///
    /// # Errors
    /// [`Halt`] says why nobody wants it any more.
    pub fn send(&mut self, session: &Session, record: Record) -> Result<(), Halt> {
        let Self { runtime, stop, session: current, records, .. } = self;
        wait(runtime, stop, current, session.join, async {
            records.send((session.join, record)).await.map_err(|_| Halt::Stop)
        })?
    }

    /// Hands over the last words of an actor that stops, if the network takes them within `patience`.
    pub fn send_last(&self, session: &Session, record: Record, patience: Duration) -> bool {
        let sending = self.records.send_timeout((session.join, record), patience);
        self.runtime.block_on(sending).is_ok()
    }

    /// Waits until a fragment is acknowledged: what serial mode does after each.
    ///
    /// # Errors
    /// [`Halt`] says why it will not be.
    pub fn acknowledged(&mut self, session: &Session, episode: u64, sequence: u32) -> Result<(), Halt> {
        let Self { runtime, stop, session: current, directions, .. } = self;
        wait(runtime, stop, current, session.join, async {
            directions
                .wait_for(|d| d.epoch == session.epoch && d.acknowledged == Some((episode, sequence)))
                .await
                .map(|_| ())
                .map_err(|_| Halt::Stop)
        })?
    }

    /// Sleeps, unless something happens that ends the wait.
    ///
    /// # Errors
    /// [`Halt`] says what happened.
    pub fn sleep(&mut self, session: &Session, pause: Duration) -> Result<(), Halt> {
        let Self { runtime, stop, session: current, .. } = self;
        wait(runtime, stop, current, session.join, async { tokio::time::sleep(pause).await })
    }
}

fn is_current(current: Option<&Arc<Session>>, join: u64) -> bool {
    current.is_some_and(|session| session.join == join)
}

/// Blocks on `future`, but not past the end of the actor or of the session.
fn wait<F: Future>(
    runtime: &Handle,
    stop: &CancellationToken,
    session: &mut watch::Receiver<Option<Arc<Session>>>,
    join: u64,
    future: F,
) -> Result<F::Output, Halt> {
    runtime.block_on(async {
        tokio::select! {
            biased;
            () = stop.cancelled() => Err(Halt::Stop),
            changed = session.wait_for(|now| !is_current(now.as_ref(), join)) => {
                // The other end is gone exactly when the actor ends.
                Err(if changed.is_ok() { Halt::SessionChanged } else { Halt::Stop })
            }
            output = future => Ok(output),
        }
    })
}

#[cfg(test)]
#[path = "link_tests.rs"]
mod tests;
