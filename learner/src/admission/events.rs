//! What actors say on their streams, what the trainer reports, and what people ask for.

use super::Admission;
use super::buffer::Taken;
use super::journal;
use super::types::{CloseReason, Command, Dropped, Outcome, StreamId};
use cross_proto::fragment::Checked;
use cross_sim::trajectory::{FragmentEnd, FragmentId};
use std::collections::BTreeSet;
use std::time::Duration;

impl Admission {
    /// An actor asks for an episode; one that it had not finished is given up.
    pub fn request_episode(&mut self, now: Duration, stream: StreamId) -> Vec<Command> {
        if let Some(actor) = self.heard(now, stream) {
            self.give_up_episode(&actor);
            if !self.requests.contains(&actor) {
                self.requests.push_back(actor);
            }
            self.pump();
        }
        self.take_commands()
    }

    /// An actor will not finish an episode.
    pub fn abort_episode(&mut self, now: Duration, stream: StreamId, episode: u64) -> Vec<Command> {
        if let Some(actor) = self.heard(now, stream) {
            let open = self.actors.get(&actor).and_then(|known| known.episode.as_ref());
            if open.is_some_and(|open| open.id == episode) {
                self.give_up_episode(&actor);
                self.pump();
            }
        }
        self.take_commands()
    }

    /// A fragment could not be decoded: counts it, gives its episode up. The caller ends the stream.
    pub fn invalid(&mut self, stream: StreamId, scenario: Option<usize>) -> Vec<Command> {
        if let Some(actor) = self.streams.get(&stream).cloned() {
            self.count(scenario, Outcome::Invalid);
            self.give_up_episode(&actor);
            let _ = self.disconnected(stream);
            self.pump();
        }
        self.take_commands()
    }

    /// A valid fragment arrives. It is acknowledged by a command, now or (buffer full, or serial mode) later; a fragment
    /// of a stream that has been closed is ignored without an answer, as its actor will send it again.
    pub fn offer(&mut self, now: Duration, stream: StreamId, fragment: impl Into<Checked>) -> Vec<Command> {
        if let Some(actor) = self.heard(now, stream) {
            self.consider(&actor, stream, fragment.into());
            self.pump();
        }
        self.take_commands()
    }

    fn consider(&mut self, actor: &str, stream: StreamId, fragment: Checked) {
        let (episode, sequence) = (fragment.id.episode, fragment.id.sequence);
        let scenario = self.scenario(&fragment.scenario);
        if fragment.id.session_epoch != self.settings.session_epoch {
            return self.decline(actor, scenario, &fragment.id, Outcome::OldSession);
        }
        if fragment.id.actor != actor {
            let problem = format!("is {:?}, but this stream is {actor:?}'s", fragment.id.actor);
            return self.refuse(actor, scenario, "actor_id", problem);
        }
        let Some(known) = self.actors.get_mut(actor) else { return };
        if let Some(carrier) = known.held.get_mut(&(episode, sequence)) {
            // Sent again after a reconnection; the first copy is answered when its turn comes, on this stream.
            *carrier = stream;
            return;
        }
        let Some(open) = known.episode.as_ref().filter(|open| open.id == episode) else {
            let again = known.closed.contains(episode, sequence);
            let outcome = if again { Outcome::Duplicate } else { Outcome::UnknownEpisode };
            return self.decline(actor, scenario, &fragment.id, outcome);
        };
        if sequence < open.next_sequence {
            return self.decline(actor, scenario, &fragment.id, Outcome::Duplicate);
        }
        if known.unacked() >= self.settings.unacked_fragments {
            let limit = self.settings.unacked_fragments;
            self.give_up_episode(actor);
            return self.end_stream(actor, CloseReason::TooManyUnacked { limit });
        }
        if scenario != Some(open.scenario) {
            let assigned = &self.settings.scenarios[open.scenario].name;
            let problem =
                format!("is {:?}, but episode {episode} was assigned on {assigned:?}", fragment.scenario);
            return self.refuse(actor, scenario, "scenario", problem);
        }
        if let Err((field, problem)) = open.check(&fragment, self.settings.episode_steps) {
            return self.refuse(actor, scenario, field, problem);
        }
        if fragment.policy_version > self.policy_version {
            let newest = self.policy_version;
            let problem = format!("is {}, but the newest published is {newest}", fragment.policy_version);
            return self.refuse(actor, scenario, "policy_version", problem);
        }
        let scenario = open.scenario;
        self.forget_predecessor(actor, stream);
        self.admit(actor, stream, scenario, fragment);
    }

    /// An actor sends again what is not acknowledged before it sends anything new, so whatever an earlier stream carried and
    /// this one did not belongs to a process that died. Forgetting it bounds what waits over any number of restarts.
    fn forget_predecessor(&mut self, actor: &str, stream: StreamId) {
        let Some(known) = self.actors.get_mut(actor) else { return };
        let deferred = &self.deferred;
        let lost: BTreeSet<(u64, u32)> = known
            .held
            .iter()
            .filter(|&(&(episode, sequence), &carrier)| {
                carrier != stream && !deferred.contains(&(actor.to_owned(), episode, sequence))
            })
            .map(|(&key, _)| key)
            .collect();
        if lost.is_empty() {
            return;
        }
        known.held.retain(|key, _| !lost.contains(key));
        for buffer in &mut self.buffers {
            buffer.forget_waiting(|id| id.actor == actor && lost.contains(&(id.episode, id.sequence)));
        }
    }

    /// A fragment that continues the actor's episode: counts it towards the episode and keeps it unless it is stale.
    fn admit(&mut self, actor: &str, stream: StreamId, scenario: usize, fragment: Checked) {
        let stale = self.is_stale(fragment.policy_version);
        let Some(known) = self.actors.get_mut(actor) else { return };
        let Some(mut episode) = known.episode.take() else { return };
        episode.advance(&fragment);
        if !stale {
            known.held.insert((fragment.id.episode, fragment.id.sequence), stream);
        }
        if fragment.end == FragmentEnd::Continues {
            known.episode = Some(episode);
        } else {
            // Each unacknowledged fragment may be the last of an episode of its own.
            known.closed.push(&episode, 2 * self.settings.unacked_fragments + 2);
            let settings = &self.settings.scenarios[scenario];
            self.finished[scenario].add(&episode, settings);
            self.progress.episodes += 1;
            self.progress.scenarios.entry(settings.name.clone()).or_default().episodes += 1;
        }
        if stale {
            return self.decline(actor, Some(scenario), &fragment.id, Outcome::Stale);
        }
        self.buffers[scenario].wait(fragment);
    }

    /// Answers a fragment that is not kept.
    fn decline(&mut self, actor: &str, scenario: Option<usize>, id: &FragmentId, outcome: Outcome) {
        self.count(scenario, outcome);
        journal::declined(id, outcome);
        self.acknowledge(actor, id.episode, id.sequence, outcome);
    }

    /// Ends the stream over a field that is at fault.
    fn refuse(&mut self, actor: &str, scenario: Option<usize>, field: &'static str, description: String) {
        self.count(scenario, Outcome::Invalid);
        self.give_up_episode(actor);
        self.end_stream(actor, CloseReason::Invalid { field, description });
    }

    fn count(&mut self, scenario: Option<usize>, outcome: Outcome) {
        if let Some(buffer) = scenario.and_then(|i| self.buffers.get_mut(i)) {
            buffer.count(outcome);
        }
    }

    /// The update is done and published as `policy_version`: data that has become too old goes, what waited moves on.
    pub fn updated(&mut self, policy_version: u64) -> Vec<Command> {
        self.in_training = None;
        self.policy_version = self.policy_version.max(policy_version);
        self.drop_stale();
        self.go_on()
    }

    /// The update gave nothing: the version stays, the round's data is lost and counted, and another round is collected.
    pub fn update_failed(&mut self) -> Vec<Command> {
        if let Some(taken) = self.in_training.take() {
            self.progress.updates -= 1;
            for ((scenario, buffer), taken) in
                self.settings.scenarios.iter().zip(&mut self.buffers).zip(taken)
            {
                let Taken { fragments, decisions } = taken;
                self.progress.decisions -= decisions;
                self.progress.scenarios.entry(scenario.name.clone()).or_default().decisions -= decisions;
                *buffer.dropped.entry(Dropped::UpdateFailed).or_default() += fragments.len() as u64;
                for id in &fragments {
                    journal::dropped(id, Dropped::UpdateFailed);
                }
            }
        }
        self.go_on()
    }

    /// What an update held back.
    fn go_on(&mut self) -> Vec<Command> {
        for (actor, episode, sequence) in std::mem::take(&mut self.deferred) {
            self.acknowledge(&actor, episode, sequence, Outcome::Accepted);
        }
        self.pump();
        self.take_commands()
    }

    /// No further update starts. Actors go on until the buffers hold them back.
    pub fn pause(&mut self) {
        self.paused = true;
    }

    /// Takes [`pause`](Self::pause) back.
    pub fn resume(&mut self) -> Vec<Command> {
        self.paused = false;
        self.pump();
        self.take_commands()
    }

    /// For good: no further update, no further episode.
    pub fn stop(&mut self) {
        self.stopping = true;
    }
}
