//! Fragments on the wire, and the check that each passes before the learner sees it.
//!
//! [`check`] trusts nothing: what it returns has every array of the right size, every number finite and every index
//! within the layout, so that no code behind it needs to ask again. Counts stay packed until somebody works with them:
//! unpacked they are nine tenths of a fragment, and a learner may hold thousands.

use crate::{Violation, ids::ActorId, packing, v1};
use cross_config::Config;
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, RecurrentState};
use std::ops::Deref;
use std::sync::Arc;

/// How far above 0 a log-probability may be: the rounding of a float32 log-softmax.
const LOG_PROB_SLACK: f32 = 1e-5;
/// The least log-probability that a sampled phase can plausibly have: float32 draws do not reach below about -17.
const LEAST_LOG_PROB: f32 = -100.0;
/// Largest magnitude of a recurrent state, rounding included.
const MOST_STATE: f32 = 1.001;

/// What a fragment of one scenario must agree with.
#[derive(Debug, Clone)]
pub struct FragmentSpec {
    /// Scenario's name.
    pub scenario: String,
    /// Its intersections.
    pub layout: Arc<NetworkLayout>,
    /// [`NetworkLayout::hash`] of the layout.
    pub layout_hash: String,
    /// Counts per lane.
    pub bands: usize,
    /// Width of the recurrent state of an agent, for each of the two networks.
    pub hidden: usize,
    /// Most steps in a fragment.
    pub max_steps: u32,
    /// Steps of a full episode.
    pub steps_per_episode: u32,
}

impl FragmentSpec {
    /// The specification that a run's configuration gives for one of its scenarios.
    #[must_use]
    pub fn new(scenario: impl Into<String>, layout: Arc<NetworkLayout>, config: &Config) -> Self {
        Self {
            scenario: scenario.into(),
            layout_hash: layout.hash(),
            layout,
            bands: config.env.detection.bands(),
            // A validated configuration has a positive width.
            hidden: usize::try_from(config.model.hidden).unwrap_or(0),
            max_steps: config.actor.fragment_steps,
            steps_per_episode: config.env.steps_per_episode(),
        }
    }

    /// Number of agents N.
    #[must_use]
    pub fn agents(&self) -> usize {
        self.layout.agents()
    }

    /// Counts of one observation, C.
    #[must_use]
    pub fn counts_per_step(&self) -> usize {
        self.layout.lane_rows() * self.bands
    }
}

impl From<&Fragment> for v1::Fragment {
    fn from(fragment: &Fragment) -> Self {
        Self {
            actor_id: fragment.id.actor.clone(),
            session_epoch: fragment.id.session_epoch,
            episode: fragment.id.episode,
            sequence: fragment.id.sequence,
            scenario: fragment.scenario.clone(),
            layout_hash: fragment.layout_hash.clone(),
            policy_version: fragment.policy_version,
            first_step: fragment.first_step,
            steps: fragment.steps,
            counts: packing::pack(&fragment.counts).into(),
            phases: fragment.phases.clone().into(),
            actions: fragment.actions.clone().into(),
            log_probs: fragment.log_probs.clone(),
            rewards: fragment.rewards.clone(),
            actor_state: floats_to_bytes(&fragment.recurrent.actor).into(),
            critic_state: floats_to_bytes(&fragment.recurrent.critic).into(),
            end: v1::FragmentEnd::from(fragment.end).into(),
        }
    }
}

impl From<FragmentEnd> for v1::FragmentEnd {
    fn from(end: FragmentEnd) -> Self {
        match end {
            FragmentEnd::Continues => Self::Continues,
            FragmentEnd::Truncated => Self::Truncated,
            FragmentEnd::Terminated => Self::Terminated,
        }
    }
}

/// A fragment that has passed [`check`], with its counts still packed.
///
/// It reads as the [`Fragment`] that it will be, but for `counts`, which are empty until [`unpack`](Self::unpack).
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    rest: Fragment,
    packed: Box<[u8]>,
    /// How many counts that is.
    packed_counts: usize,
}

impl Checked {
    /// The whole fragment.
    #[must_use]
    pub fn unpack(self) -> Fragment {
        let Self { rest, packed, packed_counts } = self;
        let counts = packing::unpack(&packed, packed_counts)
            .expect("bytes that `check` has read to their end, or that `pack` wrote, unpack");
        Fragment { counts, ..rest }
    }
}

impl Deref for Checked {
    type Target = Fragment;

    fn deref(&self) -> &Fragment {
        &self.rest
    }
}

/// A fragment of this process's own needs no check.
impl From<Fragment> for Checked {
    fn from(mut fragment: Fragment) -> Self {
        let counts = std::mem::take(&mut fragment.counts);
        Self { rest: fragment, packed: packing::pack(&counts).into(), packed_counts: counts.len() }
    }
}

/// Checks every field of a received fragment and unpacks it.
///
/// # Errors
/// As [`check`].
pub fn decode(message: v1::Fragment, spec: &FragmentSpec) -> Result<Fragment, Violation> {
    Ok(check(message, spec)?.unpack())
}

/// Checks every field of a received fragment.
///
/// Whether the fragment is wanted (session, episode, duplicate, staleness) is for the caller to decide.
///
/// # Errors
/// The first [`Violation`], its field named from `fragment.` on.
pub fn check(message: v1::Fragment, spec: &FragmentSpec) -> Result<Checked, Violation> {
    ActorId::parse(&message.actor_id, "fragment.actor_id")?;
    if message.scenario != spec.scenario {
        return Err(violation(
            "scenario",
            format!("is {:?} instead of {:?}", message.scenario, spec.scenario),
        ));
    }
    if message.layout_hash != spec.layout_hash {
        return Err(violation(
            "layout_hash",
            format!(
                "is {:?}, but scenario {} has layout {} here; give learner and actor the same network",
                message.layout_hash, spec.scenario, spec.layout_hash
            ),
        ));
    }
    let steps = check_steps(&message, spec)?;
    let end = check_end(&message, spec)?;

    let agents = spec.agents();
    check_phases("phases", &message.phases, steps + 1, &spec.layout)?;
    check_phases("actions", &message.actions, steps, &spec.layout)?;
    check_floats("log_probs", &message.log_probs, steps, &spec.layout)?;
    check_floats("rewards", &message.rewards, steps, &spec.layout)?;
    check_log_probs(&message.log_probs, &spec.layout)?;
    check_rewards(&message.rewards, &spec.layout)?;
    let counts = (steps + 1) * spec.counts_per_step();
    packing::check(&message.counts, counts).map_err(|error| violation("counts", error.to_string()))?;
    let state = if message.first_step == 0 { 0 } else { agents * spec.hidden };
    let recurrent = RecurrentState {
        actor: floats_from_bytes("actor_state", &message.actor_state, state, message.first_step)?,
        critic: floats_from_bytes("critic_state", &message.critic_state, state, message.first_step)?,
    };
    let rest = Fragment {
        id: FragmentId {
            actor: message.actor_id,
            session_epoch: message.session_epoch,
            episode: message.episode,
            sequence: message.sequence,
        },
        scenario: message.scenario,
        layout_hash: message.layout_hash,
        policy_version: message.policy_version,
        first_step: message.first_step,
        steps: message.steps,
        counts: Vec::new(),
        phases: message.phases.into(),
        actions: message.actions.into(),
        log_probs: message.log_probs,
        rewards: message.rewards,
        recurrent,
        end,
    };
    // A copy: what it is a part of, the buffer of a whole message or several, must not stay for its sake.
    Ok(Checked { rest, packed: message.counts.as_ref().into(), packed_counts: counts })
}

/// The number of steps, once it and its place in the episode are possible.
fn check_steps(message: &v1::Fragment, spec: &FragmentSpec) -> Result<usize, Violation> {
    if message.steps == 0 || message.steps > spec.max_steps {
        return Err(violation(
            "steps",
            format!("is {}; a fragment has 1 to {} steps", message.steps, spec.max_steps),
        ));
    }
    let end = u64::from(message.first_step) + u64::from(message.steps);
    if end > u64::from(spec.steps_per_episode) {
        return Err(violation(
            "first_step",
            format!(
                "is {}, so that {} steps go past the {} of an episode",
                message.first_step, message.steps, spec.steps_per_episode
            ),
        ));
    }
    if (message.sequence == 0) != (message.first_step == 0) {
        return Err(violation(
            "sequence",
            format!(
                "is {} at step {}; exactly the fragment that starts an episode has sequence 0",
                message.sequence, message.first_step
            ),
        ));
    }
    // u32 fits usize on every platform that libtorch runs on.
    Ok(message.steps as usize)
}

fn check_end(message: &v1::Fragment, spec: &FragmentSpec) -> Result<FragmentEnd, Violation> {
    match v1::FragmentEnd::try_from(message.end) {
        Ok(v1::FragmentEnd::Continues) if message.first_step + message.steps == spec.steps_per_episode => {
            Err(violation("end", "says that the episode goes on after its last step"))
        }
        Ok(v1::FragmentEnd::Continues) => Ok(FragmentEnd::Continues),
        Ok(v1::FragmentEnd::Truncated) => Ok(FragmentEnd::Truncated),
        Ok(v1::FragmentEnd::Terminated) => Ok(FragmentEnd::Terminated),
        Ok(v1::FragmentEnd::Unspecified) => Err(violation("end", "is missing")),
        Err(_) => Err(violation("end", format!("is {}, which means nothing", message.end))),
    }
}

/// Checks `[rows, agents]` phase indices.
fn check_phases(field: &str, values: &[u8], rows: usize, layout: &NetworkLayout) -> Result<(), Violation> {
    check_length(field, values.len(), rows, layout)?;
    // An intersection has at most u8::MAX phases (sim's limit), so that no number is cut short here.
    let phases: Vec<u8> =
        layout.intersections.iter().map(|own| u8::try_from(own.phases.len()).unwrap_or(u8::MAX)).collect();
    for row in values.chunks_exact(phases.len().max(1)) {
        if let Some(agent) = first(row.iter().zip(&phases), |(value, phases)| value >= phases) {
            let (value, intersection) = (row[agent], &layout.intersections[agent]);
            let (id, phases) = (&intersection.id, intersection.phases.len());
            let problem = format!("has {value} for intersection {id}, which has {phases} phases");
            return Err(violation(field, problem));
        }
    }
    Ok(())
}

/// Where the first of the values is that something is wrong with.
///
/// Nothing ever is, with honest actors, so all are looked at without a branch for each, which a processor does many at a time; the
/// place is looked for afterwards.
fn first<T>(values: impl Iterator<Item = T> + Clone, wrong: impl Fn(T) -> bool) -> Option<usize> {
    let any = values.clone().fold(false, |any, value| any | wrong(value));
    if any { values.enumerate().find_map(|(index, value)| wrong(value).then_some(index)) } else { None }
}

/// Checks `[rows, agents]` finite numbers.
fn check_floats(field: &str, values: &[f32], rows: usize, layout: &NetworkLayout) -> Result<(), Violation> {
    check_length(field, values.len(), rows, layout)?;
    match first(values.iter(), |value| !value.is_finite()) {
        Some(index) => Err(violation(
            field,
            format!(
                "has {} for {}; only finite numbers can be learned from",
                values[index],
                at(index, layout)
            ),
        )),
        None => Ok(()),
    }
}

/// Finite is not enough: one absurd value would make the loss of a whole round infinite.
fn check_log_probs(values: &[f32], layout: &NetworkLayout) -> Result<(), Violation> {
    match first(values.iter(), |p| !(LEAST_LOG_PROB..=LOG_PROB_SLACK).contains(p)) {
        Some(index) => Err(violation(
            "log_probs",
            format!(
                "has {} for {}; a log-probability of a chosen phase lies between {LEAST_LOG_PROB} and 0",
                values[index],
                at(index, layout)
            ),
        )),
        None => Ok(()),
    }
}

/// A reward counts vehicles on the incoming lanes and behind them, and a count has 16 bits.
fn check_rewards(values: &[f32], layout: &NetworkLayout) -> Result<(), Violation> {
    let most: Vec<f32> =
        layout.intersections.iter().map(|own| f32::from(u16::MAX) * own.incoming.len() as f32).collect();
    for (row, rewards) in values.chunks_exact(most.len().max(1)).enumerate() {
        if let Some(agent) = first(rewards.iter().zip(&most), |(reward, most)| reward.abs() > *most) {
            let place = at(row * most.len() + agent, layout);
            let reward = rewards[agent];
            return Err(violation(
                "rewards",
                format!("has {reward} for {place}; its lanes cannot hold that many vehicles"),
            ));
        }
    }
    Ok(())
}

fn check_length(field: &str, length: usize, rows: usize, layout: &NetworkLayout) -> Result<(), Violation> {
    let agents = layout.agents();
    if length == rows * agents {
        return Ok(());
    }
    Err(violation(
        field,
        format!("holds {length} values instead of {} ({rows} rows of {agents} agents)", rows * agents),
    ))
}

/// Where in `[rows, agents]` an index lies, in words.
fn at(index: usize, layout: &NetworkLayout) -> String {
    let agents = layout.agents().max(1);
    let id = layout.intersections.get(index % agents).map_or("?", |intersection| intersection.id.as_str());
    format!("intersection {id} at step {} of the fragment", index / agents)
}

fn violation(field: &str, description: impl Into<String>) -> Violation {
    Violation::new(format!("fragment.{field}"), description)
}

/// Little-endian float32 bytes.
fn floats_to_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn floats_from_bytes(
    field: &str,
    bytes: &[u8],
    expected: usize,
    first_step: u32,
) -> Result<Vec<f32>, Violation> {
    if bytes.len() != expected * size_of::<f32>() {
        return Err(violation(
            field,
            format!(
                "holds {} bytes instead of {} at step {first_step}; it is empty exactly at step 0",
                bytes.len(),
                expected * size_of::<f32>()
            ),
        ));
    }
    let values: Vec<f32> = bytes.as_chunks().0.iter().map(|&chunk| f32::from_le_bytes(chunk)).collect();
    match first(values.iter(), |value| (value.abs() > MOST_STATE) | value.is_nan()) {
        Some(index) => Err(violation(
            field,
            format!("holds {}; the state of a gated recurrent unit lies between -1 and 1", values[index]),
        )),
        None => Ok(values),
    }
}

#[cfg(test)]
mod tests;
