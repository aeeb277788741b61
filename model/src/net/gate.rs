//! The gated unit on the sum of a phase's part and a sample's part: `a · σ(b)`, with a and b the two halves of the sum.
//!
//! The sum, twice as wide as its result, is never written down, neither forward nor backward: it is computed again on the way
//! back from its two parts, of which there are far fewer than rows.

use super::tape::{Stage, Tape, gradient, leaf, pass_on};
use crate::policy::floats;
use crate::vector::math::{fma, sigmoid};
use crate::vector::{Isa, Work};
use tch::{TchError, Tensor};

/// Two parts `[.., 2 * width]` and which of each a row is the sum of.
#[derive(Debug)]
pub(super) struct Sums {
    /// Parts of phases.
    pub(super) phases: Tensor,
    /// Parts of samples.
    pub(super) samples: Tensor,
    /// Row's phase `[rows]`.
    pub(super) phase: Vec<i64>,
    /// Row's sample `[rows]`.
    pub(super) sample: Vec<i64>,
}

/// The way back.
#[derive(Debug)]
struct Gate {
    sums: Sums,
    phases: Vec<f32>,
    samples: Vec<f32>,
    gated: Tensor,
}

/// `[rows, width]`.
pub(super) fn gated(sums: Sums, tape: &mut Tape) -> Tensor {
    let width = sums.samples.size()[1] as usize / 2;
    let (phases, samples) = (floats(&sums.phases), floats(&sums.samples));
    let mut gated = vec![0.0; sums.phase.len() * width];
    Isa::best().run(Forward { width, sums: &sums, phases: &phases, samples: &samples, gated: &mut gated });
    let gated = Tensor::from_slice(&gated).view([-1, width as i64]);
    if !tape.records() {
        return gated;
    }
    let gated = leaf(&gated);
    tape.push(Gate { sums, phases, samples, gated: gated.shallow_clone() });
    gated
}

impl Stage for Gate {
    fn backward(&self) -> Result<(), TchError> {
        let mut phases = vec![0.0; self.phases.len()];
        let mut samples = vec![0.0; self.samples.len()];
        Isa::best().run(Backward {
            width: self.gated.size()[1] as usize,
            gate: self,
            arrived: &floats(&gradient(&self.gated)),
            phases: &mut phases,
            samples: &mut samples,
        });
        let parts = [(&self.sums.phases, phases), (&self.sums.samples, samples)];
        pass_on(parts.into_iter().map(|(tensor, gradient)| (tensor, Tensor::from_slice(&gradient))))
    }
}

/// Numbers that are worked on together.
const LANES: usize = 16;

struct Forward<'a> {
    width: usize,
    sums: &'a Sums,
    phases: &'a [f32],
    samples: &'a [f32],
    /// `[rows, width]`.
    gated: &'a mut [f32],
}

impl Work for Forward<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let rows = self.gated.chunks_exact_mut(self.width);
        for ((out, &phase), &sample) in rows.zip(&self.sums.phase).zip(&self.sums.sample) {
            let (p, p_gate) = halves(self.phases, phase, self.width);
            let (s, s_gate) = halves(self.samples, sample, self.width);
            let parts = p.iter().zip(p_gate).zip(s).zip(s_gate);
            for (out, (((p, p_gate), s), s_gate)) in out.iter_mut().zip(parts) {
                *out = (p + s) * sigmoid::<FUSED>(p_gate + s_gate);
            }
        }
    }
}

struct Backward<'a> {
    width: usize,
    gate: &'a Gate,
    /// `[rows, width]`.
    arrived: &'a [f32],
    phases: &'a mut [f32],
    samples: &'a mut [f32],
}

impl Work for Backward<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Gate { sums, phases, samples, .. } = self.gate;
        let rows = self.arrived.chunks_exact(self.width);
        for ((arrived, &phase), &sample) in rows.zip(&sums.phase).zip(&sums.sample) {
            let (p, p_gate) = halves(phases, phase, self.width);
            let (s, s_gate) = halves(samples, sample, self.width);
            let (to_p, to_p_gate) = halves_mut(self.phases, phase, self.width);
            let (to_s, to_s_gate) = halves_mut(self.samples, sample, self.width);
            for start in (0..self.width).step_by(LANES) {
                // Local arrays, and one loop for each result: that is what the compiler makes vector code of.
                let range = start..(start + LANES).min(self.width);
                let (mut of_value, mut of_gate) = ([0.0f32; LANES], [0.0f32; LANES]);
                let values = arrived[range.clone()].iter().zip(&p[range.clone()]).zip(&s[range.clone()]);
                let gates = p_gate[range.clone()].iter().zip(&s_gate[range.clone()]);
                let results = of_value.iter_mut().zip(&mut of_gate);
                for (((of_value, of_gate), ((arrived, p), s)), (p_gate, s_gate)) in
                    results.zip(values).zip(gates)
                {
                    let open = sigmoid::<FUSED>(p_gate + s_gate);
                    *of_value = arrived * open;
                    // a σ'(b) = a σ (1 - σ)
                    *of_gate = *of_value * fma::<FUSED>(p + s, -open, p + s);
                }
                add(&mut to_p[range.clone()], &of_value);
                add(&mut to_s[range.clone()], &of_value);
                add(&mut to_p_gate[range.clone()], &of_gate);
                add(&mut to_s_gate[range], &of_gate);
            }
        }
    }
}

#[inline(always)]
fn add(to: &mut [f32], values: &[f32; LANES]) {
    for (to, value) in to.iter_mut().zip(values) {
        *to += value;
    }
}

/// Value and gate of one row of `[.., 2, width]`.
#[inline(always)]
fn halves(all: &[f32], row: i64, width: usize) -> (&[f32], &[f32]) {
    all[row as usize * 2 * width..][..2 * width].split_at(width)
}

#[inline(always)]
fn halves_mut(all: &mut [f32], row: i64, width: usize) -> (&mut [f32], &mut [f32]) {
    all[row as usize * 2 * width..][..2 * width].split_at_mut(width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Init, Params};
    use crate::placement::Placement;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use tch::{Device, Kind};

    #[test]
    fn results_and_gradients_are_libtorchs() {
        let (phase, sample) = (vec![0, 1, 2, 0, 2], vec![0, 0, 1, 3, 3]);
        for width in [4, 16, 40, 128] {
            let (mut params, mut rng) = (Params::new(), ChaCha8Rng::seed_from_u64(3));
            let mut init = Init::placed("test", &mut params, &mut rng, Placement::CPU);
            let leaves =
                [init.uniform("phases", &[3, 2 * width], 3.0), init.uniform("samples", &[4, 2 * width], 3.0)];
            let parts = || leaves.each_ref().map(|leaf| leaf * 1.0);
            let weight = Tensor::linspace(-1.0, 1.0, 5 * width, (Kind::Float, Device::Cpu)).view([5, width]);

            let [phases, samples] = parts();
            let sum = phases.index_select(0, &Tensor::from_slice(&phase))
                + samples.index_select(0, &Tensor::from_slice(&sample));
            let exact = sum.glu(-1);
            (&exact * &weight).sum(Kind::Float).backward();
            let wanted = leaves.each_ref().map(|leaf| leaf.grad().copy());
            crate::adam::zero_gradients(&params);

            let [phases, samples] = parts();
            let mut tape = Tape::new(&phases);
            let sums = Sums { phases, samples, phase: phase.clone(), sample: sample.clone() };
            let own = gated(sums, &mut tape);
            let close = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]) < 2e-6;
            assert!(close(&own, &exact), "{width}");
            (own * &weight).sum(Kind::Float).backward();
            tape.backward().unwrap();
            for (leaf, wanted) in leaves.iter().zip(&wanted) {
                assert!(close(&leaf.grad(), wanted), "{width}");
            }
        }
    }
}
