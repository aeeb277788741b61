//! A toy street network without SUMO: queues that one phase each serves.
//!
//! Every intersection has one incoming and one outgoing lane per phase. The queues' sizes are drawn anew at each step and
//! the reward is minus what the chosen phase leaves standing, so the best policy serves the longest queue.

#![allow(dead_code, unreachable_pub, reason = "each test file uses its own part")]
#![allow(
    clippy::unwrap_used,
    clippy::too_many_arguments,
    reason = "helpers of tests, outside #[test] functions"
)]

use cross_config::{ComputeDevice, Config};
use cross_model::{ActMode, Policy, Trainer};
use cross_sim::layout::{Intersection, Lane, Movement, NetworkLayout, Phase, Road};
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, Observation};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// An intersection with `phases` phases, each serving `lanes` lanes of its own.
pub fn intersection(id: &str, phases: usize, lanes: usize) -> Intersection {
    let count = phases * lanes;
    let lane = |side: &str, i: usize| Lane::new(format!("{id}_{side}{i}"), 100.0 + i as f32, 13.9);
    let road = |side: &str, i: usize| Road {
        id: format!("{id}_{side}road{i}"),
        length: 100.0,
        speed: 13.9,
        lanes,
        movements: lanes,
    };
    Intersection {
        id: id.to_owned(),
        position: (0.0, 0.0),
        incoming: (0..count).map(|i| lane("in", i)).collect(),
        outgoing: (0..count).map(|i| lane("out", i)).collect(),
        movements: (0..count).map(|i| Movement::new(i, i)).collect(),
        phases: (0..phases)
            .map(|p| Phase {
                state: (0..count).map(|i| if i / lanes == p { 'G' } else { 'r' }).collect(),
                green: (0..count).map(|i| f32::from(u8::from(i / lanes == p))).collect(),
            })
            .collect(),
        roads_in: (0..phases.min(5)).map(|i| road("in", i)).collect(),
        roads_out: (0..phases.min(5)).map(|i| road("out", i)).collect(),
    }
}

/// Three to eight phases, 5 to 36 movements.
pub fn ragged() -> Arc<NetworkLayout> {
    let sizes = [(8, 4), (3, 2), (5, 1), (4, 9), (8, 3), (3, 12), (2, 3)];
    let intersections =
        sizes.iter().enumerate().map(|(i, &(p, l))| intersection(&format!("j{i}"), p, l)).collect();
    Arc::new(NetworkLayout { intersections })
}

/// Small networks and rounds that update in milliseconds.
pub fn tiny_config() -> Config {
    let mut config = Config::default();
    // Where a GPU is, too: these tests compare bits.
    config.learner.device = ComputeDevice::Cpu;
    config.model.hidden = 16;
    config.model.latent = 8;
    config.ppo.sequence_steps = 5;
    config.ppo.minibatch_decisions = 64;
    config.ppo.epochs = 2;
    config.updates = 20;
    config
}

/// The queue world of one layout.
pub struct Toy {
    layout: Arc<NetworkLayout>,
    bands: usize,
    rng: ChaCha8Rng,
}

impl Toy {
    pub fn new(layout: &Arc<NetworkLayout>, config: &Config, seed: u64) -> Self {
        Self {
            layout: Arc::clone(layout),
            bands: config.env.detection.bands(),
            rng: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    fn observe(&mut self, phases: Vec<u8>) -> Observation {
        let mut counts = Vec::new();
        for junction in &self.layout.intersections {
            for lane in 0..junction.lanes() {
                for band in 0..self.bands {
                    let queue = lane < junction.incoming.len() && band == 0;
                    counts.push(if queue { self.rng.random_range(0..8) } else { 0 });
                }
            }
        }
        Observation { counts, phases }
    }

    /// What is left standing when every agent takes the given phase, and the least that any phase leaves.
    fn left(&self, observation: &Observation, actions: &[u8]) -> Vec<(f32, f32)> {
        let mut at = 0;
        let mut out = Vec::new();
        for (junction, &action) in self.layout.intersections.iter().zip(actions) {
            let stopped = |lane: usize| f32::from(observation.counts[at + lane * self.bands]);
            let total: f32 = (0..junction.incoming.len()).map(stopped).sum();
            let served = |p: usize| -> f32 {
                let green = &junction.phases[p].green;
                junction.movements.iter().zip(green).map(|(m, g)| g * stopped(m.incoming)).sum()
            };
            let best = (0..junction.phases.len()).map(served).fold(0.0, f32::max);
            out.push((total - served(usize::from(action)), total - best));
            at += junction.lanes() * self.bands;
        }
        out
    }

    /// Plays one fragment of `steps` steps; the second value is the mean reward lost against the best policy.
    pub fn play(
        &mut self,
        policy: &mut Policy,
        scenario: &str,
        id: FragmentId,
        first_step: u32,
        steps: u32,
        end: FragmentEnd,
        greedy: bool,
    ) -> (Fragment, f32) {
        if first_step == 0 {
            policy.begin_episode(&self.layout).unwrap();
        }
        let recurrent = if first_step == 0 { Default::default() } else { policy.recurrent_state() };
        let mut observation = self.observe(vec![0; self.layout.agents()]);
        let mut fragment = Fragment {
            id,
            scenario: scenario.to_owned(),
            layout_hash: self.layout.hash(),
            policy_version: policy.version(),
            first_step,
            steps,
            counts: observation.counts.clone(),
            phases: observation.phases.clone(),
            actions: vec![],
            log_probs: vec![],
            rewards: vec![],
            recurrent,
            end,
        };
        let mut lost = 0.0;
        let mut rng = ChaCha8Rng::seed_from_u64(self.rng.random());
        for _ in 0..steps {
            let mode = if greedy { ActMode::Greedy } else { ActMode::Sample(&mut rng) };
            let decision = policy.act(&observation, mode).unwrap();
            for (left, least) in self.left(&observation, &decision.actions) {
                fragment.rewards.push(-left);
                lost += left - least;
            }
            fragment.log_probs.extend_from_slice(&decision.log_probs);
            observation = self.observe(decision.actions.clone());
            fragment.actions.extend_from_slice(&decision.actions);
            fragment.counts.extend_from_slice(&observation.counts);
            fragment.phases.extend_from_slice(&observation.phases);
        }
        (fragment, lost / (steps as usize * self.layout.agents()) as f32)
    }
}

pub fn id(episode: u64, sequence: u32) -> FragmentId {
    FragmentId { actor: "toy".to_owned(), session_epoch: 1, episode, sequence }
}

/// One round: an episode in two fragments, so that stored recurrent state is used.
pub fn round(trainer: &Trainer, toy: &mut Toy, steps: u32) -> Vec<Fragment> {
    let mut policy = Policy::from_snapshot(&trainer.snapshot().unwrap()).unwrap();
    let episode = trainer.updates();
    let first = toy.play(&mut policy, "toy", id(episode, 0), 0, steps, FragmentEnd::Continues, false).0;
    let second = toy.play(&mut policy, "toy", id(episode, 1), steps, steps, FragmentEnd::Truncated, false).0;
    vec![first, second]
}
