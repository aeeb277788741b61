//! One layer of gated recurrent units (PyTorch's equations and gate order: reset, update, new), with a way back of its own.
//!
//! A step of a minibatch is one product of some 48 by 128 by 384 numbers and a few functions of the result. libtorch makes 13
//! operations of it, and twice as many going backward, where it also adds up the weights' gradients step by step: a fifth of
//! an update went there. On the CPU the steps are plain loops ([`vector`](crate::vector)), and what does not depend on the
//! step before (the input's part, the weights' gradients) is one product over all steps. Other devices keep libtorch's layer.

use super::tape::{Cut, Stage, Tape, gradient, leaf, pass_on};
use crate::params::Init;
use crate::policy::floats;
use crate::vector::math::{sigmoid, tanh};
use crate::vector::{Dense, Isa, Matrix, Work};
use tch::{Kind, TchError, Tensor};

/// The layer's weights.
#[derive(Debug)]
pub(super) struct Gru {
    width: i64,
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias_ih: Tensor,
    bias_hh: Tensor,
}

impl Gru {
    pub(super) fn new(init: &mut Init<'_>, width: i64) -> Self {
        let bound = 1.0 / (width as f64).sqrt();
        Self {
            width,
            weight_ih: init.uniform("weight_ih", &[3 * width, width], bound),
            weight_hh: init.uniform("weight_hh", &[3 * width, width], bound),
            bias_ih: init.uniform("bias_ih", &[3 * width], bound),
            bias_hh: init.uniform("bias_hh", &[3 * width], bound),
        }
    }

    /// From the input `x` `[sequences, steps, width]` and the state before `[sequences, width]`, the state after every step
    /// `[sequences, steps, width]`, and the input for other uses: the graph may be cut at it.
    pub(super) fn forward(&self, x: &Tensor, start: &Tensor, tape: &mut Tape) -> (Tensor, Tensor) {
        if !tape.loops() {
            let weights = [&self.weight_ih, &self.weight_hh, &self.bias_ih, &self.bias_hh];
            // In training mode: without dropout it changes no number, and cuDNN goes backward in no other.
            let states = x.gru(&start.unsqueeze(0), &weights, true, 1, 0.0, true, false, true).0;
            return (x.shallow_clone(), states);
        }
        let (states, trace) = tch::no_grad(|| self.unroll(x, start, tape.records()));
        let Some(trace) = trace else { return (x.shallow_clone(), states) };
        let (input, states) = (Cut::new(x), leaf(&states));
        let after = (input.leaf.shallow_clone(), states.shallow_clone());
        tape.push(Steps { gru: self.shallow_clone(), input, start: start.shallow_clone(), states, trace });
        after
    }

    fn shallow_clone(&self) -> Self {
        Self {
            width: self.width,
            weight_ih: self.weight_ih.shallow_clone(),
            weight_hh: self.weight_hh.shallow_clone(),
            bias_ih: self.bias_ih.shallow_clone(),
            bias_hh: self.bias_hh.shallow_clone(),
        }
    }

    /// The states, and what the gates were if somebody is to go back.
    fn unroll(&self, x: &Tensor, start: &Tensor, keep: bool) -> (Tensor, Option<Trace>) {
        let size = x.size();
        let shape = Shape { steps: size[1] as usize, width: self.width as usize };
        let from_input = floats(&x.linear(&self.weight_ih, Some(&self.bias_ih)));
        let isa = Isa::best();
        let recurrence = Dense::new(isa, &matrix(&self.weight_hh), Some(&floats(&self.bias_hh)));
        let mut state = floats(start);
        let entries = x.numel();
        let mut states = vec![0.0; entries];
        let mut gates = vec![0.0; if keep { GATES * entries } else { 0 }];
        let mut from_state = Vec::new();
        for step in 0..shape.steps {
            recurrence.forward(&state, &mut from_state);
            isa.run(Step {
                shape,
                step,
                from_input: &from_input,
                from_state: &from_state,
                state: &mut state,
                states: &mut states,
                gates: &mut gates,
            });
        }
        (Tensor::from_slice(&states).view(size.as_slice()), keep.then_some(Trace { shape, gates, states }))
    }
}

/// A parameter as plain numbers.
fn matrix(weight: &Tensor) -> Matrix {
    let size = weight.size();
    Matrix::new(size[0] as usize, size[1] as usize, floats(weight))
}

/// Numbers kept for each entry of the state: reset, update, new, and what the reset gate multiplies.
const GATES: usize = 4;

#[derive(Debug, Clone, Copy)]
struct Shape {
    steps: usize,
    width: usize,
}

/// What the way back needs to know of the way there.
#[derive(Debug)]
struct Trace {
    shape: Shape,
    /// `[sequences, steps, 4, width]`.
    gates: Vec<f32>,
    /// `[sequences, steps, width]`.
    states: Vec<f32>,
}

/// One step of all sequences.
struct Step<'a> {
    shape: Shape,
    step: usize,
    /// `[sequences, steps, 3, width]`.
    from_input: &'a [f32],
    /// `[sequences, 3, width]`.
    from_state: &'a [f32],
    /// Before and after the step `[sequences, width]`.
    state: &'a mut [f32],
    /// `[sequences, steps, width]`.
    states: &'a mut [f32],
    /// As in [`Trace`], or empty.
    gates: &'a mut [f32],
}

impl Work for Step<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Shape { steps, width } = self.shape;
        let rows = self.state.chunks_exact_mut(width).zip(self.from_state.chunks_exact(3 * width));
        for (sequence, (state, h)) in rows.enumerate() {
            let row = sequence * steps + self.step;
            let [x_r, x_z, x_n] = parts(&self.from_input[row * 3 * width..], width);
            let [h_r, h_z, h_n] = parts(h, width);
            let state = &mut state[..width];
            let after = &mut self.states[row * width..][..width];
            if self.gates.is_empty() {
                for i in 0..width {
                    let reset = sigmoid::<FUSED>(x_r[i] + h_r[i]);
                    let update = sigmoid::<FUSED>(x_z[i] + h_z[i]);
                    let new = tanh::<FUSED>(x_n[i] + reset * h_n[i]);
                    after[i] = new + update * (state[i] - new);
                }
            } else {
                let [r, z, n, h] = parts_mut(&mut self.gates[row * GATES * width..], width);
                // One loop for each result: what writes to several slices is not made vector code.
                gate::<FUSED>(r, x_r, h_r);
                gate::<FUSED>(z, x_z, h_z);
                h.copy_from_slice(h_n);
                for i in 0..width {
                    n[i] = tanh::<FUSED>(x_n[i] + r[i] * h_n[i]);
                }
                for i in 0..width {
                    after[i] = n[i] + z[i] * (state[i] - n[i]);
                }
            }
            state.copy_from_slice(after);
        }
    }
}

#[inline(always)]
fn gate<const FUSED: bool>(gate: &mut [f32], from_input: &[f32], from_state: &[f32]) {
    for ((gate, x), h) in gate.iter_mut().zip(from_input).zip(from_state) {
        *gate = sigmoid::<FUSED>(x + h);
    }
}

/// The way back of one pass.
#[derive(Debug)]
struct Steps {
    gru: Gru,
    input: Cut,
    start: Tensor,
    states: Tensor,
    trace: Trace,
}

impl Stage for Steps {
    fn backward(&self) -> Result<(), TchError> {
        let Self { gru, input, start, states, .. } = self;
        let width = gru.width;
        let (of_input, of_state) = self.through_gates();
        let flat = |tensor: &Tensor| tensor.reshape([-1, width]);
        let gates = |values: &[f32]| Tensor::from_slice(values).view([-1, 3 * width]);
        let (of_input, of_state) = (gates(&of_input), gates(&of_state));
        let earlier = states.detach().narrow(1, 0, states.size()[1] - 1);
        let before = Tensor::cat(&[start.unsqueeze(1), earlier], 1);
        let of_x = flat(&gradient(&input.leaf)).addmm(&of_input, &gru.weight_ih.detach());
        let over_rows = |of: &Tensor, what: &Tensor| of.transpose(0, 1).matmul(&flat(what));
        let bias = |of: &Tensor| of.sum_dim_intlist(0, false, Kind::Float);
        let gradients = [
            (&input.before, of_x),
            (&gru.weight_ih, over_rows(&of_input, &input.leaf.detach())),
            (&gru.weight_hh, over_rows(&of_state, &before)),
            (&gru.bias_ih, bias(&of_input)),
            (&gru.bias_hh, bias(&of_state)),
        ];
        pass_on(gradients.into_iter())
    }
}

impl Steps {
    /// Gradients of the gates' two parts, of the input and of the state before `[sequences, steps, 3, width]`.
    fn through_gates(&self) -> (Vec<f32>, Vec<f32>) {
        let Trace { shape, gates, states } = &self.trace;
        let arrived = floats(&gradient(&self.states));
        let start = floats(&self.start);
        let isa = Isa::best();
        let recurrence = Dense::new(isa, &matrix(&self.gru.weight_hh).transposed(), None);
        let mut of_input = vec![0.0; 3 * arrived.len()];
        let mut of_state = vec![0.0; 3 * arrived.len()];
        // Of the state before the step: what passes by the gates, and what comes through them.
        let (mut past, mut through) = (vec![0.0; start.len()], vec![0.0; start.len()]);
        let mut of_step = vec![0.0; 3 * start.len()];
        for step in (0..shape.steps).rev() {
            isa.run(StepBack {
                shape: *shape,
                step,
                gates,
                states,
                start: &start,
                arrived: &arrived,
                through: &through,
                past: &mut past,
                of_step: &mut of_step,
                of_input: &mut of_input,
                of_state: &mut of_state,
            });
            recurrence.forward(&of_step, &mut through);
        }
        (of_input, of_state)
    }
}

/// One step of all sequences, backward.
struct StepBack<'a> {
    shape: Shape,
    step: usize,
    /// As in [`Trace`].
    gates: &'a [f32],
    states: &'a [f32],
    /// `[sequences, width]`.
    start: &'a [f32],
    /// From what uses the states `[sequences, steps, width]`.
    arrived: &'a [f32],
    /// From the step after, through its gates `[sequences, width]`.
    through: &'a [f32],
    /// From the step after, past its gates; then from this one to the step before `[sequences, width]`.
    past: &'a mut [f32],
    /// Of the state's part of this step's gates `[sequences, 3, width]`.
    of_step: &'a mut [f32],
    /// `[sequences, steps, 3, width]`.
    of_input: &'a mut [f32],
    of_state: &'a mut [f32],
}

impl Work for StepBack<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Shape { steps, width } = self.shape;
        let rows = self.past.chunks_exact_mut(width).zip(self.through.chunks_exact(width));
        let rows = rows.zip(self.of_step.chunks_exact_mut(3 * width));
        for (sequence, ((past, through), of_step)) in rows.enumerate() {
            let row = sequence * steps + self.step;
            let [r, z, n, h] = parts(&self.gates[row * GATES * width..], width);
            let (past, through) = (&mut past[..width], &through[..width]);
            let before = match self.step {
                0 => &self.start[sequence * width..][..width],
                _ => &self.states[(row - 1) * width..][..width],
            };
            let arrived = &self.arrived[row * width..][..width];
            let of_input = &mut self.of_input[row * 3 * width..][..3 * width];
            let [to_r, to_z, to_n] = parts_mut(of_input, width);
            let [_, _, to_h] = parts_mut(of_step, width);
            for i in 0..width {
                let own = arrived[i] + past[i] + through[i];
                let new = own * (1.0 - z[i]) * (1.0 - n[i] * n[i]);
                to_n[i] = new;
                to_h[i] = new * r[i];
                to_r[i] = new * h[i] * r[i] * (1.0 - r[i]);
                to_z[i] = own * (before[i] - n[i]) * z[i] * (1.0 - z[i]);
                past[i] = own * z[i];
            }
            of_step[..2 * width].copy_from_slice(&of_input[..2 * width]);
            self.of_state[row * 3 * width..][..3 * width].copy_from_slice(of_step);
        }
    }
}

/// The first parts of a row, each of one width: lengths that the compiler knows to be equal, so that it checks no index.
#[inline(always)]
fn parts<const N: usize>(row: &[f32], width: usize) -> [&[f32]; N] {
    std::array::from_fn(|part| &row[part * width..][..width])
}

#[inline(always)]
fn parts_mut<const N: usize>(row: &mut [f32], width: usize) -> [&mut [f32]; N] {
    let mut rest = row;
    std::array::from_fn(|_| {
        let (part, others) = std::mem::take(&mut rest).split_at_mut(width);
        rest = others;
        &mut part[..width]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Params;
    use crate::placement::Placement;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    struct Case {
        params: Params,
        gru: Gru,
        x: Tensor,
        start: Tensor,
    }

    fn case(sequences: i64, steps: i64, width: i64) -> Case {
        let mut params = Params::new();
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut init = Init::placed("test", &mut params, &mut rng, Placement::CPU);
        let gru = Gru::new(&mut init, width);
        let x = init.uniform("x", &[sequences, steps, width], 2.0);
        let start = init.uniform("start", &[sequences, width], 1.0).detach();
        Case { params, gru, x, start }
    }

    fn gradients(case: &Case) -> Vec<Tensor> {
        let named = case.params.iter().filter(|(name, _)| *name != "test.start");
        named.map(|(_, tensor)| tensor.grad().copy()).collect()
    }

    /// Largest difference, of the largest number.
    fn off(own: &Tensor, exact: &Tensor) -> f64 {
        (own - exact).abs().max().double_value(&[]) / exact.abs().max().double_value(&[])
    }

    fn libtorchs(gru: &Gru, x: &Tensor, start: &Tensor) -> Tensor {
        gru.forward(x, start, &mut Tape::without_loops(x)).1
    }

    #[test]
    fn states_and_gradients_are_libtorchs() {
        for (sequences, steps, width) in [(1, 1, 4), (3, 5, 8), (5, 1, 33), (7, 6, 128)] {
            let case = case(sequences, steps, width);
            let x = &case.x * 1.0;
            let exact = libtorchs(&case.gru, &x, &case.start);
            // States and input used both alone and together, as features do.
            let loss = |x: &Tensor, states: &Tensor| ((x + states).tanh() * states).sum(Kind::Float);
            loss(&x, &exact).backward();
            let wanted = gradients(&case);
            crate::adam::zero_gradients(&case.params);

            let x = &case.x * 1.0;
            let mut tape = Tape::new(&x);
            let (input, states) = case.gru.forward(&x, &case.start, &mut tape);
            assert!(off(&states, &exact) < 1e-5, "{sequences} {steps} {width}");
            loss(&input, &states).backward();
            tape.backward().unwrap();
            for (own, wanted) in gradients(&case).iter().zip(&wanted) {
                assert!(off(own, wanted) < 1e-5, "{sequences} {steps} {width}: {}", off(own, wanted));
            }
        }
    }

    #[test]
    fn without_gradients_the_states_are_the_same() {
        let case = case(4, 3, 16);
        let x = &case.x * 1.0;
        let (_, learning) = case.gru.forward(&x, &case.start, &mut Tape::new(&x));
        let x = case.x.detach();
        let (_, acting) = case.gru.forward(&x, &case.start, &mut Tape::new(&x));
        assert!(learning.requires_grad() && !acting.requires_grad());
        assert_eq!(floats(&acting), floats(&learning));
    }
}
