//! Admission: who may send what, what is kept, and when there is enough for an update.
//!
//! A plain state machine. Events go in (an actor joins, a fragment is offered, time passes, an update is done), commands
//! come out (acknowledge, assign, close, update); it does no I/O, knows no clock, and starts no thread, so that every rule
//! is tested by the commands it returns.
//!
//! ```text
//!   join / hello ─> actors ──┐                              ┌─> Acknowledge, Assign, Close
//!   request, abort ─> episodes ├─> buffers per scenario ─ pump ┤
//!   offer (fragment) ────────┘                              └─> Update(round)  ──> updated(version)
//! ```
//!
//! **Nothing stands still for ever.** An update needs `round_steps` of every scenario. New episodes go to the scenario with
//! the least data, counting what is in flight, so a full buffer never attracts more. Should every actor that could feed a
//! short scenario be held back by another's full buffer, one of them is let through (`flow.rs`, rescue).

mod actors;
mod buffer;
mod episodes;
mod events;
mod flow;
mod journal;
#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
mod types;

pub use episodes::{FIRST_TRAINING_SEED, episode_seeds};
pub use types::{
    Assignment, CloseReason, Command, Dropped, HelloRefusal, JoinRefusal, Lag, Outcome, Progress, Round,
    ScenarioProgress, ScenarioSettings, Settings, StreamId,
};

use actors::Actor;
use buffer::{ScenarioBuffer, Taken};
use episodes::Finished;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

/// The state machine; see the [module](self).
#[derive(Debug)]
pub struct Admission {
    settings: Settings,
    policy_version: u64,
    progress: Progress,
    /// By actor id. Ordered, so that equal events give equal commands.
    actors: BTreeMap<String, Actor>,
    streams: HashMap<StreamId, String>,
    buffers: Vec<ScenarioBuffer>,
    finished: Vec<Finished>,
    /// Actors that asked for an episode, in order.
    requests: VecDeque<String>,
    /// Serial mode: episodes that were given up, to be simulated again under their own ids.
    again: VecDeque<(u64, usize)>,
    /// Serial mode: fragments that completed a round; acknowledged once the update is done.
    deferred: BTreeSet<(String, u64, u32)>,
    /// The actor whose fragments are inserted although a buffer is full; see `flow.rs`.
    rescued: Option<String>,
    /// What the round in training took of each scenario.
    in_training: Option<Vec<Taken>>,
    paused: bool,
    stopping: bool,
    /// What the present event asks for.
    commands: Vec<Command>,
}

impl Admission {
    /// Starts with the given policy version and the counters of the checkpoint that is resumed (or default ones).
    #[must_use]
    pub fn new(settings: Settings, policy_version: u64, mut progress: Progress) -> Self {
        for scenario in &settings.scenarios {
            progress.scenarios.entry(scenario.name.clone()).or_default();
        }
        Self {
            buffers: settings.scenarios.iter().map(|_| ScenarioBuffer::default()).collect(),
            finished: vec![Finished::default(); settings.scenarios.len()],
            settings,
            policy_version,
            progress,
            actors: BTreeMap::new(),
            streams: HashMap::new(),
            requests: VecDeque::new(),
            again: VecDeque::new(),
            deferred: BTreeSet::new(),
            rescued: None,
            in_training: None,
            paused: false,
            stopping: false,
            commands: Vec::new(),
        }
    }

    /// What the rules depend on.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Newest version that updates gave.
    #[must_use]
    pub fn policy_version(&self) -> u64 {
        self.policy_version
    }

    /// Counters so far, a round in training counted.
    #[must_use]
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Number of leases.
    #[must_use]
    pub fn actors(&self) -> usize {
        self.actors.len()
    }

    /// Whether a round is being trained on.
    #[must_use]
    pub fn is_updating(&self) -> bool {
        self.in_training.is_some()
    }

    /// Whether updates are held back by [`pause`](Self::pause).
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.paused
    }

    /// Whether all updates that were asked for are done.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.progress.updates >= self.settings.updates && !self.is_updating()
    }

    /// Steps of a scenario that the next update may take.
    #[must_use]
    pub fn buffered_steps(&self, scenario: usize) -> u64 {
        self.buffers.get(scenario).map_or(0, ScenarioBuffer::steps)
    }

    /// Fragments of a scenario offered so far, with this outcome.
    #[must_use]
    pub fn offered(&self, scenario: usize, outcome: Outcome) -> u64 {
        self.buffers.get(scenario).and_then(|b| b.outcomes.get(&outcome)).copied().unwrap_or(0)
    }

    /// Fragments of a scenario that were received and dropped for this reason.
    #[must_use]
    pub fn dropped(&self, scenario: usize, reason: Dropped) -> u64 {
        self.buffers.get(scenario).and_then(|b| b.dropped.get(&reason)).copied().unwrap_or(0)
    }

    /// Index of a scenario by name.
    #[must_use]
    pub fn scenario(&self, name: &str) -> Option<usize> {
        self.settings.scenarios.iter().position(|s| s.name == name)
    }

    #[cfg(test)]
    fn inserted_fragments(&self) -> usize {
        self.buffers.iter().map(ScenarioBuffer::fragments).sum()
    }

    fn take_commands(&mut self) -> Vec<Command> {
        std::mem::take(&mut self.commands)
    }
}
