//! Golden numbers: the model against an independent, padded, double-precision reference in PyTorch
//! (`tests/reference/golden.py`, which wrote `fixtures/` and shares nothing with this crate).
//!
//! Deviations are the largest absolute difference in a tensor over the reference's largest absolute entry in it; of a
//! scalar loss term, the difference over its absolute value, or over 0.1 for a term smaller than that.
//! `cargo test --release -p cross-model --test golden -- --nocapture` prints the worst of each quantity.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

#[path = "golden/fixture.rs"]
mod fixture;

use cross_model::adam::{Adam, zero_gradients};
use cross_model::batch::Batch;
use cross_model::features::Track;
use cross_model::losses::{self, Loss};
use cross_model::net::{Forward, Net, Role};
use cross_model::snapshot::{self, PolicyMetadata};
use cross_model::{Trainer, UpdateStats};
use fixture::{Fixture, Learning, flat, tensors_of};
use std::collections::BTreeMap;
use tch::Tensor;

const FIXTURES: [&str; 4] = ["paper", "movement", "movement_without_pcc", "movement_without_moe"];
const ADAM_STEPS: usize = 3;
/// They add the same to every phase's logit, which a softmax does not see, so their gradient is zero. Rounding makes some
/// 1e-9 of it and Adam, which divides by a gradient's size, moves them. The policy does not depend on where they are.
const WITHOUT_GRADIENT: [&str; 2] = ["actor.head.bias", "actor.moe.dense.1.bias"];

/// The worst deviation of each quantity.
#[derive(Default)]
struct Report(BTreeMap<&'static str, (f64, String)>);

impl Report {
    fn note(&mut self, quantity: &'static str, deviation: f64, of: &str) {
        let worst = self.0.entry(quantity).or_insert((-1.0, String::new()));
        // A deviation that is not a number is the worst.
        if deviation > worst.0 || deviation.is_nan() {
            *worst = (deviation, of.to_owned());
        }
    }

    /// Compares tensors entry by entry.
    fn tensor(&mut self, quantity: &'static str, of: &str, actual: &Tensor, expected: &Tensor) {
        assert_eq!(actual.size(), expected.size(), "{of}: shapes");
        let (actual, expected) = (flat(actual), flat(expected));
        let scale = largest(expected.iter().copied()).max(1e-12);
        let off = largest(actual.iter().zip(&expected).map(|(a, e)| a - e));
        self.note(quantity, off / scale, of);
    }

    fn scalar(&mut self, quantity: &'static str, of: &str, actual: f64, expected: f64) {
        self.note(quantity, (actual - expected).abs() / expected.abs().max(0.1), of);
    }

    fn at_most(&self, limits: &[(&'static str, f64)]) {
        assert_eq!(self.0.keys().copied().collect::<Vec<_>>(), sorted(limits.iter().map(|l| l.0)));
        for (quantity, limit) in limits {
            let (worst, of) = &self.0[quantity];
            assert!(worst <= limit, "{quantity}: {worst:.1e} in {of}, at most {limit:.0e} allowed");
        }
    }

    fn lines(&self) -> String {
        self.0.iter().map(|(quantity, (worst, of))| format!("{quantity}: {worst:.1e} ({of})\n")).collect()
    }
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).fold(0.0, |a, b| if b.is_nan() { b } else { a.max(b) })
}

fn sorted<T: Ord>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut out: Vec<T> = values.collect();
    out.sort();
    out
}

#[test]
fn features_are_the_references() {
    for name in FIXTURES {
        let fixture = Fixture::load(name);
        let mut report = Report::default();
        let mut compared = 0;
        for (number, fragment) in fixture.fragments.iter().enumerate() {
            let network = fixture.network(&fragment.scenario);
            for (agent, spec) in network.agents.iter().enumerate() {
                let track = Track::new(network, agent, &fragment.counts, &fragment.phases);
                assert_eq!(track.rows, fragment.steps as usize + 1, "{name}");
                let mut compare = |key: &str, values: &[f32], rows: usize| {
                    let of = format!("feature/{number}/{agent}/{key}");
                    let Some(expected) = fixture.tensors.get(&of) else { return };
                    // Of what varies in time the fixture holds the first and the last observation.
                    let width = values.len() / rows;
                    let ends = [&values[..width], &values[values.len() - width..]].concat();
                    let own = if rows == 1 { values } else { ends.as_slice() };
                    let own = Tensor::from_slice(own).view(expected.size().as_slice());
                    report.tensor("feature", &format!("{name} {of}"), &own, expected);
                    compared += 1;
                };
                compare("topology", &spec.topology, 1);
                compare("phase_state", &spec.phase_state, 1);
                compare("states", &track.states, track.rows);
                compare("phases", &track.phases, track.rows);
                compare("context", &track.context, track.rows);
                compare("lanes", &track.lanes, track.rows);
            }
        }
        assert_eq!(
            compared,
            fixture.tensors.keys().filter(|key| key.starts_with("feature/")).count(),
            "{name}: features that were not compared"
        );
        println!("{name}\n{}", report.lines());
        report.at_most(&[("feature", 1e-6)]);
    }
}

/// A forward pass, one way or the other.
type Pass = fn(&Net, &Batch, &Tensor) -> Forward;

/// As on the CPU, and as on every other device.
const PASSES: [(&str, Pass); 2] =
    [("with loops of its own", Net::forward), ("by libtorch alone", Net::forward_without_loops)];

#[test]
fn forward_losses_gradients_and_adam_are_the_references() {
    for (name, (way, pass)) in FIXTURES.into_iter().flat_map(|name| PASSES.map(|pass| (name, pass))) {
        let fixture = Fixture::load(name);
        let learning = Learning::new(&fixture);
        let mut report = Report::default();
        compare_targets(&fixture, &learning, &mut report);
        for (role, net) in [(Role::Actor, &fixture.actor), (Role::Critic, &fixture.critic)] {
            let mut adam = Adam::new(net.params());
            for step in 0..ADAM_STEPS {
                zero_gradients(net.params());
                let forward = pass(net, &learning.minibatch.batch, learning.state(role));
                let loss = loss(role, net, &forward, &fixture, &learning);
                loss.backward().unwrap();
                let key = format!("loss/{}/totals", role.name());
                let of = format!("{name} {key} step {step}");
                let total = loss.total().double_value(&[]);
                report.scalar("total loss", &of, total, flat(&fixture.tensors[&key])[step]);
                if step == 0 {
                    compare_forward(&fixture, &learning, (role, net), &forward, &mut report);
                    compare_terms(&fixture, role, &loss, &mut report);
                    compare_gradients(&fixture, net, &mut report);
                }
                let ppo = &fixture.config.ppo;
                let lr = if role == Role::Actor { ppo.actor_lr } else { ppo.critic_lr };
                let norm = adam.step(net.params(), lr, ppo.max_grad_norm);
                let key = format!("norm/{}", role.name());
                report.scalar("gradient norm", &key, norm, flat(&fixture.tensors[&key])[step]);
            }
            compare_after(&fixture, net.params().iter(), &mut report);
        }
        println!("{name}, {way}\n{}", report.lines());
        report.at_most(&[
            ("target", 1e-5),
            ("forward", 1e-5),
            ("total loss", 1e-5),
            ("loss term", 1e-5),
            ("gradient", 1e-4),
            ("gradient norm", 1e-5),
            ("weight after", 1e-4),
        ]);
    }
}

/// The trainer itself, from fragments to weights: one epoch is one minibatch here, so three epochs are the three steps,
/// whatever order its sequences are shuffled into.
#[test]
fn an_update_of_the_trainer_ends_at_the_references_weights() {
    for name in FIXTURES {
        let fixture = Fixture::load(name);
        let mut trainer = Trainer::new(&fixture.config, fixture.layouts.clone()).unwrap();
        let metadata = PolicyMetadata {
            policy_version: 1,
            env: fixture.config.env.clone(),
            model: fixture.config.model.clone(),
        };
        let model = snapshot::write_policy(&fixture.actor, &fixture.critic, &metadata).unwrap();
        let optimizer = trainer.save().unwrap().optimizer;
        trainer.restore(&model, &optimizer).unwrap();
        let stats = trainer.update(&fixture.fragments).unwrap();
        let mut report = Report::default();
        compare_stats(&fixture, &stats, &mut report);
        let after = tensors_of(&trainer.snapshot().unwrap());
        compare_after(&fixture, after.iter().map(|(name, tensor)| (name.as_str(), tensor)), &mut report);
        println!("{name}\n{}", report.lines());
        report.at_most(&[("mean loss", 1e-5), ("mean norm", 1e-5), ("weight after", 1e-4)]);
    }
}

fn loss(role: Role, net: &Net, forward: &Forward, fixture: &Fixture, learning: &Learning) -> Loss {
    let (batch, targets) = (&learning.minibatch.batch, &learning.minibatch.targets);
    let (model, ppo) = (&fixture.config.model, &fixture.config.ppo);
    match role {
        Role::Actor => losses::actor(net, forward, batch, targets, model, ppo, ppo.entropy).0,
        Role::Critic => losses::critic(net, forward, batch, targets, model, ppo),
    }
}

/// Advantages, returns and recurrent states, for which the reference rolls out whole episodes and sums GAE's definition.
fn compare_targets(fixture: &Fixture, learning: &Learning, report: &mut Report) {
    let targets = &learning.minibatch.targets;
    for (key, actual) in [
        ("advantages", &targets.advantages),
        ("returns", &targets.returns),
        ("log_probs", &targets.log_probs),
        ("has_next", &targets.has_next),
    ] {
        let of = format!("target/{key}");
        report.tensor("target", &of, actual, &learning.by_sample(&fixture.tensors[&of]));
    }
    for role in [Role::Actor, Role::Critic] {
        let of = format!("target/{}_state", role.name());
        let expected = learning.by_sequence(&fixture.tensors[&of]);
        report.tensor("target", &of, learning.state(role), &expected);
    }
}

fn compare_forward(
    fixture: &Fixture,
    learning: &Learning,
    (role, net): (Role, &Net),
    forward: &Forward,
    report: &mut Report,
) {
    let batch = &learning.minibatch.batch;
    let mut found: Vec<(&str, Tensor)> = vec![("scores", forward.scores.shallow_clone())];
    if role == Role::Actor {
        found.push(("log_policy", batch.log_softmax(&forward.scores)));
        found.push(("h_sp", net.h_sp(batch, forward)));
        found.push(("h_moe", net.h_moe(batch, forward)));
        if let Some(pcc) = &forward.pcc {
            found.push(("z", net.latent(pcc).unwrap()));
            found.push(("similarity", pcc.similarity.shallow_clone()));
            found.push(("w", pcc.weights.shallow_clone()));
            found.push(("z_hat", net.pattern(pcc).unwrap()));
        }
        if let Some((alpha, indices)) = &forward.moe.gates {
            let none = Tensor::zeros([batch.rows, fixture.config.model.experts], tch::kind::FLOAT_CPU);
            found.push(("alpha", none.scatter(1, indices, alpha)));
        }
    }
    let mut keys: Vec<String> = Vec::new();
    for (key, actual) in &found {
        let of = format!("forward/{}/{key}", role.name());
        report.tensor("forward", &of, actual, &learning.by_row(&fixture.tensors[&of]));
        keys.push(of);
    }
    let of = format!("forward/{}/states", role.name());
    report.tensor("forward", &of, &forward.states, &learning.by_sequence(&fixture.tensors[&of]));
    keys.push(of);
    if role == Role::Critic {
        let of = "forward/critic/values";
        let expected = learning.by_sample(&fixture.tensors[of]);
        report.tensor("forward", of, &losses::values(batch, forward), &expected);
        keys.push(of.to_owned());
    }
    assert_eq!(sorted(keys.into_iter()), fixture.keys(&format!("forward/{}/", role.name())));
}

fn compare_terms(fixture: &Fixture, role: Role, loss: &Loss, report: &mut Report) {
    let mut keys = vec![format!("loss/{}/totals", role.name())];
    for (term, actual) in &loss.terms {
        let of = format!("loss/{}/{term}", role.name());
        report.scalar("loss term", &of, actual.double_value(&[]), fixture.tensors[&of].double_value(&[]));
        keys.push(of);
    }
    assert_eq!(sorted(keys.into_iter()), fixture.keys(&format!("loss/{}/", role.name())));
}

fn compare_gradients(fixture: &Fixture, net: &Net, report: &mut Report) {
    for (name, parameter) in net.params().iter() {
        let expected = &fixture.tensors[&format!("grad/{name}")];
        let gradient = parameter.grad();
        if !gradient.defined() {
            // An expert that no phase chose did not run; in the reference all run, these with weight zero.
            assert!(name.contains(".expert") && largest(flat(expected).into_iter()) == 0.0, "{name}");
        } else if WITHOUT_GRADIENT.contains(&name) {
            let size = |tensor: &Tensor| largest(flat(tensor).into_iter());
            assert!(size(expected) < 1e-12 && size(&gradient) < 1e-6, "{name}: {}", size(&gradient));
        } else {
            report.tensor("gradient", name, &gradient, expected);
        }
    }
}

fn compare_after<'a>(
    fixture: &Fixture,
    parameters: impl Iterator<Item = (&'a str, &'a Tensor)>,
    report: &mut Report,
) {
    for (name, parameter) in parameters {
        let expected = &fixture.tensors[&format!("after/{name}")];
        if WITHOUT_GRADIENT.contains(&name) {
            let moved = largest(flat(&(parameter - expected)).into_iter());
            assert!(moved <= ADAM_STEPS as f64 * fixture.config.ppo.actor_lr, "{name} moved by {moved}");
            continue;
        }
        report.tensor("weight after", name, parameter, expected);
    }
}

/// What the trainer reports of an update: means over its minibatches.
fn compare_stats(fixture: &Fixture, stats: &UpdateStats, report: &mut Report) {
    for role in [Role::Actor, Role::Critic] {
        let mean = |key: String| {
            let values = flat(&fixture.tensors[&key]);
            values.iter().sum::<f64>() / values.len() as f64
        };
        let (total, norm) = (format!("{}_total", role.name()), format!("{}_grad_norm", role.name()));
        report.scalar(
            "mean loss",
            &total,
            stats.losses[&total],
            mean(format!("loss/{}/totals", role.name())),
        );
        report.scalar("mean norm", &norm, stats.diagnostics[&norm], mean(format!("norm/{}", role.name())));
    }
    assert_eq!(stats.decisions as i64, fixture.tensors["target/returns"].size()[0]);
}
