//! Trajectories: what an actor records and a learner learns from.
//!
//! A [`Fragment`] is self-contained: with the scenario's [`NetworkLayout`](crate::layout::NetworkLayout) it is all that
//! an update needs, recurrent state at its start included.

/// What all agents of one network see at a decision.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Observation {
    /// Vehicle counts `[lane rows, bands]`, row-major: agents in layout order, in each agent incoming lanes then outgoing
    /// lanes, for each lane its bands ([`Detection`](cross_config::Detection)).
    pub counts: Vec<u16>,
    /// Index of each agent's current green phase `[agents]`.
    pub phases: Vec<u8>,
}

/// Identity of a fragment; what recognises a duplicate.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FragmentId {
    /// Actor that recorded it.
    pub actor: String,
    /// Session of the learner under which it was recorded.
    pub session_epoch: u64,
    /// Episode, numbered over the whole run by the learner.
    pub episode: u64,
    /// Position in the episode, from 0 without gaps.
    pub sequence: u32,
}

/// How a fragment ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FragmentEnd {
    /// The episode goes on in the next fragment.
    Continues,
    /// The episode was cut off by time: bootstrap its last value.
    Truncated,
    /// The episode reached an end of its own: nothing follows.
    Terminated,
}

/// Recurrent state of the policy `[agents, hidden]`, row-major, one for each network.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RecurrentState {
    /// The actor network's GRU state.
    pub actor: Vec<f32>,
    /// The critic network's GRU state.
    pub critic: Vec<f32>,
}

/// Up to `actor.fragment_steps` steps of one episode under one behaviour policy.
///
/// With `T` steps, `N` agents and `C = lane rows * bands`:
#[derive(Debug, Clone, PartialEq)]
pub struct Fragment {
    /// Identity.
    pub id: FragmentId,
    /// Scenario name.
    pub scenario: String,
    /// Hash of the layout the counts belong to.
    pub layout_hash: String,
    /// Version of the behaviour policy.
    pub policy_version: u64,
    /// Step of the episode at which it starts, from 0.
    pub first_step: u32,
    /// Number of steps T.
    pub steps: u32,
    /// Observations `[T+1, C]`; the last row is what was seen after the last step.
    pub counts: Vec<u16>,
    /// Current phases `[T+1, N]`, as the counts.
    pub phases: Vec<u8>,
    /// Chosen phases `[T, N]`.
    pub actions: Vec<u8>,
    /// Behaviour log-probabilities of the actions `[T, N]`.
    pub log_probs: Vec<f32>,
    /// Raw rewards `[T, N]`: minus the stopped vehicles, those beyond the reward's range weighted, at the end of each step.
    pub rewards: Vec<f32>,
    /// Recurrent state before the first step; empty vectors exactly if `first_step` is 0.
    pub recurrent: RecurrentState,
    /// How it ends.
    pub end: FragmentEnd,
}
