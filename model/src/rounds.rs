//! A round's fragments prepared for learning: features, values, advantages, recurrent states. All of it is computed once
//! and stays the same over the epochs.

use crate::batch::{Batch, Sequence};
use crate::error::ModelError;
use crate::features::{FeatureSizes, NetworkSpec, Track};
use crate::gae;
use crate::losses::{self, Targets};
use crate::net::Net;
use crate::policy::floats;
use crate::value_scale::{ValueScale, ValueScales};
use cross_config::{Gfe, PpoConfig, RewardScale};
use cross_sim::trajectory::{Fragment, FragmentEnd};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use tch::{Device, Kind, Tensor};

/// Vehicles that 50 m of lane hold, for reward scaling.
const LANE_CAPACITY: f32 = 7.0;

/// What one agent saw, did and got along a fragment.
#[derive(Debug)]
pub struct Piece {
    scenario: usize,
    agent: usize,
    track: Track,
    steps: usize,
    actions: Vec<u8>,
    log_probs: Vec<f32>,
    rewards: Vec<f32>,
    /// `[steps + 1]`, the last for bootstrapping.
    values: Vec<f32>,
    advantages: Vec<f32>,
    returns: Vec<f32>,
    /// Recurrent states before every step `[steps, hidden]`.
    actor_states: Vec<f32>,
    critic_states: Vec<f32>,
    /// Whether the step after the last one belongs to the episode.
    goes_on: bool,
}

/// A training sequence: steps `start .. start + steps` of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slice {
    piece: usize,
    start: usize,
    /// Length in steps.
    pub steps: usize,
}

/// A packed minibatch with everything that the two losses need.
#[derive(Debug)]
pub struct Minibatch {
    /// Inputs.
    pub batch: Batch,
    /// What to fit.
    pub targets: Targets,
    /// Recurrent state of the actor network at the start of each sequence `[sequences, hidden]`.
    pub actor_state: Tensor,
    /// The same for the critic.
    pub critic_state: Tensor,
    /// Index of each sample's scenario among the run's `[samples]`, in packed order.
    pub scenario_of_sample: Tensor,
}

impl Minibatch {
    /// The same minibatch on a device, whole.
    #[must_use]
    pub fn to_device(self, device: Device) -> Self {
        Self {
            batch: self.batch.to_device(device),
            targets: self.targets.to_device(device),
            actor_state: self.actor_state.to_device(device),
            critic_state: self.critic_state.to_device(device),
            scenario_of_sample: self.scenario_of_sample.to_device(device),
        }
    }
}

/// Networks of the run by scenario name, in the configuration's order.
pub type Networks = Vec<(String, Arc<NetworkSpec>)>;

/// A round of all scenarios.
#[derive(Debug)]
pub struct Round {
    networks: Networks,
    /// How each network's critic outputs and returns belong together.
    scales: Vec<ValueScale>,
    pieces: Vec<Piece>,
    hidden: usize,
}

impl Round {
    /// Prepares fragments under the present networks. `scales` are those under which the critic has learned so far; they
    /// take this round's returns in, for it to learn them from now on.
    ///
    /// # Errors
    /// [`ModelError::UnknownScenario`] or [`ModelError::Shape`] for a fragment that does not belong here.
    pub fn new(
        fragments: &[Fragment],
        networks: &Networks,
        nets: (&Net, &Net),
        sizes: &FeatureSizes,
        hidden: i64,
        ppo: &PpoConfig,
        scales: &mut ValueScales,
    ) -> Result<Self, ModelError> {
        let mut round = Self {
            networks: networks.clone(),
            scales: networks
                .iter()
                .map(|(name, _)| match ppo.value_scale {
                    cross_config::ValueScale::Scenario => scales.of(name),
                    cross_config::ValueScale::Raw => ValueScale::IDENTITY,
                })
                .collect(),
            pieces: Vec::new(),
            hidden: hidden as usize,
        };
        let mut firsts = Vec::with_capacity(fragments.len());
        for fragment in fragments {
            let scenario = networks
                .iter()
                .position(|(name, _)| *name == fragment.scenario)
                .ok_or_else(|| ModelError::UnknownScenario(fragment.scenario.clone()))?;
            check(fragment, &networks[scenario].1, hidden as usize)?;
            firsts.push(round.pieces.len());
            round.push_fragment(fragment, scenario, nets, sizes, ppo);
        }
        round.estimate_advantages(fragments, &firsts, ppo);
        if ppo.value_scale == cross_config::ValueScale::Scenario {
            round.rescale(scales);
        }
        Ok(round)
    }

    fn rescale(&mut self, scales: &mut ValueScales) {
        for (scenario, (name, _)) in self.networks.iter().enumerate() {
            let own = self.pieces.iter().filter(|piece| piece.scenario == scenario);
            scales.observe(name, own.flat_map(|piece| piece.returns.iter().copied()));
            self.scales[scenario] = scales.of(name);
        }
    }

    /// Agent-decisions in it.
    #[must_use]
    pub fn decisions(&self) -> u64 {
        self.pieces.iter().map(|piece| piece.steps as u64).sum()
    }

    fn push_fragment(
        &mut self,
        fragment: &Fragment,
        scenario: usize,
        (actor, critic): (&Net, &Net),
        sizes: &FeatureSizes,
        ppo: &PpoConfig,
    ) {
        let network = Arc::clone(&self.networks[scenario].1);
        let value_scale = self.scales[scenario];
        let (agents, steps, hidden) = (network.agents.len(), fragment.steps as usize, self.hidden);
        let tracks: Vec<Track> = (0..agents)
            .map(|agent| Track::new(&network, agent, &fragment.counts, &fragment.phases))
            .collect();
        let list: Vec<Sequence<'_>> = tracks
            .iter()
            .enumerate()
            .map(|(agent, track)| Sequence { network: &network, agent, track, start: 0 })
            .collect();
        let device = actor.device();
        let batch = Batch::new(&list, steps + 1, sizes).to_device(device);
        let initial = |stored: &[f32]| packed_state(stored, &batch.order, hidden).to_device(device);
        let (actor_start, critic_start) =
            (initial(&fragment.recurrent.actor), initial(&fragment.recurrent.critic));
        let (actor_states, critic_states, values) = tch::no_grad(|| {
            let forward = critic.forward(&batch, &critic_start);
            (
                actor.advance(&batch, &actor_start),
                forward.states.shallow_clone(),
                losses::values(&batch, &forward),
            )
        });
        let values = floats(&values);
        let shift = |start: &Tensor, states: &Tensor| {
            floats(&Tensor::cat(&[start.unsqueeze(1), states.narrow(1, 0, steps as i64 - 1)], 1))
        };
        let actor_states = shift(&actor_start, &actor_states);
        let critic_states = shift(&critic_start, &critic_states);
        let column =
            |all: &[f32], agent: usize| all.iter().skip(agent).step_by(agents).copied().collect::<Vec<f32>>();
        let mut by_agent: Vec<Option<Piece>> = (0..agents).map(|_| None).collect();
        let mut tracks: Vec<Option<Track>> = tracks.into_iter().map(Some).collect();
        for (position, &agent) in batch.order.iter().enumerate() {
            let scale = reward_scale(&network, agent, ppo);
            let outputs = &values[position * (steps + 1)..(position + 1) * (steps + 1)];
            let mut own_values: Vec<f32> = outputs.iter().map(|&v| value_scale.to_return(v)).collect();
            if fragment.end == FragmentEnd::Terminated {
                own_values[steps] = 0.0;
            }
            let states =
                |all: &[f32]| all[position * steps * hidden..(position + 1) * steps * hidden].to_vec();
            by_agent[agent] = Some(Piece {
                scenario,
                agent,
                track: tracks[agent].take().unwrap_or_default(),
                steps,
                actions: fragment.actions.iter().skip(agent).step_by(agents).copied().collect(),
                log_probs: column(&fragment.log_probs, agent),
                rewards: column(&fragment.rewards, agent).iter().map(|r| r * scale).collect(),
                values: own_values,
                advantages: Vec::new(),
                returns: Vec::new(),
                actor_states: states(&actor_states),
                critic_states: states(&critic_states),
                goes_on: fragment.end == FragmentEnd::Continues,
            });
        }
        self.pieces.extend(by_agent.into_iter().flatten());
    }

    /// Fragments of one episode that came in the same round are joined, so that no advantage is cut short at their seam.
    fn estimate_advantages(&mut self, fragments: &[Fragment], firsts: &[usize], ppo: &PpoConfig) {
        let by_id: HashMap<_, usize> = fragments
            .iter()
            .enumerate()
            .map(|(i, f)| ((&f.id.actor, f.id.session_epoch, f.id.episode, f.id.sequence), i))
            .collect();
        let mut latest_first: Vec<usize> = (0..fragments.len()).collect();
        latest_first.sort_by_key(|&i| std::cmp::Reverse(fragments[i].id.sequence));
        for i in latest_first {
            let id = &fragments[i].id;
            let next = (fragments[i].end == FragmentEnd::Continues)
                .then(|| by_id.get(&(&id.actor, id.session_epoch, id.episode, id.sequence + 1)))
                .flatten()
                .copied();
            let agents = self.networks[self.pieces[firsts[i]].scenario].1.agents.len();
            for agent in 0..agents {
                let tail = next.map_or(0.0, |n| self.pieces[firsts[n] + agent].advantages[0]);
                let piece = &mut self.pieces[firsts[i] + agent];
                piece.advantages =
                    gae::advantages(&piece.rewards, &piece.values, tail, ppo.gamma, ppo.gae_lambda);
                piece.returns = piece.advantages.iter().zip(&piece.values).map(|(a, v)| a + v).collect();
            }
        }
        if ppo.normalise_advantages {
            for scenario in 0..self.networks.len() {
                let own = self.pieces.iter_mut().filter(|piece| piece.scenario == scenario);
                gae::normalise(own.flat_map(|piece| piece.advantages.iter_mut()));
            }
        }
    }

    /// All training sequences of at most `steps` steps, by length: equal lengths pack without padding.
    #[must_use]
    pub fn slices(&self, steps: usize) -> BTreeMap<usize, Vec<Slice>> {
        let mut by_length: BTreeMap<usize, Vec<Slice>> = BTreeMap::new();
        for (piece, own) in self.pieces.iter().enumerate() {
            for start in (0..own.steps).step_by(steps) {
                let length = steps.min(own.steps - start);
                by_length.entry(length).or_default().push(Slice { piece, start, steps: length });
            }
        }
        by_length
    }

    /// The sequences of one epoch, shuffled, in minibatches of one length each.
    pub fn minibatches(&self, ppo: &PpoConfig, rng: &mut ChaCha8Rng) -> Vec<Vec<Slice>> {
        let mut out = Vec::new();
        for (steps, mut own) in self.slices(ppo.sequence_steps as usize) {
            own.shuffle(rng);
            // Equal sizes, each as near the configured one as a whole number of minibatches allows.
            let decisions = own.len() * steps;
            let count = (decisions / ppo.minibatch_decisions as usize).max(1);
            out.extend(own.chunks(own.len().div_ceil(count)).map(<[Slice]>::to_vec));
        }
        out.shuffle(rng);
        out
    }

    /// Packs sequences of equal length. The list must not be empty.
    #[must_use]
    pub fn minibatch(&self, slices: &[Slice], sizes: &FeatureSizes, target: i64) -> Minibatch {
        let steps = slices[0].steps;
        let list: Vec<Sequence<'_>> = slices
            .iter()
            .map(|slice| {
                let piece = &self.pieces[slice.piece];
                let network = &self.networks[piece.scenario].1;
                Sequence { network, agent: piece.agent, track: &piece.track, start: slice.start }
            })
            .collect();
        let batch = Batch::new(&list, steps, sizes);
        let samples = slices.len() * steps;
        let (mut actions, mut log_probs, mut advantages, mut returns) = (
            Vec::with_capacity(samples),
            Vec::with_capacity(samples),
            Vec::with_capacity(samples),
            Vec::with_capacity(samples),
        );
        let (mut next, mut has_next) =
            (Vec::with_capacity(samples * target as usize), Vec::with_capacity(samples));
        let (mut actor_state, mut critic_state) = (Vec::new(), Vec::new());
        let mut scenarios = Vec::with_capacity(samples);
        for &i in &batch.order {
            let slice = slices[i];
            let piece = &self.pieces[slice.piece];
            scenarios.resize(scenarios.len() + steps, piece.scenario as i64);
            let range = slice.start..slice.start + steps;
            actions.extend_from_slice(&piece.actions[range.clone()]);
            log_probs.extend_from_slice(&piece.log_probs[range.clone()]);
            advantages.extend_from_slice(&piece.advantages[range.clone()]);
            let scale = self.scales[piece.scenario];
            returns.extend(piece.returns[range.clone()].iter().map(|&value| scale.to_output(value)));
            for t in range {
                self.push_next(piece, t, sizes, &mut next);
                has_next.push(f32::from(u8::from(t + 1 < piece.steps || piece.goes_on)));
            }
            let own = slice.start * self.hidden..(slice.start + 1) * self.hidden;
            actor_state.extend_from_slice(&piece.actor_states[own.clone()]);
            critic_state.extend_from_slice(&piece.critic_states[own]);
        }
        let state = |values: &[f32]| Tensor::from_slice(values).view([-1, self.hidden as i64]);
        let targets = Targets {
            chosen_rows: batch.chosen_rows(&actions),
            log_probs: Tensor::from_slice(&log_probs),
            advantages: Tensor::from_slice(&advantages),
            returns: Tensor::from_slice(&returns),
            next: Tensor::from_slice(&next).view([-1, target]),
            has_next: Tensor::from_slice(&has_next),
        };
        Minibatch {
            batch,
            targets,
            actor_state: state(&actor_state),
            critic_state: state(&critic_state),
            scenario_of_sample: Tensor::from_slice(&scenarios),
        }
    }

    /// Appends what prediction should meet after step `t`: the next state, or the chosen phase's next pooled counts.
    fn push_next(&self, piece: &Piece, t: usize, sizes: &FeatureSizes, next: &mut Vec<f32>) {
        let network = &self.networks[piece.scenario].1;
        match network.gfe {
            Gfe::Paper => {
                let width = sizes.state as usize;
                next.extend_from_slice(&piece.track.states[(t + 1) * width..(t + 2) * width]);
            }
            Gfe::Movement => {
                let phases = network.agents[piece.agent].phases;
                let at = ((t + 1) * phases + usize::from(piece.actions[t])) * sizes.phase as usize;
                next.extend_from_slice(&piece.track.phases[at..at + sizes.pooled as usize]);
            }
        }
    }

    /// How much of the returns' variance the values explain: 1 is all, below 0 is worse than their mean.
    #[must_use]
    pub fn explained_variance(&self) -> f64 {
        self.explained(|_| true)
    }

    /// The same within one scenario, by its index in the run.
    #[must_use]
    pub fn explained_variance_of(&self, scenario: usize) -> f64 {
        self.explained(|piece| piece.scenario == scenario)
    }

    fn explained(&self, counts: impl Fn(&Piece) -> bool) -> f64 {
        let pairs = || {
            self.pieces
                .iter()
                .filter(|piece| counts(piece))
                .flat_map(|p| p.returns.iter().zip(&p.values).map(|(r, v)| (f64::from(*r), f64::from(*v))))
        };
        let variance = |values: &mut dyn Iterator<Item = f64>| {
            let all: Vec<f64> = values.collect();
            let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
            all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / all.len().max(1) as f64
        };
        let returns = variance(&mut pairs().map(|(r, _)| r));
        let rest = variance(&mut pairs().map(|(r, v)| r - v));
        if returns > 0.0 { 1.0 - rest / returns } else { 0.0 }
    }
}

/// Factor from raw rewards to those learned from.
fn reward_scale(network: &NetworkSpec, agent: usize, ppo: &PpoConfig) -> f32 {
    let factor = ppo.reward_factor as f32;
    match ppo.reward_scale {
        RewardScale::Raw => factor,
        RewardScale::Capacity => factor / (LANE_CAPACITY * network.agents[agent].incoming.max(1) as f32),
    }
}

/// Stored states `[agents, hidden]` in packed order; zeros where none are stored, which is at an episode's start.
fn packed_state(stored: &[f32], order: &[usize], hidden: usize) -> Tensor {
    let shape = [order.len() as i64, hidden as i64];
    if stored.is_empty() {
        return Tensor::zeros(shape, (Kind::Float, Device::Cpu));
    }
    let values: Vec<f32> = order
        .iter()
        .flat_map(|&agent| stored[agent * hidden..(agent + 1) * hidden].iter().copied())
        .collect();
    Tensor::from_slice(&values).view(shape)
}

/// The wire has checked all this; a caller in the same process may not have.
fn check(fragment: &Fragment, network: &NetworkSpec, hidden: usize) -> Result<(), ModelError> {
    let (agents, steps) = (network.agents.len(), fragment.steps as usize);
    let counts = network.lane_rows * network.bands;
    let state = if fragment.first_step == 0 { 0 } else { agents * hidden };
    for (what, got, wanted) in [
        ("a fragment's steps", steps.min(1), 1),
        ("a fragment's counts", fragment.counts.len(), (steps + 1) * counts),
        ("a fragment's phases", fragment.phases.len(), (steps + 1) * agents),
        ("a fragment's actions", fragment.actions.len(), steps * agents),
        ("a fragment's log_probs", fragment.log_probs.len(), steps * agents),
        ("a fragment's rewards", fragment.rewards.len(), steps * agents),
        ("a fragment's actor state", fragment.recurrent.actor.len(), state),
        ("a fragment's critic state", fragment.recurrent.critic.len(), state),
    ] {
        if got != wanted {
            return Err(ModelError::Shape { what, scenario: fragment.scenario.clone(), got, wanted });
        }
    }
    for (what, choices) in
        [("a fragment's action", &fragment.actions), ("a fragment's phase", &fragment.phases)]
    {
        for (i, &choice) in choices.iter().enumerate() {
            let wanted = network.agents[i % agents].phases;
            if usize::from(choice) >= wanted {
                return Err(ModelError::Shape {
                    what,
                    scenario: fragment.scenario.clone(),
                    got: choice.into(),
                    wanted,
                });
            }
        }
    }
    Ok(())
}
