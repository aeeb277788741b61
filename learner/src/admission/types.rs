//! What goes into and comes out of the admission state machine.

use cross_proto::fragment::Checked;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// One fragment stream, numbered by whoever accepts streams; never used twice in a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StreamId(pub u64);

/// What the rules depend on; fixed for the life of a learner process.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Seed of the run, from which every episode's seeds are derived.
    pub seed: u64,
    /// Session of this process; fragments of another are dropped.
    pub session_epoch: u64,
    /// Scenarios in the order of the configuration.
    pub scenarios: Vec<ScenarioSettings>,
    /// Steps of each scenario that one update takes.
    pub round_steps: u64,
    /// Buffered steps of a scenario from which on acknowledgements wait.
    pub buffered_steps: u64,
    /// Decisions in a full episode.
    pub episode_steps: u32,
    /// Most steps in a fragment.
    pub fragment_steps: u32,
    /// Most fragments that an actor may have sent without an acknowledgement.
    pub unacked_fragments: usize,
    /// Most policy versions that a fragment may be behind.
    pub max_policy_lag: u64,
    /// Lock-step mode.
    pub serial: bool,
    /// Most actors at a time.
    pub max_actors: usize,
    /// Silence after which a lease ends.
    pub lease: Duration,
    /// Updates after which no further round is handed out.
    pub updates: u64,
}

/// A scenario, as far as admission needs to know it.
#[derive(Debug, Clone)]
pub struct ScenarioSettings {
    /// Its name.
    pub name: String,
    /// Agents, N.
    pub agents: usize,
    /// Incoming lanes of all agents together, for the queue statistic.
    pub incoming_lanes: usize,
}

/// What became of a fragment that was offered, as counters and acknowledgements name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Inserted into the buffer.
    Accepted,
    /// Already there; ignored.
    Duplicate,
    /// Older than the policy-lag limit; dropped.
    Stale,
    /// Of an older session; dropped.
    OldSession,
    /// Of no episode that this actor was assigned; dropped.
    UnknownEpisode,
    /// Refused: a field is at fault, and the stream ends.
    Invalid,
}

impl Outcome {
    /// Every outcome, so that counters exist before the first event.
    pub const ALL: [Self; 6] =
        [Self::Accepted, Self::Duplicate, Self::Stale, Self::OldSession, Self::UnknownEpisode, Self::Invalid];

    /// Label value in metrics.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Duplicate => "duplicate",
            Self::Stale => "stale",
            Self::OldSession => "old_session",
            Self::UnknownEpisode => "unknown_episode",
            Self::Invalid => "invalid",
        }
    }
}

/// Why data left the buffer without being trained on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Dropped {
    /// It waited until it was older than the policy-lag limit.
    Stale,
    /// The buffer stood over its hard limit and this was the oldest.
    Overflow,
    /// Serial mode: its episode was given up and is simulated again from the start.
    Aborted,
    /// It was not yet acknowledged when its actor's lease ended.
    ActorLost,
    /// The update that took it failed.
    UpdateFailed,
}

impl Dropped {
    /// Every reason, so that counters exist before the first event.
    pub const ALL: [Self; 5] =
        [Self::Stale, Self::Overflow, Self::Aborted, Self::ActorLost, Self::UpdateFailed];

    /// Label value in metrics.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Stale => "stale",
            Self::Overflow => "overflow",
            Self::Aborted => "aborted",
            Self::ActorLost => "actor_lost",
            Self::UpdateFailed => "update_failed",
        }
    }
}

/// What the state machine wants done.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Tell the actor what became of a fragment.
    Acknowledge {
        /// Where to.
        stream: StreamId,
        /// The fragment's episode.
        episode: u64,
        /// The fragment's position in it.
        sequence: u32,
        /// What became of it.
        outcome: Outcome,
        /// Version the actor must hold before it goes on; 0 where it does not matter.
        min_policy_version: u64,
    },
    /// Hand an episode to the actor.
    Assign {
        /// Where to.
        stream: StreamId,
        /// The episode.
        assignment: Assignment,
    },
    /// End a stream.
    Close {
        /// Which.
        stream: StreamId,
        /// Why.
        reason: CloseReason,
    },
    /// Train on this round; answer with [`Admission::updated`](super::Admission::updated).
    Update(Round),
}

/// An episode to simulate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assignment {
    /// Numbered over the whole run.
    pub episode: u64,
    /// Index of the scenario.
    pub scenario: usize,
    /// Seed for SUMO, never one of the small numbers that evaluations use.
    pub sumo_seed: u32,
    /// Seed for action sampling.
    pub action_seed: u64,
    /// Version the actor must hold before it starts; 0 where it does not matter.
    pub min_policy_version: u64,
}

/// Why a stream is ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CloseReason {
    /// The same actor id joined again, or opened another stream.
    Replaced,
    /// Nothing was heard for the length of the lease.
    LeaseEnded,
    /// A fragment's field is at fault.
    Invalid {
        /// Field of the wire message.
        field: &'static str,
        /// What is wrong with it.
        description: String,
    },
    /// More fragments in flight than the limit allows.
    TooManyUnacked {
        /// The limit.
        limit: usize,
    },
}

/// Why an actor is not admitted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum JoinRefusal {
    /// The limit is reached.
    #[error("{limit} actors have joined, which is learner.max_actors; raise it or stop an actor")]
    TooManyActors {
        /// The limit.
        limit: usize,
    },
    /// Serial mode has its one actor.
    #[error("serial mode takes one actor and {actor} has joined; wait until it leaves or its lease ends")]
    SerialTaken {
        /// The actor that is there.
        actor: String,
    },
    /// None of the actor's scenarios is trained on.
    #[error("the actor can run none of this run's scenarios; start it with one of: {scenarios}")]
    NoScenario {
        /// What there is, comma-separated.
        scenarios: String,
    },
}

/// Why a stream is not opened.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HelloRefusal {
    /// The session is another learner process's.
    #[error("session {got} is over, this learner's session is {expected}; join again")]
    OldSession {
        /// What the actor said.
        got: u64,
        /// What it should be.
        expected: u64,
    },
    /// No lease.
    #[error("actor {actor} has no lease, it ended or never began; join again")]
    NotJoined {
        /// Who.
        actor: String,
    },
}

/// What one update trains on.
#[derive(Debug, Clone, PartialEq)]
pub struct Round {
    /// Oldest first within a scenario, scenarios in the configuration's order.
    pub fragments: Vec<Checked>,
    /// Policy versions that the fragments are behind.
    pub lag: Lag,
    /// Counters as they stand once this round is trained on; what a checkpoint records.
    pub progress: Progress,
}

/// Policy lag over a round's fragments, versions.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Lag {
    /// Least.
    pub min: u64,
    /// Mean, weighted by steps.
    pub mean: f64,
    /// Most.
    pub max: u64,
}

/// Counters that go on over a restart: part of every checkpoint.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Progress {
    /// Updates done once the round is trained on.
    pub updates: u64,
    /// Id that the next new episode gets.
    pub next_episode: u64,
    /// Finished episodes.
    pub episodes: u64,
    /// Agent-decisions trained on.
    pub decisions: u64,
    /// The same by scenario name, with what the newest episodes gave.
    pub scenarios: BTreeMap<String, ScenarioProgress>,
}

/// A scenario's share of [`Progress`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ScenarioProgress {
    /// Finished episodes.
    pub episodes: u64,
    /// Agent-decisions trained on.
    pub decisions: u64,
    /// Mean over the agents of the summed raw reward, mean over the episodes finished since the round before; none before
    /// the first.
    pub episode_return: Option<f64>,
    /// Stopped vehicles per incoming lane as the reward counts them (beyond its range by `env.reward_beyond`), mean over the
    /// same episodes' decisions.
    pub queue_length: Option<f64>,
}
