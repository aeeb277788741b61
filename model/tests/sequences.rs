//! What a training sequence starts from: the recurrent state that the agent had, never zero in mid-episode.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, id, ragged, tiny_config};
use cross_config::{Config, Detection, Gfe};
use cross_model::features::{FeatureSizes, NetworkSpec};
use cross_model::losses::target_width;
use cross_model::net::{Net, Role};
use cross_model::rounds::Round;
use cross_model::snapshot::{self, PolicyMetadata};
use cross_model::value_scale::ValueScales;
use cross_model::{ActMode, Policy};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::{Fragment, FragmentEnd, Observation};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use tch::Tensor;

/// Actor's and critic's states before every step of the fragments, one episode in order: `[step][agent * hidden]`.
fn rollout(policy: &mut Policy, layout: &NetworkLayout, fragments: &[Fragment]) -> Vec<[Vec<f32>; 2]> {
    policy.begin_episode(layout).unwrap();
    let (agents, bands) = (layout.agents(), policy.env().detection.bands());
    let width = layout.lane_rows() * bands;
    let mut states = Vec::new();
    for fragment in fragments {
        for step in 0..fragment.steps as usize {
            let before = policy.recurrent_state();
            states.push([before.actor, before.critic]);
            let observation = Observation {
                counts: fragment.counts[step * width..(step + 1) * width].to_vec(),
                phases: fragment.phases[step * agents..(step + 1) * agents].to_vec(),
            };
            policy.act(&observation, ActMode::Greedy).unwrap();
        }
    }
    states
}

fn rows(tensor: &Tensor) -> Vec<Vec<f32>> {
    Vec::<Vec<f32>>::try_from(tensor).unwrap()
}

fn check(config: &Config) {
    cross_model::set_single_threaded();
    let layout: Arc<NetworkLayout> = ragged();
    let (agents, hidden) = (layout.agents(), config.model.hidden as usize);
    let sizes = FeatureSizes::new(&config.env, &config.model);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let actor = Net::new(Role::Actor, &config.model, &sizes, &mut rng);
    let critic = Net::new(Role::Critic, &config.model, &sizes, &mut rng);
    let metadata = PolicyMetadata { policy_version: 1, env: config.env.clone(), model: config.model.clone() };
    let snapshot = snapshot::write_policy(&actor, &critic, &metadata).unwrap();
    let mut policy = Policy::from_snapshot(&snapshot).unwrap();
    let mut toy = Toy::new(&layout, config, 6);
    // An episode in two fragments, so that both a start inside a fragment and a stored start occur.
    let lengths = [12, 7];
    let first = toy.play(&mut policy, "toy", id(0, 0), 0, lengths[0], FragmentEnd::Continues, false).0;
    let second =
        toy.play(&mut policy, "toy", id(0, 1), lengths[0], lengths[1], FragmentEnd::Truncated, false).0;
    let fragments = [first, second];
    let states = rollout(&mut policy, &layout, &fragments);

    let spec = Arc::new(NetworkSpec::new(&layout, &config.env, &config.model).unwrap());
    let networks = vec![("toy".to_owned(), spec)];
    let nets = (&actor, &critic);
    let (ppo, scales) = (&config.ppo, &mut ValueScales::default());
    let round = Round::new(&fragments, &networks, nets, &sizes, config.model.hidden, ppo, scales).unwrap();
    let sequence = config.ppo.sequence_steps as usize;
    let mut seen = 0;
    for (length, slices) in round.slices(sequence) {
        // The slices' order: fragments, agents, starts.
        let mut starts = Vec::new();
        for (fragment, steps) in lengths.iter().map(|l| *l as usize).enumerate() {
            for agent in 0..agents {
                let own = (0..steps).step_by(sequence).filter(|start| sequence.min(steps - start) == length);
                starts.extend(own.map(|start| (agent, fragments[fragment].first_step as usize + start)));
            }
        }
        assert_eq!(starts.len(), slices.len());
        let minibatch = round.minibatch(&slices, &sizes, target_width(&config.model, &sizes));
        let found = [rows(&minibatch.actor_state), rows(&minibatch.critic_state)];
        for (position, &i) in minibatch.batch.order.iter().enumerate() {
            let (agent, step) = starts[i];
            for (network, found) in found.iter().enumerate() {
                let own = &found[position];
                let expected = &states[step][network][agent * hidden..(agent + 1) * hidden];
                let far = own.iter().zip(expected).any(|(a, b)| (a - b).abs() > 1e-5);
                assert!(!far, "network {network}, agent {agent}, step {step}: {own:?} is not {expected:?}");
                assert_eq!(own.iter().all(|v| *v == 0.0), step == 0, "agent {agent}, step {step}");
                seen += 1;
            }
        }
    }
    // Steps 0, 5, 10 of the first fragment and 12, 17 of the second.
    assert_eq!(seen, 2 * agents * 5);
}

#[test]
fn a_sequence_starts_from_the_state_that_the_agent_had() {
    let mut config = tiny_config();
    check(&config);
    config.model.gfe = Gfe::Paper;
    config.env.detection = Detection::Paper;
    check(&config);
}
