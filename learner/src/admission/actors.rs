//! Actors: their leases, and what each has in flight.

use super::Admission;
use super::episodes::{Closed, Episode};
use super::types::{CloseReason, Command, HelloRefusal, JoinRefusal, StreamId};
use std::collections::BTreeMap;
use std::time::Duration;

/// An actor with a lease.
#[derive(Debug)]
pub(super) struct Actor {
    /// Indices of the scenarios it can run.
    pub(super) runnable: Vec<usize>,
    pub(super) last_heard: Duration,
    pub(super) stream: Option<StreamId>,
    /// What it simulates now. It outlives a lost connection and even a new join, because a network cut that heals within
    /// the lease must cost nothing; asking for another episode ends it.
    pub(super) episode: Option<Episode>,
    /// Fragments received from it whose acknowledgement is held back, (episode, sequence), with the stream that carried
    /// each last: a new process under the same id must not hear of what its predecessor sent.
    pub(super) held: BTreeMap<(u64, u32), StreamId>,
    pub(super) closed: Closed,
}

impl Actor {
    /// Fragments that the present stream carried and that are not acknowledged.
    pub(super) fn unacked(&self) -> usize {
        self.held.values().filter(|&&stream| self.stream == Some(stream)).count()
    }
}

impl Admission {
    /// Gives an actor a lease, or renews it: then its earlier stream ends.
    ///
    /// # Errors
    /// [`JoinRefusal`]; then nothing has changed.
    pub fn join(
        &mut self,
        now: Duration,
        actor: &str,
        scenarios: &[String],
    ) -> Result<Vec<Command>, JoinRefusal> {
        let runnable: Vec<usize> = (0..self.settings.scenarios.len())
            .filter(|&i| scenarios.is_empty() || scenarios.contains(&self.settings.scenarios[i].name))
            .collect();
        if runnable.is_empty() {
            let names: Vec<&str> = self.settings.scenarios.iter().map(|s| s.name.as_str()).collect();
            return Err(JoinRefusal::NoScenario { scenarios: names.join(", ") });
        }
        if let Some(known) = self.actors.get_mut(actor) {
            known.runnable = runnable;
            known.last_heard = now;
            self.end_stream(actor, CloseReason::Replaced);
            return Ok(self.take_commands());
        }
        if self.settings.serial
            && let Some(other) = self.actors.keys().next()
        {
            return Err(JoinRefusal::SerialTaken { actor: other.clone() });
        }
        if self.actors.len() >= self.settings.max_actors {
            return Err(JoinRefusal::TooManyActors { limit: self.settings.max_actors });
        }
        let joined = Actor {
            runnable,
            last_heard: now,
            stream: None,
            episode: None,
            held: BTreeMap::new(),
            closed: Closed::default(),
        };
        self.actors.insert(actor.to_owned(), joined);
        Ok(self.take_commands())
    }

    /// Opens a fragment stream for an actor that joined; an earlier one ends.
    ///
    /// # Errors
    /// [`HelloRefusal`] when it must join first.
    pub fn hello(
        &mut self,
        now: Duration,
        stream: StreamId,
        actor: &str,
        session_epoch: u64,
    ) -> Result<Vec<Command>, HelloRefusal> {
        if session_epoch != self.settings.session_epoch {
            return Err(HelloRefusal::OldSession {
                got: session_epoch,
                expected: self.settings.session_epoch,
            });
        }
        if !self.actors.contains_key(actor) {
            return Err(HelloRefusal::NotJoined { actor: actor.to_owned() });
        }
        self.end_stream(actor, CloseReason::Replaced);
        if let Some(known) = self.actors.get_mut(actor) {
            known.last_heard = now;
            known.stream = Some(stream);
        }
        self.streams.insert(stream, actor.to_owned());
        Ok(self.take_commands())
    }

    /// The actor has nothing to say but is there.
    pub fn heartbeat(&mut self, now: Duration, stream: StreamId) -> Vec<Command> {
        self.heard(now, stream);
        self.take_commands()
    }

    /// The connection broke. The lease goes on: the actor may come back within it.
    pub fn disconnected(&mut self, stream: StreamId) -> Vec<Command> {
        if let Some(actor) = self.streams.remove(&stream) {
            self.requests.retain(|id| *id != actor);
            if let Some(known) = self.actors.get_mut(&actor) {
                known.stream = None;
            }
        }
        self.take_commands()
    }

    /// The actor said that it leaves and closed its side: its share is free at once.
    pub fn left(&mut self, stream: StreamId) -> Vec<Command> {
        if let Some(actor) = self.streams.get(&stream).cloned() {
            // It closed the stream itself, so there is nobody to tell.
            let _ = self.disconnected(stream);
            self.remove_actor(&actor);
            self.pump();
        }
        self.take_commands()
    }

    /// Ends the leases of actors that were silent for too long.
    pub fn tick(&mut self, now: Duration) -> Vec<Command> {
        let lease = self.settings.lease;
        let lost: Vec<String> = self
            .actors
            .iter()
            .filter(|(_, actor)| now.saturating_sub(actor.last_heard) > lease)
            .map(|(id, _)| id.clone())
            .collect();
        for actor in &lost {
            self.end_stream(actor, CloseReason::LeaseEnded);
            self.remove_actor(actor);
        }
        if !lost.is_empty() {
            self.pump();
        }
        self.take_commands()
    }

    /// This process itself stood still for so long: stopped, swapped out, or on a machine that slept. What actors said
    /// meanwhile waits in its sockets, so the time does not count as their silence.
    pub fn stood_still(&mut self, now: Duration, time: Duration) {
        for actor in self.actors.values_mut() {
            actor.last_heard = (actor.last_heard + time).min(now);
        }
    }

    /// Renews the lease of the stream's actor and names it; `None` for a stream that has been closed.
    pub(super) fn heard(&mut self, now: Duration, stream: StreamId) -> Option<String> {
        let id = self.streams.get(&stream)?.clone();
        self.actors.get_mut(&id)?.last_heard = now;
        Some(id)
    }

    /// Ends an actor's stream, if it has one.
    pub(super) fn end_stream(&mut self, actor: &str, reason: CloseReason) {
        if let Some(stream) = self.actors.get_mut(actor).and_then(|known| known.stream.take()) {
            self.streams.remove(&stream);
            self.requests.retain(|id| id != actor);
            self.commands.push(Command::Close { stream, reason });
        }
    }

    fn remove_actor(&mut self, actor: &str) {
        self.give_up_episode(actor);
        self.actors.remove(actor);
        self.requests.retain(|id| id != actor);
        self.deferred.retain(|(id, _, _)| id != actor);
        if self.rescued.as_deref() == Some(actor) {
            self.rescued = None;
        }
        for buffer in &mut self.buffers {
            buffer.forget_waiting(|id| id.actor == actor);
        }
    }
}
