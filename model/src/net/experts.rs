//! Scores of the chosen experts where a row is the sum of a phase's part and a sample's (the form `paper`).
//!
//! The first layers of all experts on phases and on samples are two products of matrices. What is left for a row and each of
//! its experts is `score = v · relu(phase + sample) + c`, with v and c the expert's second layer and the head as one: 128
//! numbers that go into one. libtorch would write them all to memory, `[rows, k, 128]`, four times forward and six times
//! backward; here they stay in registers and are computed again on the way back.

use super::tape::{Stage, Tape, gradient, leaf, pass_on};
use crate::policy::floats;
use crate::vector::math::fma;
use crate::vector::{Isa, Work};
use tch::{TchError, Tensor};

/// What the scores are made of.
#[derive(Debug)]
pub(super) struct Parts {
    /// First layers on phases `[static phases, experts * width]`.
    pub(super) phases: Tensor,
    /// First layers on samples `[samples, experts * width]`.
    pub(super) samples: Tensor,
    /// `[experts, width]`.
    pub(super) v: Tensor,
    /// `[experts]`.
    pub(super) c: Tensor,
}

/// Who is scored by whom.
#[derive(Debug)]
pub(super) struct Table {
    /// Experts of each row.
    pub(super) k: usize,
    /// `[rows, k]`.
    pub(super) expert: Vec<i64>,
    /// `[rows]`.
    pub(super) phase: Vec<i64>,
    /// `[rows]`.
    pub(super) sample: Vec<i64>,
}

/// The parts as plain numbers.
#[derive(Debug)]
struct Numbers {
    experts: usize,
    width: usize,
    phases: Vec<f32>,
    samples: Vec<f32>,
    v: Vec<f32>,
    c: Vec<f32>,
}

/// The way back.
#[derive(Debug)]
struct Experts {
    parts: Parts,
    table: Table,
    numbers: Numbers,
    scores: Tensor,
}

/// Scores `[rows, k]`.
pub(super) fn scores(parts: Parts, table: Table, tape: &mut Tape) -> Tensor {
    let size = parts.v.size();
    let numbers = Numbers {
        experts: size[0] as usize,
        width: size[1] as usize,
        phases: floats(&parts.phases),
        samples: floats(&parts.samples),
        v: floats(&parts.v),
        c: floats(&parts.c),
    };
    let mut scores = vec![0.0; table.expert.len()];
    Isa::best().run(Score { numbers: &numbers, table: &table, out: &mut scores });
    let scores = Tensor::from_slice(&scores).view([-1, table.k as i64]);
    if !tape.records() {
        return scores;
    }
    let scores = leaf(&scores);
    tape.push(Experts { parts, table, numbers, scores: scores.shallow_clone() });
    scores
}

impl Stage for Experts {
    fn backward(&self) -> Result<(), TchError> {
        let numbers = &self.numbers;
        let zeros = |like: &[f32]| vec![0.0; like.len()];
        let (mut phases, mut samples) = (zeros(&numbers.phases), zeros(&numbers.samples));
        let (mut v, mut c) = (zeros(&numbers.v), zeros(&numbers.c));
        Isa::best().run(Back {
            numbers,
            table: &self.table,
            arrived: &floats(&gradient(&self.scores)),
            phases: &mut phases,
            samples: &mut samples,
            v: &mut v,
            c: &mut c,
        });
        let parts = [
            (&self.parts.phases, phases),
            (&self.parts.samples, samples),
            (&self.parts.v, v),
            (&self.parts.c, c),
        ];
        pass_on(parts.into_iter().map(|(tensor, gradient)| (tensor, Tensor::from_slice(&gradient))))
    }
}

/// Numbers that are worked on together: two registers of the widest kind.
const LANES: usize = 32;

struct Score<'a> {
    numbers: &'a Numbers,
    table: &'a Table,
    out: &'a mut [f32],
}

impl Work for Score<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Numbers { width, phases, samples, v, c, .. } = self.numbers;
        for (entry, out) in self.out.iter_mut().enumerate() {
            let (phase, sample, expert) = self.numbers.places(self.table, entry);
            let rows =
                (&phases[phase..][..*width], &samples[sample..][..*width], &v[expert * width..][..*width]);
            let ((p, p_rest), (s, s_rest), (v, v_rest)) =
                (rows.0.as_chunks::<LANES>(), rows.1.as_chunks::<LANES>(), rows.2.as_chunks::<LANES>());
            let mut sums = [0.0f32; LANES];
            for ((p, s), v) in p.iter().zip(s).zip(v) {
                for i in 0..LANES {
                    sums[i] = fma::<FUSED>(relu(p[i] + s[i]), v[i], sums[i]);
                }
            }
            let mut sum = c[expert];
            for ((p, s), v) in p_rest.iter().zip(s_rest).zip(v_rest) {
                sum = fma::<FUSED>(relu(p + s), *v, sum);
            }
            *out = sum + sums.iter().sum::<f32>();
        }
    }
}

struct Back<'a> {
    numbers: &'a Numbers,
    table: &'a Table,
    /// `[rows, k]`.
    arrived: &'a [f32],
    phases: &'a mut [f32],
    samples: &'a mut [f32],
    v: &'a mut [f32],
    c: &'a mut [f32],
}

impl Work for Back<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Numbers { width, phases, samples, v, .. } = self.numbers;
        for (entry, &arrived) in self.arrived.iter().enumerate() {
            let (phase, sample, expert) = self.numbers.places(self.table, entry);
            self.c[expert] += arrived;
            let (phase, sample, expert) =
                (phase..phase + width, sample..sample + width, expert * width..(expert + 1) * width);
            let of = (
                &mut self.phases[phase.clone()],
                &mut self.samples[sample.clone()],
                &mut self.v[expert.clone()],
            );
            let ((to_p, to_p_rest), (to_s, to_s_rest), (to_v, to_v_rest)) =
                (of.0.as_chunks_mut::<LANES>(), of.1.as_chunks_mut::<LANES>(), of.2.as_chunks_mut::<LANES>());
            let ((p, p_rest), (s, s_rest), (v, v_rest)) = (
                phases[phase].as_chunks::<LANES>(),
                samples[sample].as_chunks::<LANES>(),
                v[expert].as_chunks::<LANES>(),
            );
            let chunks = p.iter().zip(s).zip(v).zip(to_p).zip(to_s).zip(to_v);
            for (((((p, s), v), to_p), to_s), to_v) in chunks {
                // Local arrays, and one loop for each result: that is what the compiler makes vector code of.
                let (mut hidden, mut passed) = ([0.0f32; LANES], [0.0f32; LANES]);
                for i in 0..LANES {
                    hidden[i] = relu(p[i] + s[i]);
                    passed[i] = relu_back(hidden[i], arrived * v[i]);
                }
                for i in 0..LANES {
                    to_p[i] += passed[i];
                }
                for i in 0..LANES {
                    to_s[i] += passed[i];
                }
                for i in 0..LANES {
                    to_v[i] = fma::<FUSED>(arrived, hidden[i], to_v[i]);
                }
            }
            for (i, ((p, s), v)) in p_rest.iter().zip(s_rest).zip(v_rest).enumerate() {
                let hidden = relu(p + s);
                let passed = relu_back(hidden, arrived * v);
                to_p_rest[i] += passed;
                to_s_rest[i] += passed;
                to_v_rest[i] += arrived * hidden;
            }
        }
    }
}

impl Numbers {
    /// Where an entry of the table has its phase's and its sample's part, and its expert.
    #[inline(always)]
    fn places(&self, table: &Table, entry: usize) -> (usize, usize, usize) {
        let (row, expert) = (entry / table.k, table.expert[entry] as usize);
        let place = |of: &[i64]| (of[row] as usize * self.experts + expert) * self.width;
        (place(&table.phase), place(&table.sample), expert)
    }
}

#[inline(always)]
fn relu(x: f32) -> f32 {
    // What is no number stays none, so that the loss tells of it.
    if x < 0.0 { 0.0 } else { x }
}

/// The gradient of [`relu`] at its result.
#[inline(always)]
fn relu_back(result: f32, arrived: f32) -> f32 {
    if result <= 0.0 { 0.0 } else { arrived }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Init, Params};
    use crate::placement::Placement;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use tch::{Device, Kind};

    /// The same by libtorch's operations.
    fn plain(parts: &Parts, table: &Table) -> Tensor {
        let (experts, width) = (parts.v.size()[0], parts.v.size()[1]);
        let (k, rows) = (table.k as i64, table.phase.len() as i64);
        let expert = Tensor::from_slice(&table.expert);
        let of = |all: &Tensor, place: &[i64]| {
            let place = Tensor::from_slice(place).unsqueeze(1).expand([-1, k], false).reshape([-1]);
            all.view([-1, width]).index_select(0, &(place * experts + &expert))
        };
        let hidden = (of(&parts.phases, &table.phase) + of(&parts.samples, &table.sample)).relu();
        let sums = (hidden * parts.v.index_select(0, &expert)).sum_dim_intlist(-1, false, Kind::Float);
        (sums + parts.c.index_select(0, &expert)).view([rows, k])
    }

    fn case(width: i64) -> (Parts, Table, [Tensor; 4]) {
        let (experts, phases, samples) = (4, 3, 5);
        let (mut params, mut rng) = (Params::new(), ChaCha8Rng::seed_from_u64(3));
        let mut init = Init::placed("test", &mut params, &mut rng, Placement::CPU);
        let mut random = |shape: &[i64]| init.uniform("leaf", shape, 1.5);
        let leaves = [
            random(&[phases, experts * width]),
            random(&[samples, experts * width]),
            random(&[experts, width]),
            random(&[experts]),
        ];
        let [phases, samples, v, c] = leaves.each_ref().map(|leaf| leaf * 1.0);
        // The last expert is chosen by nobody, as happens.
        let table = Table {
            k: 2,
            expert: vec![0, 1, 2, 0, 1, 2, 1, 0, 0, 2, 2, 1],
            phase: vec![0, 1, 2, 0, 1, 2],
            sample: vec![0, 0, 1, 2, 4, 4],
        };
        (Parts { phases, samples, v, c }, table, leaves)
    }

    #[test]
    fn scores_and_gradients_are_libtorchs() {
        for width in [8, 32, 128, 40] {
            let (parts, table, leaves) = case(width);
            let weight = Tensor::linspace(-1.0, 1.0, 12, (Kind::Float, Device::Cpu)).view([6, 2]);
            let exact = plain(&parts, &table);
            (&exact * &weight).sum(Kind::Float).backward();
            let wanted = leaves.each_ref().map(|leaf| leaf.grad().copy());
            for leaf in &leaves {
                let _ = leaf.grad().zero_();
            }

            let parts = again(&leaves);
            let mut tape = Tape::new(&parts.v);
            let own = scores(parts, table, &mut tape);
            let close = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]) < 1e-5;
            assert!(close(&own, &exact), "{width}");
            (own * &weight).sum(Kind::Float).backward();
            tape.backward().unwrap();
            for (leaf, wanted) in leaves.iter().zip(&wanted) {
                assert!(close(&leaf.grad(), wanted), "{width}");
            }
        }
    }

    fn again(leaves: &[Tensor; 4]) -> Parts {
        let [phases, samples, v, c] = leaves.each_ref().map(|leaf| leaf * 1.0);
        Parts { phases, samples, v, c }
    }

    #[test]
    fn what_is_no_number_stays_none() {
        let (parts, table, _) = case(32);
        let broken = Parts { phases: parts.phases * f64::NAN, ..parts };
        let own = scores(broken, table, &mut Tape::without_loops(&Tensor::from(0.0)));
        assert!(floats(&own).iter().all(|score| score.is_nan()));
    }
}
