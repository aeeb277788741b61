//! What follows from an event: insert what has room, start an update, hand out episodes, keep everything moving.

use super::Admission;
use super::buffer::{Taken, lag};
use super::episodes::{Episode, Finished, episode_seeds};
use super::journal;
use super::types::{Assignment, Command, Outcome, Round};

impl Admission {
    /// Does all that the present state allows. Called after every event.
    pub(super) fn pump(&mut self) {
        self.insert_waiting();
        if self.start_update() {
            self.insert_waiting();
        }
        self.assign();
        self.rescue();
    }

    /// Whether every scenario has its quota.
    pub(super) fn round_is_ready(&self) -> bool {
        self.buffers.iter().all(|buffer| buffer.steps() >= self.settings.round_steps)
    }

    /// Whether data of that version is past the lag limit.
    pub(super) fn is_stale(&self, version: u64) -> bool {
        self.policy_version.saturating_sub(version) > self.settings.max_policy_lag
    }

    /// Drops and counts buffered data past the lag limit.
    pub(super) fn drop_stale(&mut self) {
        let oldest = self.policy_version.saturating_sub(self.settings.max_policy_lag);
        for scenario in 0..self.buffers.len() {
            for fragment in self.buffers[scenario].drop_stale(oldest) {
                self.buffers[scenario].count(Outcome::Stale);
                journal::declined(&fragment.id, Outcome::Stale);
                self.acknowledge(
                    &fragment.id.actor,
                    fragment.id.episode,
                    fragment.id.sequence,
                    Outcome::Stale,
                );
            }
        }
    }

    fn insert_waiting(&mut self) {
        for scenario in 0..self.buffers.len() {
            while self.buffers[scenario].has_room(self.settings.buffered_steps) {
                let Some(fragment) = self.buffers[scenario].next_waiting(|_| true) else { break };
                self.insert(scenario, fragment);
            }
            if let Some(rescued) = self.rescued.clone() {
                while let Some(fragment) = self.buffers[scenario].next_waiting(|f| f.id.actor == rescued) {
                    self.insert(scenario, fragment);
                }
                let limit = self.hard_limit();
                self.buffers[scenario].drop_overflow(limit);
            }
        }
    }

    fn insert(&mut self, scenario: usize, fragment: cross_proto::fragment::Checked) {
        let id = fragment.id.clone();
        self.buffers[scenario].insert(fragment);
        self.buffers[scenario].count(Outcome::Accepted);
        if self.settings.serial && self.round_is_ready() {
            // The actor must not go on under the old policy, so it hears of this only after the update.
            self.deferred.insert((id.actor, id.episode, id.sequence));
        } else {
            self.acknowledge(&id.actor, id.episode, id.sequence, Outcome::Accepted);
        }
    }

    /// Sends what became of a fragment, unless the actor is not connected: then it asks again by sending it again.
    pub(super) fn acknowledge(&mut self, actor: &str, episode: u64, sequence: u32, outcome: Outcome) {
        let min_policy_version = match outcome {
            // Whoever is behind must catch up before it goes on, or all it does is stale.
            Outcome::Stale => self.policy_version,
            _ => self.min_policy_version(),
        };
        let Some(known) = self.actors.get_mut(actor) else { return };
        let carrier = known.held.remove(&(episode, sequence));
        if let Some(stream) = known.stream.filter(|stream| carrier.is_none_or(|carrier| carrier == *stream)) {
            self.commands.push(Command::Acknowledge {
                stream,
                episode,
                sequence,
                outcome,
                min_policy_version,
            });
        }
    }

    /// Only serial mode insists on the newest version: elsewhere waiting for it would idle the actor.
    fn min_policy_version(&self) -> u64 {
        if self.settings.serial { self.policy_version } else { 0 }
    }

    /// Hands a round out if there is one and none is in training.
    fn start_update(&mut self) -> bool {
        let wanted = self.progress.updates < self.settings.updates;
        if self.is_updating() || self.paused || self.stopping || !wanted || !self.round_is_ready() {
            return false;
        }
        let mut fragments = Vec::new();
        let mut taken = Vec::new();
        for (i, scenario) in self.settings.scenarios.iter().enumerate() {
            let before = fragments.len();
            let steps = self.buffers[i].take(self.settings.round_steps, &mut fragments);
            let decisions = steps * scenario.agents as u64;
            let ids = fragments[before..].iter().map(|fragment| fragment.id.clone()).collect();
            taken.push(Taken { fragments: ids, decisions });
            self.progress.decisions += decisions;
            let entry = self.progress.scenarios.entry(scenario.name.clone()).or_default();
            entry.decisions += decisions;
            if let Some((episode_return, queue_length)) = self.finished[i].means() {
                entry.episode_return = Some(episode_return);
                entry.queue_length = Some(queue_length);
            }
            self.finished[i] = Finished::default();
        }
        self.progress.updates += 1;
        self.in_training = Some(taken);
        for fragment in &fragments {
            journal::trained_on(fragment, self.progress.updates);
        }
        let lag = lag(&fragments, self.policy_version);
        self.commands.push(Command::Update(Round { fragments, lag, progress: self.progress.clone() }));
        true
    }

    /// Steps of a scenario that are there or on their way.
    fn supply(&self, scenario: usize) -> u64 {
        let in_flight: u64 = self
            .actors
            .values()
            .filter_map(|actor| actor.episode.as_ref())
            .filter(|episode| episode.scenario == scenario)
            .map(|episode| episode.remaining_steps(self.settings.episode_steps))
            .sum();
        self.buffers[scenario].received_steps() + in_flight
    }

    /// Gives each actor that asked an episode of the scenario furthest behind its quota. All quotas are equal, so that is
    /// the scenario with the least supply.
    fn assign(&mut self) {
        let last_round_taken = self.progress.updates >= self.settings.updates;
        if self.stopping
            || last_round_taken
            || (self.settings.serial && (self.is_updating() || self.round_is_ready()))
        {
            return;
        }
        while let Some(id) = self.requests.pop_front() {
            let Some(actor) = self.actors.get(&id) else { continue };
            let Some(stream) = actor.stream else { continue };
            let runnable = |scenario: &usize| actor.runnable.contains(scenario);
            let again = self.again.iter().position(|(_, scenario)| runnable(scenario));
            let (episode, scenario) = if let Some(entry) = again.and_then(|at| self.again.remove(at)) {
                entry
            } else {
                let furthest = actor.runnable.iter().copied().min_by_key(|&i| (self.supply(i), i));
                let Some(scenario) = furthest else { continue };
                let episode = self.progress.next_episode;
                self.progress.next_episode += 1;
                (episode, scenario)
            };
            let (sumo_seed, action_seed) = episode_seeds(self.settings.seed, episode);
            let min_policy_version = self.min_policy_version();
            if self.rescued.as_deref() == Some(id.as_str()) {
                self.rescued = None;
            }
            if let Some(actor) = self.actors.get_mut(&id) {
                actor.episode = Some(Episode::new(episode, scenario));
            }
            let assignment = Assignment { episode, scenario, sumo_seed, action_seed, min_policy_version };
            self.commands.push(Command::Assign { stream, assignment });
        }
    }

    /// Gives an actor's unfinished episode back. What came of it stays valid data, except in serial mode: there the whole
    /// episode is simulated again, so that even a crash repeats bit for bit.
    pub(super) fn give_up_episode(&mut self, actor: &str) {
        let Some(episode) = self.actors.get_mut(actor).and_then(|known| known.episode.take()) else { return };
        if self.settings.serial {
            self.buffers[episode.scenario].drop_episode(episode.id);
            self.again.push_back((episode.id, episode.scenario));
        }
    }

    /// Lets one actor through when a short scenario has nobody to feed it.
    ///
    /// A scenario can be short while every actor that could run it is held back by another scenario's full buffer, in the
    /// middle of an episode or waiting for acknowledgements before it asks for the next: its own actor died, or an episode
    /// is longer than the buffer. Then the held actor nearest to its episode's end has its fragments inserted beyond the
    /// limit until it takes its next episode, which by the rule of assignment is the short scenario's.
    fn rescue(&mut self) {
        // After an update in progress its buffers are drained and this is asked again.
        if self.rescued.is_some() || self.stopping || self.is_updating() {
            return;
        }
        for short in 0..self.buffers.len() {
            if self.buffers[short].steps() >= self.settings.round_steps {
                continue;
            }
            let fed = self.actors.values().any(|actor| {
                actor.held.is_empty() && actor.episode.as_ref().is_some_and(|e| e.scenario == short)
            });
            if fed {
                continue;
            }
            let remaining = |episode: &Option<Episode>| {
                episode.as_ref().map_or(0, |e| e.remaining_steps(self.settings.episode_steps))
            };
            let nearest = self
                .actors
                .iter()
                .filter(|(_, actor)| !actor.held.is_empty() && actor.runnable.contains(&short))
                .min_by_key(|(_, actor)| remaining(&actor.episode))
                .map(|(id, _)| id.clone());
            if nearest.is_some() {
                self.rescued = nearest;
                self.insert_waiting();
                return;
            }
        }
    }

    /// Most steps a scenario's buffer ever holds: the limit, plus all that one rescued actor can still send.
    #[must_use]
    pub fn hard_limit(&self) -> u64 {
        let settings = &self.settings;
        let in_flight = settings.unacked_fragments as u64 * u64::from(settings.fragment_steps);
        settings.buffered_steps + in_flight + u64::from(settings.episode_steps)
    }

    /// Whether some buffer holds fragments back at the moment.
    #[cfg(test)]
    pub(super) fn is_holding_back(&self) -> bool {
        self.buffers.iter().any(super::buffer::ScenarioBuffer::has_waiting)
    }
}
