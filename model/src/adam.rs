//! Adam (Kingma and Ba 2015) with its moments as named tensors, so that a checkpoint resumes exactly.
//!
//! `tch`'s own optimisers keep their state where it cannot be read.

use crate::params::Params;
use tch::{Kind, Tensor};

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// State of the optimiser of one network.
///
/// The moments of all parameters lie one after the other, so that a step is a few operations on everything instead of as
/// many on each of some fifty small tensors.
#[derive(Debug)]
pub struct Adam {
    /// First moments, in the parameters' order: views of `all_m`, to be read and overwritten in place.
    pub m: Vec<Tensor>,
    /// Second moments, likewise.
    pub v: Vec<Tensor>,
    /// Steps taken.
    pub t: u64,
    all_m: Tensor,
    all_v: Tensor,
}

impl Adam {
    /// All moments zero.
    #[must_use]
    pub fn new(params: &Params) -> Self {
        let zeros = || {
            let parts: Vec<Tensor> = params.tensors().map(|p| p.detach().zeros_like().view([-1])).collect();
            let all = Tensor::cat(&parts, 0);
            let views = shaped(params, &all);
            (all, views)
        };
        let ((all_m, m), (all_v, v)) = (zeros(), zeros());
        Self { m, v, t: 0, all_m, all_v }
    }

    /// One step along the gradients that `backward` left, whose norm is first cut to `max_norm`. Returns the norm before
    /// the cut, and takes no step if that is not finite.
    pub fn step(&mut self, params: &Params, lr: f64, max_norm: f64) -> f64 {
        tch::no_grad(|| {
            let gradient = gradient(params);
            let norm = (&gradient * &gradient).sum(Kind::Double).double_value(&[]).sqrt();
            if !norm.is_finite() {
                return norm;
            }
            let cut = (max_norm / (norm + 1e-6)).min(1.0);
            self.t += 1;
            let t = i32::try_from(self.t).unwrap_or(i32::MAX);
            let size = lr / (1.0 - BETA1.powi(t));
            let root = (1.0 - BETA2.powi(t)).sqrt();
            let gradient = gradient * cut;
            let _ = self.all_m.lerp_(&gradient, 1.0 - BETA1);
            let _ = self.all_v.g_mul_scalar_(BETA2);
            let _ = self.all_v.g_add_(&(&gradient * &gradient * (1.0 - BETA2)));
            let denominator = self.all_v.sqrt() / root + EPSILON;
            let change = &self.all_m / denominator * size;
            for (param, change) in params.tensors().zip(shaped(params, &change)) {
                let _ = param.shallow_clone().g_sub_(&change);
            }
            norm
        })
    }
}

/// All gradients one after the other.
///
/// An expert that no row chose has a gradient of zero, whether it ever ran in this process or not: else a resumed run, where
/// it has not, would leave moments alone that the first run lets decay.
fn gradient(params: &Params) -> Tensor {
    let parts = params.tensors().map(|param| {
        let own = param.grad();
        if own.defined() { own.reshape([-1]) } else { param.zeros_like().view([-1]) }
    });
    Tensor::cat(&parts.collect::<Vec<_>>(), 0)
}

/// What lies one after the other as views in the parameters' shapes.
fn shaped(params: &Params, all: &Tensor) -> Vec<Tensor> {
    let lengths: Vec<i64> = params.tensors().map(|param| param.numel() as i64).collect();
    let parts = all.split_with_sizes(lengths, 0);
    params.tensors().zip(parts).map(|(param, part)| part.view(param.size().as_slice())).collect()
}

/// Forgets the gradients of the last backward pass.
pub fn zero_gradients(params: &Params) {
    for tensor in params.tensors() {
        let mut grad = tensor.grad();
        if grad.defined() {
            let _ = grad.zero_();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Init;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn follows_the_published_recursion() {
        let mut params = Params::new();
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let x = Init::new("t", &mut params, &mut rng).constant("x", &[1], 1.0);
        let mut adam = Adam::new(&params);
        let (mut value, mut m, mut v) = (1.0f64, 0.0f64, 0.0f64);
        for t in 1..=5 {
            zero_gradients(&params);
            (&x * &x).sum(Kind::Float).backward();
            let norm = adam.step(&params, 0.1, 1e9);
            let gradient = 2.0 * value;
            assert!((norm - gradient.abs()).abs() < 1e-4);
            m = 0.9 * m + 0.1 * gradient;
            v = 0.999 * v + 0.001 * gradient * gradient;
            value -= 0.1 * (m / (1.0 - 0.9f64.powi(t))) / ((v / (1.0 - 0.999f64.powi(t))).sqrt() + 1e-8);
            assert!((x.double_value(&[0]) - value).abs() < 1e-5);
        }
    }

    #[test]
    fn a_parameter_without_a_gradient_goes_on_as_with_a_zero_one() {
        let step_twice = |idle_in_new_process: bool| {
            let mut params = Params::new();
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            let mut init = Init::new("t", &mut params, &mut rng);
            let (busy, idle) = (init.constant("busy", &[1], 1.0), init.constant("idle", &[1], 1.0));
            let mut adam = Adam::new(&params);
            if idle_in_new_process {
                // Moments from a checkpoint, and no gradient yet.
                let _ = tch::no_grad(|| adam.m[1].fill_(0.2));
                let _ = tch::no_grad(|| adam.v[1].fill_(0.004));
                adam.t = 1;
                (&busy * 1.0).sum(Kind::Float).backward();
            } else {
                (&busy * 1.0 + &idle * 1.0).sum(Kind::Float).backward();
                zero_gradients(&params);
                let _ = tch::no_grad(|| adam.m[1].fill_(0.2));
                let _ = tch::no_grad(|| adam.v[1].fill_(0.004));
                adam.t = 1;
            }
            adam.step(&params, 0.1, 1e9);
            (idle.double_value(&[0]), adam.m[1].double_value(&[0]))
        };
        let (first_run, resumed) = (step_twice(false), step_twice(true));
        assert_eq!(first_run, resumed);
        assert!(first_run.0 < 1.0 && first_run.1 < 0.2, "it moves on its momentum, which decays");
    }

    #[test]
    fn a_gradient_that_is_not_a_number_changes_nothing() {
        let mut params = Params::new();
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let x = Init::new("t", &mut params, &mut rng).constant("x", &[1], 1.0);
        let mut adam = Adam::new(&params);
        (&x * f64::NAN).sum(Kind::Float).backward();
        assert!(adam.step(&params, 0.1, 1.0).is_nan());
        assert_eq!((x.double_value(&[0]), adam.t), (1.0, 0));
    }
}
