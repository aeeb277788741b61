//! Every form of the network, on every instruction set at hand, against libtorch's forward pass.

use super::Isa;
use crate::features::FeatureSizes;
use crate::net::{Net, Role};
use crate::plain::PlainPolicy;
use crate::policy::{ActMode, Policy};
use crate::snapshot::{self, PolicyMetadata};
use cross_config::{Detection, EnvConfig, Gfe, ModelConfig};
use cross_sim::layout::{Intersection, Lane, Movement, NetworkLayout, Phase, Road};
use cross_sim::trajectory::Observation;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

/// An intersection whose phases overlap, some green permissive, with more lanes in than out.
fn intersection(phases: usize, lanes: usize) -> Intersection {
    let lane = |side: &str, i: usize| Lane::new(format!("{side}{i}"), 90.0 + i as f32, 13.9);
    let road =
        |i: usize| Road { id: format!("road{i}"), length: 80.0, speed: 11.0, lanes: 1 + i, movements: 2 };
    let outgoing = lanes.div_ceil(2);
    Intersection {
        id: format!("{phases}_{lanes}"),
        position: (0.0, 0.0),
        incoming: (0..lanes).map(|i| lane("in", i)).collect(),
        outgoing: (0..outgoing).map(|i| lane("out", i)).collect(),
        movements: (0..lanes).map(|i| Movement::new(i, i % outgoing)).collect(),
        phases: (0..phases)
            .map(|p| {
                let green: Vec<f32> = (0..lanes).map(|i| [1.0, 0.0, 0.5, 0.0][(i + p) % 4]).collect();
                Phase { state: "G".repeat(lanes), green }
            })
            .collect(),
        roads_in: (0..3).map(road).collect(),
        roads_out: (0..2).map(road).collect(),
    }
}

fn layout() -> NetworkLayout {
    let sizes = [(8, 12), (2, 3), (5, 36), (3, 1), (5, 7)];
    NetworkLayout {
        intersections: sizes.iter().map(|&(phases, lanes)| intersection(phases, lanes)).collect(),
    }
}

struct Case {
    env: EnvConfig,
    model: ModelConfig,
}

fn case(gfe: Gfe, change: impl FnOnce(&mut ModelConfig)) -> Case {
    let detection = if gfe == Gfe::Paper { Detection::Paper } else { Detection::Default };
    let env = EnvConfig { detection, ..EnvConfig::default() };
    let mut model = ModelConfig { gfe, hidden: 24, latent: 12, ..ModelConfig::default() };
    change(&mut model);
    Case { env, model }
}

fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for gfe in [Gfe::Paper, Gfe::Movement] {
        cases.push(case(gfe, |_| {}));
        cases.push(case(gfe, |model| model.pcc = false));
        cases.push(case(gfe, |model| model.moe = false));
        cases.push(case(gfe, |model| (model.pcc, model.moe) = (false, false)));
        cases.push(case(gfe, |model| (model.top_k, model.tau_r) = (1, 0.5)));
        cases.push(case(gfe, |model| (model.top_k, model.experts, model.clusters) = (3, 3, 9)));
        cases.push(case(gfe, |model| (model.hidden, model.latent, model.heads) = (20, 7, 1)));
        cases.push(Case { model: ModelConfig { gfe, ..ModelConfig::default() }, ..case(gfe, |_| {}) });
    }
    cases
}

/// A snapshot of fresh networks, the head as large as the other layers so that scores differ.
fn snapshot(case: &Case, seed: u64, change: impl Fn(&str, &Tensor)) -> Vec<u8> {
    let sizes = FeatureSizes::new(&case.env, &case.model);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let actor = Net::new(Role::Actor, &case.model, &sizes, &mut rng);
    let critic = Net::new(Role::Critic, &case.model, &sizes, &mut rng);
    tch::no_grad(|| {
        for (name, tensor) in actor.params().iter() {
            if name == "actor.head.weight" {
                let _ = tensor.shallow_clone().g_mul_scalar_(100.0);
            }
            change(name, tensor);
        }
    });
    let metadata = PolicyMetadata { policy_version: 1, env: case.env.clone(), model: case.model.clone() };
    snapshot::write_policy(&actor, &critic, &metadata).unwrap()
}

fn observation(layout: &NetworkLayout, env: &EnvConfig, step: usize) -> Observation {
    let counts = layout.lane_rows() * env.detection.bands();
    Observation {
        counts: (0..counts).map(|i| ((i * 7 + step * 5) % 13) as u16).collect(),
        phases: layout.intersections.iter().map(|own| (step % own.phases.len()) as u8).collect(),
    }
}

/// Largest difference, over the largest entry.
fn deviation(own: &[f32], exact: &[f32]) -> f32 {
    assert_eq!(own.len(), exact.len());
    let most = |values: &mut dyn Iterator<Item = f32>| {
        values.fold(0.0, |a: f32, b| if b.abs() > a { b.abs() } else { a })
    };
    assert!(own.iter().all(|v| v.is_finite()));
    most(&mut own.iter().zip(exact).map(|(a, b)| a - b)) / most(&mut exact.iter().copied()).max(1e-6)
}

/// Acts five times with both, and compares all that comes out.
fn compare(isa: Isa, snapshot: &[u8], what: &str) {
    let layout = layout();
    let mut policy = Policy::with(isa, snapshot).unwrap();
    let mut plain = PlainPolicy::from_snapshot(snapshot).unwrap();
    let env = policy.env().clone();
    policy.begin_episode(&layout).unwrap();
    plain.begin_episode(&layout).unwrap();
    let (mut own_rng, mut plain_rng) = (ChaCha8Rng::seed_from_u64(7), ChaCha8Rng::seed_from_u64(7));
    for step in 0..5 {
        let observation = observation(&layout, &env, step);
        let own = policy.act(&observation, ActMode::Sample(&mut own_rng)).unwrap();
        let exact = plain.act(&observation, ActMode::Sample(&mut plain_rng)).unwrap();
        let log_probs = deviation(policy.log_probs(), plain.log_probs());
        assert!(log_probs < 1e-5, "{what} {isa:?} step {step}: log-probabilities {log_probs:e}");
        assert_eq!(own.actions, exact.actions, "{what} {isa:?} step {step}");
        let (own, exact) = (policy.recurrent_state(), plain.recurrent_state());
        for (own, exact) in [(own.actor, exact.actor), (own.critic, exact.critic)] {
            assert!(deviation(&own, &exact) < 1e-5, "{what} {isa:?} step {step}: state");
        }
    }
}

#[test]
fn every_form_of_the_network_decides_as_in_training() {
    crate::set_single_threaded();
    for (number, case) in cases().iter().enumerate() {
        let snapshot = snapshot(case, number as u64, |_, _| {});
        for isa in Isa::available() {
            compare(isa, &snapshot, &format!("{:?}", case.model));
        }
    }
}

/// Experts that the router cannot tell apart: whichever are taken, equal ones must give what training computes.
#[test]
fn ties_of_equal_experts_change_nothing() {
    crate::set_single_threaded();
    let case = case(Gfe::Movement, |_| {});
    let snapshot = snapshot(&case, 3, |name, tensor| {
        let mut tensor = tensor.shallow_clone();
        if name.starts_with("actor.moe.router.1") {
            let _ = tensor.fill_(0.0);
        } else if name.starts_with("actor.moe.expert") {
            let _ = tensor.fill_(0.01);
        }
    });
    for isa in Isa::available() {
        compare(isa, &snapshot, "ties");
    }
}

#[test]
fn a_decision_repeats_itself_bit_for_bit() {
    crate::set_single_threaded();
    let layout = layout();
    let case = case(Gfe::Movement, |_| {});
    let snapshot = snapshot(&case, 4, |_, _| {});
    let play = || {
        let mut policy = Policy::from_snapshot(&snapshot).unwrap();
        // An episode elsewhere leaves its traces in every buffer.
        let elsewhere = NetworkLayout { intersections: vec![intersection(4, 20)] };
        policy.begin_episode(&elsewhere).unwrap();
        policy.act(&observation(&elsewhere, &case.env, 9), ActMode::Greedy).unwrap();
        policy.begin_episode(&layout).unwrap();
        let mut bits = Vec::new();
        for step in 0..4 {
            policy.act(&observation(&layout, &case.env, step), ActMode::Greedy).unwrap();
            bits.extend(policy.log_probs().iter().map(|v| v.to_bits()));
        }
        let state = policy.recurrent_state();
        bits.extend(state.actor.iter().chain(&state.critic).map(|v| v.to_bits()));
        bits
    };
    assert_eq!(play(), play());
    let mut fresh = Policy::from_snapshot(&snapshot).unwrap();
    fresh.begin_episode(&layout).unwrap();
    fresh.act(&observation(&layout, &case.env, 0), ActMode::Greedy).unwrap();
    let first: Vec<u32> = fresh.log_probs().iter().map(|v| v.to_bits()).collect();
    assert_eq!(play()[..first.len()], first, "what went before must not matter");
}

#[test]
fn newer_weights_take_effect_in_mid_episode() {
    crate::set_single_threaded();
    for gfe in [Gfe::Paper, Gfe::Movement] {
        let layout = layout();
        let case = case(gfe, |_| {});
        let (older, newer) = (snapshot(&case, 5, |_, _| {}), snapshot(&case, 6, |_, _| {}));
        let mut policy = Policy::from_snapshot(&older).unwrap();
        policy.begin_episode(&layout).unwrap();
        policy.replace_weights(&newer).unwrap();
        let mut fresh = Policy::from_snapshot(&newer).unwrap();
        fresh.begin_episode(&layout).unwrap();
        let observation = observation(&layout, &case.env, 1);
        policy.act(&observation, ActMode::Greedy).unwrap();
        fresh.act(&observation, ActMode::Greedy).unwrap();
        assert_eq!(policy.log_probs(), fresh.log_probs(), "{gfe:?}");
        assert_eq!(policy.recurrent_state(), fresh.recurrent_state(), "{gfe:?}");
    }
}

#[test]
fn it_makes_no_difference_when_the_critic_catches_up() {
    crate::set_single_threaded();
    for gfe in [Gfe::Paper, Gfe::Movement] {
        let layout = layout();
        let case = case(gfe, |_| {});
        let (older, newer) = (snapshot(&case, 5, |_, _| {}), snapshot(&case, 6, |_, _| {}));
        let play = |often: bool| {
            let mut policy = Policy::from_snapshot(&older).unwrap();
            policy.begin_episode(&layout).unwrap();
            for step in 0..6 {
                policy.act(&observation(&layout, &case.env, step), ActMode::Greedy).unwrap();
                for _ in 0..2 * usize::from(often) {
                    policy.catch_up();
                }
                if step == 3 {
                    // What the old weights have seen, they take in.
                    policy.replace_weights(&newer).unwrap();
                }
            }
            policy.recurrent_state()
        };
        assert_eq!(play(true), play(false), "{gfe:?}");
        // An episode begins with nothing to catch up with.
        let mut policy = Policy::from_snapshot(&older).unwrap();
        policy.begin_episode(&layout).unwrap();
        policy.act(&observation(&layout, &case.env, 0), ActMode::Greedy).unwrap();
        policy.begin_episode(&layout).unwrap();
        assert!(policy.recurrent_state().critic.iter().all(|&value| value == 0.0), "{gfe:?}");
    }
}

#[test]
fn who_only_acts_decides_alike_and_spares_the_critic() {
    crate::set_single_threaded();
    let layout = layout();
    let case = case(Gfe::Movement, |_| {});
    let snapshot = snapshot(&case, 5, |_, _| {});
    let play = |mut policy: Policy| {
        policy.begin_episode(&layout).unwrap();
        let mut log_probs = Vec::new();
        for step in 0..4 {
            policy.act(&observation(&layout, &case.env, step), ActMode::Greedy).unwrap();
            log_probs.extend_from_slice(policy.log_probs());
        }
        (log_probs, policy.recurrent_state())
    };
    let recording = play(Policy::from_snapshot(&snapshot).unwrap());
    let acting = play(Policy::from_snapshot(&snapshot).unwrap().only_acting());
    assert_eq!((&acting.0, &acting.1.actor), (&recording.0, &recording.1.actor));
    assert!(recording.1.critic.iter().any(|&value| value != 0.0));
    assert!(acting.1.critic.iter().all(|&value| value == 0.0));
}
