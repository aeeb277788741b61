//! What bfloat16 products cost in accuracy, on networks of the default size.
//!
//! `cargo test --release -p cross-model --test precision -- --nocapture` prints the figures of docs/model.md, and the time
//! of both. The arithmetic is the same on a processor without bfloat16 instructions, where libtorch imitates them.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, ragged, round, tiny_config};
use cross_config::{ComputeDevice, Config, Precision};
use cross_model::adam::zero_gradients;
use cross_model::features::{FeatureSizes, NetworkSpec};
use cross_model::losses;
use cross_model::net::{Net, Role};
use cross_model::rounds::{Minibatch, Round};
use cross_model::value_scale::ValueScales;
use cross_model::{Placement, Trainer};
use cross_sim::trajectory::Fragment;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::Instant;
use tch::{Device, Kind, Tensor};

const BF16: Placement = Placement { device: Device::Cpu, precision: Precision::Bf16 };

/// A network's loss, its gradient in one row, its scores as the loss reads them, and the seconds of one pass both ways.
struct Pass {
    loss: f64,
    gradient: Tensor,
    output: Tensor,
    seconds: f64,
}

fn pass(config: &Config, role: Role, placement: Placement, minibatch: &Minibatch) -> Pass {
    let sizes = FeatureSizes::new(&config.env, &config.model);
    let net = Net::placed(role, &config.model, &sizes, &mut ChaCha8Rng::seed_from_u64(3), placement);
    let mut seconds = f64::INFINITY;
    let mut result = None;
    for _ in 0..3 {
        zero_gradients(net.params());
        let begun = Instant::now();
        let (batch, targets) = (&minibatch.batch, &minibatch.targets);
        let state = if role == Role::Actor { &minibatch.actor_state } else { &minibatch.critic_state };
        let forward = net.forward(batch, state);
        let (loss, output) = match role {
            Role::Actor => (
                losses::actor(&net, &forward, batch, targets, &config.model, &config.ppo, 0.01).0,
                batch.log_softmax(&forward.scores),
            ),
            Role::Critic => (
                losses::critic(&net, &forward, batch, targets, &config.model, &config.ppo),
                losses::values(batch, &forward),
            ),
        };
        loss.backward().unwrap();
        seconds = seconds.min(begun.elapsed().as_secs_f64());
        result = Some((loss.total().double_value(&[]), output.detach()));
    }
    let (loss, output) = result.unwrap();
    let gradients: Vec<Tensor> = net
        .params()
        .tensors()
        .map(|p| if p.grad().defined() { p.grad().reshape([-1]) } else { p.zeros_like().reshape([-1]) })
        .collect();
    let single = |tensor: &Tensor| !tensor.defined() || tensor.kind() == Kind::Float;
    assert!(net.params().tensors().all(|p| single(p) && single(&p.grad())));
    Pass { loss, gradient: Tensor::cat(&gradients, 0), output, seconds }
}

fn norm(x: &Tensor) -> f64 {
    (x * x).sum(Kind::Double).double_value(&[]).sqrt()
}

fn fragments(config: &Config, steps: u32) -> Vec<Fragment> {
    let trainer = Trainer::placed(config, vec![("toy".to_owned(), ragged())], Placement::CPU).unwrap();
    round(&trainer, &mut Toy::new(&ragged(), config, 3), steps)
}

#[test]
fn bf16_products_leave_loss_and_gradient_nearly_alone() {
    cross_model::set_single_threaded();
    let config = Config::default();
    let sizes = FeatureSizes::new(&config.env, &config.model);
    let spec = Arc::new(NetworkSpec::new(&ragged(), &config.env, &config.model).unwrap());
    let networks = vec![("toy".to_owned(), spec)];
    let net = |role| Net::new(role, &config.model, &sizes, &mut ChaCha8Rng::seed_from_u64(3));
    let nets = (&net(Role::Actor), &net(Role::Critic));
    let (hidden, ppo, scales) = (config.model.hidden, &config.ppo, &mut ValueScales::default());
    let round = Round::new(&fragments(&config, 30), &networks, nets, &sizes, hidden, ppo, scales).unwrap();
    let slices = &round.slices(30)[&30];
    let minibatch = round.minibatch(slices, &sizes, losses::target_width(&config.model, &sizes));
    for role in [Role::Actor, Role::Critic] {
        let exact = pass(&config, role, Placement::CPU, &minibatch);
        let rough = pass(&config, role, BF16, &minibatch);
        let loss = (rough.loss - exact.loss).abs() / exact.loss.abs();
        let gradient = norm(&(&rough.gradient - &exact.gradient)) / norm(&exact.gradient);
        let cosine = (&rough.gradient * &exact.gradient).sum(Kind::Double).double_value(&[])
            / (norm(&rough.gradient) * norm(&exact.gradient));
        let output = (&rough.output - &exact.output).abs().max().double_value(&[]);
        println!(
            "{}: loss off by {loss:.1e}, gradient by {gradient:.1e} of its norm (cosine {cosine:.6}), output by at most \
             {output:.1e}; {:.1} ms instead of {:.1} ms a pass over {} samples",
            role.name(),
            1e3 * rough.seconds,
            1e3 * exact.seconds,
            minibatch.batch.samples()
        );
        assert!(output > 0.0, "nothing was computed in bfloat16");
        assert!(loss < 1e-2 && gradient < 5e-2 && cosine > 0.998 && output < 5e-2, "{}", role.name());
    }
}

#[test]
fn a_trainer_in_bf16_learns_and_keeps_its_weights_in_single_precision() {
    cross_model::set_single_threaded();
    let config = tiny_config();
    let layouts = || vec![("toy".to_owned(), ragged())];
    let fragments = fragments(&config, 12);
    let mut exact = Trainer::placed(&config, layouts(), Placement::CPU).unwrap();
    let mut rough = Trainer::placed(&config, layouts(), BF16).unwrap();
    assert_eq!(exact.save().unwrap(), rough.save().unwrap(), "the same weights to begin with");
    for _ in 0..5 {
        let (a, b) = (exact.update(&fragments).unwrap(), rough.update(&fragments).unwrap());
        for (term, value) in &a.losses {
            let off = (value - b.losses[term]).abs();
            // A row whose second and third expert are nearly equal may choose the other one, which the balance of a few
            // dozen rows shows most.
            let allowed = if term.ends_with("load_balance") { 0.3 } else { 0.15 };
            assert!(off <= allowed * value.abs().max(0.1), "{term}: {value} and {}", b.losses[term]);
        }
    }
    assert_ne!(exact.save().unwrap(), rough.save().unwrap());
    // A checkpoint of one resumes in the other: the file holds single precision either way.
    let files = rough.save().unwrap();
    exact.restore(&files.model, &files.optimizer).unwrap();
    assert_eq!(exact.save().unwrap(), files);
}

#[test]
fn a_device_or_precision_that_is_not_there_is_refused() {
    let mut config = tiny_config();
    let machine = cross_model::Abilities::detect();
    let refused =
        |config: &Config| Trainer::new(config, vec![("toy".to_owned(), ragged())]).unwrap_err().to_string();
    if machine.cuda_devices == 0 {
        config.learner.device = ComputeDevice::Cuda;
        assert!(refused(&config).contains("learner.device"));
        config.learner.device = ComputeDevice::Cpu;
    }
    if !machine.cpu_bf16 {
        config.learner.precision = Precision::Bf16;
        assert!(refused(&config).contains("learner.precision"));
    }
}
