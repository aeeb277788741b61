//! The packed model against the plain padded one: from the same weights and the same ragged minibatch the same outputs,
//! losses and gradients, in both forms and every ablation; and from the same fragments the same weights after an update.

#![allow(missing_docs, clippy::unwrap_used, reason = "a test says by failing what went wrong")]

use cross_bench::plain::{self, PaddedMinibatch, PlainLearner, PlainNet};
use cross_bench::update::data::{Shape, episodes, network};
use cross_config::{ComputeDevice, Config, Detection, Gfe};
use cross_model::adam::zero_gradients;
use cross_model::features::{FeatureSizes, NetworkSpec};
use cross_model::losses;
use cross_model::net::{Net, Role};
use cross_model::rounds::{Minibatch, Networks, Round};
use cross_model::value_scale::ValueScales;
use cross_model::{Trainer, snapshot};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;
use tch::{Kind, Tensor};

/// Three to eight phases, 5 to 36 movements, intersections of one number of phases with different lanes.
const RAGGED: [[usize; 3]; 7] =
    [[8, 36, 12], [3, 5, 5], [5, 12, 6], [4, 20, 9], [6, 14, 7], [7, 25, 10], [5, 30, 11]];
const STEPS: u32 = 7;

fn layouts() -> Vec<(String, Arc<cross_sim::layout::NetworkLayout>)> {
    let shape = |[phases, movements, lanes]: [usize; 3]| Shape { agents: 1, phases, movements, lanes };
    let (first, second) = RAGGED.split_at(3);
    [("alpha", first), ("beta", second)]
        .map(|(name, shapes)| {
            let shapes: Vec<Shape> = shapes.iter().map(|&own| shape(own)).collect();
            (name.to_owned(), Arc::new(network(&shapes)))
        })
        .to_vec()
}

/// Both forms, with and without each module.
fn configurations() -> Vec<(String, Config)> {
    let mut out = Vec::new();
    for (gfe, detection) in [(Gfe::Paper, Detection::Paper), (Gfe::Movement, Detection::Default)] {
        for (pcc, moe, detach) in
            [(true, true, false), (true, true, true), (false, true, false), (true, false, false)]
        {
            let mut config = Config::default();
            config.env.detection = detection;
            config.model.gfe = gfe;
            (config.model.pcc, config.model.moe) = (pcc, moe);
            config.model.detach_contrastive_target = detach;
            (config.model.hidden, config.model.latent) = (32, 16);
            (config.model.tau_k, config.model.tau_c) = (0.3, 0.2);
            config.ppo.sequence_steps = 3;
            config.ppo.minibatch_decisions = 1_000_000;
            (config.ppo.load_balance, config.ppo.selection_entropy) = (0.3, 0.2);
            config.ppo.epochs = 1;
            config.ppo.lr_decay = false;
            config.learner.device = ComputeDevice::Cpu;
            out.push((format!("{gfe:?}, pcc {pcc}, moe {moe}, detach {detach}"), config));
        }
    }
    out
}

/// They move all logits of an intersection alike, which a softmax does not see: their gradient is zero but for rounding, which
/// Adam, dividing by its size, makes steps of.
const WITHOUT_GRADIENT: [&str; 2] = ["actor.head.bias", "actor.moe.dense.1.bias"];

/// Actor and critic with weights large enough that nothing is nearly uniform.
fn nets(config: &Config, sizes: &FeatureSizes) -> (Net, Net) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let actor = Net::new(Role::Actor, &config.model, sizes, &mut rng);
    let critic = Net::new(Role::Critic, &config.model, sizes, &mut rng);
    tch::no_grad(|| {
        for net in [&actor, &critic] {
            for (name, tensor) in net.params().iter() {
                let factor = if name == "actor.head.weight" { 100.0 } else { 1.7 };
                let _ = tensor.shallow_clone().g_mul_scalar_(factor);
            }
        }
    });
    (actor, critic)
}

/// Minibatches of a round: sequences of three steps, and what is left over.
fn minibatches(config: &Config, sizes: &FeatureSizes, actor: &Net, critic: &Net) -> Vec<Minibatch> {
    let layouts = layouts();
    let fragments = episodes(&layouts, config, STEPS, 1);
    let networks: Networks = layouts
        .iter()
        .map(|(name, layout)| {
            (name.clone(), Arc::new(NetworkSpec::new(layout, &config.env, &config.model).unwrap()))
        })
        .collect();
    let (hidden, ppo, scales) = (config.model.hidden, &config.ppo, &mut ValueScales::default());
    let round = Round::new(&fragments, &networks, (actor, critic), sizes, hidden, ppo, scales).unwrap();
    let target = losses::target_width(&config.model, sizes);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let minibatches = round.minibatches(&config.ppo, &mut rng);
    minibatches.iter().map(|slices| round.minibatch(slices, sizes, target)).collect()
}

fn largest(tensor: &Tensor) -> f64 {
    tensor.detach().abs().max().double_value(&[])
}

/// Largest difference between two tensors over the second's largest entry.
fn assert_close(actual: &Tensor, expected: &Tensor, limit: f64, floor: f64, of: &str) {
    assert_eq!(actual.size(), expected.size(), "{of}: shapes");
    let off = largest(&(actual - expected)) / largest(expected).max(floor);
    assert!(off <= limit, "{of}: {off:.1e}, at most {limit:.0e} allowed");
}

fn gradients(net: &Net) -> BTreeMap<String, Tensor> {
    net.params()
        .iter()
        .map(|(name, tensor)| {
            let gradient = tensor.grad();
            // What did not run has no gradient, which is the same as zero.
            let gradient = if gradient.defined() { gradient.copy() } else { tensor.detach().zeros_like() };
            (name.to_owned(), gradient)
        })
        .collect()
}

#[test]
fn outputs_losses_and_gradients_agree() {
    cross_model::set_single_threaded();
    for (name, config) in configurations() {
        let sizes = FeatureSizes::new(&config.env, &config.model);
        let (actor, critic) = nets(&config, &sizes);
        let minibatches = minibatches(&config, &sizes, &actor, &critic);
        assert_eq!(minibatches.len(), 2, "sequences of two lengths");
        for minibatch in &minibatches {
            for (role, net) in [(Role::Actor, &actor), (Role::Critic, &critic)] {
                compare(&format!("{name}, {}", role.name()), &config, role, net, minibatch);
            }
        }
    }
}

fn compare(name: &str, config: &Config, role: Role, net: &Net, minibatch: &Minibatch) {
    let (model, ppo) = (&config.model, &config.ppo);
    let (batch, targets) = (&minibatch.batch, &minibatch.targets);
    zero_gradients(net.params());
    let state = if role == Role::Actor { &minibatch.actor_state } else { &minibatch.critic_state };
    let forward = net.forward(batch, state);
    let loss = match role {
        Role::Actor => losses::actor(net, &forward, batch, targets, model, ppo, ppo.entropy).0,
        Role::Critic => losses::critic(net, &forward, batch, targets, model, ppo),
    };
    loss.backward().unwrap();
    let (total, terms) = (loss.total(), &loss.terms);
    let packed_gradients = gradients(net);

    zero_gradients(net.params());
    let padded = PaddedMinibatch::new(minibatch, &config.env);
    let plain_net = PlainNet::new(net, model);
    let state = if role == Role::Actor { &padded.actor_state } else { &padded.critic_state };
    let plain_forward = plain_net.forward(&padded, state);
    let (plain_total, plain_terms) = match role {
        Role::Actor => plain::actor(&plain_forward, &padded, model, ppo),
        Role::Critic => plain::critic(&plain_forward, &padded, model, ppo),
    };
    plain_total.backward();
    let plain_gradients = gradients(net);

    // Boolean selection walks samples, then phases: the packed order of rows.
    let scores = plain_forward.scores.masked_select(&padded.phase_mask);
    assert_close(&forward.scores, &scores, 1e-4, 1e-6, &format!("{name}: scores"));
    assert_close(&total, &plain_total, 1e-4, 0.1, &format!("{name}: total"));
    let names = |terms: &[(&'static str, Tensor)]| terms.iter().map(|term| term.0).collect::<Vec<_>>();
    assert_eq!(names(terms), names(&plain_terms), "{name}");
    for ((term, ours), (_, theirs)) in terms.iter().zip(&plain_terms) {
        assert_close(ours, theirs, 1e-4, 0.1, &format!("{name}: {term}"));
    }
    let norm = plain_gradients.values().map(|g| g.square().sum(Kind::Double).double_value(&[])).sum::<f64>();
    // Small gradients are held to what is left of the large ones by rounding.
    let floor = 1e-3 * norm.sqrt();
    for (parameter, ours) in &packed_gradients {
        let theirs = &plain_gradients[parameter];
        if WITHOUT_GRADIENT.contains(&parameter.as_str()) {
            assert!(largest(ours).max(largest(theirs)) < 1e-4 * norm.sqrt(), "{name}: {parameter}");
        } else {
            assert_close(ours, theirs, 1e-4, floor, &format!("{name}: gradient of {parameter}"));
        }
    }
}

#[test]
fn an_update_ends_at_the_same_weights() {
    cross_model::set_single_threaded();
    for (name, mut config) in configurations() {
        config.ppo.epochs = 2;
        // One minibatch an epoch, so that no order of sequences matters.
        config.ppo.sequence_steps = STEPS;
        let sizes = FeatureSizes::new(&config.env, &config.model);
        let (actor, critic) = nets(&config, &sizes);
        let metadata = snapshot::PolicyMetadata {
            policy_version: 1,
            env: config.env.clone(),
            model: config.model.clone(),
        };
        let policy = snapshot::write_policy(&actor, &critic, &metadata).unwrap();
        let fragments = episodes(&layouts(), &config, STEPS, 2);
        let mut trainer = Trainer::new(&config, layouts()).unwrap();
        let optimizer = trainer.save().unwrap().optimizer;
        trainer.restore(&policy, &optimizer).unwrap();
        let mut learner = PlainLearner::new(&config, layouts(), &policy).unwrap();
        trainer.update(&fragments).unwrap();
        learner.update(&fragments, config.ppo.epochs).unwrap();

        snapshot::load_weights(&trainer.snapshot().unwrap(), &actor, &critic).unwrap();
        let packed: BTreeMap<&str, &Tensor> = actor.params().iter().chain(critic.params().iter()).collect();
        // Adam moves an entry by its learning rate however small its gradient, so where rounding decides the sign of one
        // (the bias of a unit that is active on all phases moves their logits alike) the weights differ by twice that;
        // nearly all must agree far better.
        let (mut far, mut all) = (0.0, 0.0);
        for (parameter, plain) in learner.weights() {
            let off = (packed[parameter] - plain).abs();
            far += off.gt(config.ppo.actor_lr * 0.02).sum(Kind::Float).double_value(&[]);
            all += off.numel() as f64;
        }
        assert!(far / all < 0.02, "{name}: {far} of {all} weights differ");
    }
}
