//! The way back through what libtorch's graph does not hold.
//!
//! Some parts of a pass are plain loops ([`vector`](crate::vector)): libtorch would make a dozen operations of each, every one a
//! pass over memory. At such a part its graph ends, and begins anew behind it:
//!
//! ```text
//!  libtorch's graph ─┤inputs├─> loop ─> leaf ─> libtorch's graph ─> ... ─> loss
//! ```
//! libtorch takes the loss's gradient as far as the leaf; the part's [`Stage`] makes the inputs' gradients of it, and hands
//! them to the graph before. Stages are walked from the last to the first. libtorch walks a graph only once, so that what leads
//! to the loss both through a stage and past it has to be cut ([`Tape::cut`]): there both gradients add up and go on as one.

use std::fmt::Debug;
use tch::{Device, Kind, TchError, Tensor};

/// A part of a pass that goes backward by itself.
pub(super) trait Stage: Debug {
    /// Takes the gradients that have arrived at its leaves further back. Once.
    ///
    /// # Errors
    /// libtorch's.
    fn backward(&self) -> Result<(), TchError>;
}

/// How a pass is computed, and its stages, first to last.
#[derive(Debug)]
pub(super) struct Tape {
    /// Whether loops of our own are used: on the CPU. Other devices have libtorch's operations for everything.
    loops: bool,
    /// Whether anybody will go back.
    learns: bool,
    stages: Vec<Box<dyn Stage>>,
}

impl Tape {
    /// For a pass of which `sample`, computed from a parameter, says where it is and whether gradients are wanted.
    pub(super) fn new(sample: &Tensor) -> Self {
        Self { loops: sample.device() == Device::Cpu, learns: sample.requires_grad(), stages: Vec::new() }
    }

    /// The same with libtorch's operations alone, as on other devices.
    pub(super) fn without_loops(sample: &Tensor) -> Self {
        Self { loops: false, ..Self::new(sample) }
    }

    pub(super) fn loops(&self) -> bool {
        self.loops
    }

    /// Whether stages have to be kept.
    pub(super) fn records(&self) -> bool {
        self.loops && self.learns
    }

    pub(super) fn push(&mut self, stage: impl Stage + 'static) {
        self.stages.push(Box::new(stage));
    }

    /// Cuts the graph at some tensors, if stages are kept; gives what to use in their place.
    pub(super) fn cut<const N: usize>(&mut self, tensors: [&Tensor; N]) -> [Tensor; N] {
        if !self.records() {
            return tensors.map(Tensor::shallow_clone);
        }
        let cuts = tensors.map(Cut::new);
        let leaves = std::array::from_fn(|i| cuts[i].leaf.shallow_clone());
        self.push(Cuts(Vec::from(cuts)));
        leaves
    }

    /// From the leaves, where a backward pass has left gradients, to all parameters.
    ///
    /// # Errors
    /// libtorch's.
    pub(super) fn backward(&self) -> Result<(), TchError> {
        self.stages.iter().rev().try_for_each(|stage| stage.backward())
    }
}

/// A place where the graph ends and begins anew.
#[derive(Debug)]
pub(super) struct Cut {
    /// With the graph that led to it.
    pub(super) before: Tensor,
    /// The same numbers, with the graph behind it.
    pub(super) leaf: Tensor,
}

impl Cut {
    pub(super) fn new(tensor: &Tensor) -> Self {
        Self { before: tensor.shallow_clone(), leaf: leaf(&tensor.detach()) }
    }
}

#[derive(Debug)]
struct Cuts(Vec<Cut>);

impl Stage for Cuts {
    fn backward(&self) -> Result<(), TchError> {
        pass_on(self.0.iter().map(|cut| (&cut.before, gradient(&cut.leaf))))
    }
}

/// Where a graph begins.
pub(super) fn leaf(tensor: &Tensor) -> Tensor {
    tensor.set_requires_grad(true)
}

/// What a backward pass left at a leaf; zero where it never came.
pub(super) fn gradient(leaf: &Tensor) -> Tensor {
    let gradient = leaf.grad();
    if gradient.defined() { gradient } else { leaf.detach().zeros_like() }
}

/// Hands gradients to the graphs that led to some tensors, in one backward pass.
///
/// # Errors
/// libtorch's.
pub(super) fn pass_on<'a>(gradients: impl Iterator<Item = (&'a Tensor, Tensor)>) -> Result<(), TchError> {
    // A sum of products with constants has these constants as its gradients.
    let products: Vec<Tensor> = gradients
        .filter(|(tensor, _)| tensor.requires_grad())
        .map(|(tensor, gradient)| tensor.reshape([-1]).dot(&gradient.reshape([-1])))
        .collect();
    if products.is_empty() { Ok(()) } else { Tensor::stack(&products, 0).sum(Kind::Float).f_backward() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_of_both_ways_add_up_at_a_cut() {
        let x = leaf(&Tensor::from_slice(&[1.0f32, 2.0]));
        let mut tape = Tape::new(&(&x * 1.0));
        let shared = &x * 3.0;
        let [shared] = tape.cut([&shared]);
        let doubled = &shared * 2.0;
        let [doubled] = tape.cut([&doubled]);
        (&doubled * &shared).sum(Kind::Float).backward();
        tape.backward().unwrap();
        // 2 (3x)², whose derivative is 36 x.
        assert_eq!(Vec::<f32>::try_from(x.grad()).unwrap(), [36.0, 72.0]);
    }

    #[test]
    fn a_leaf_that_nothing_came_to_passes_zeros_on() {
        let x = leaf(&Tensor::from_slice(&[1.0f32]));
        let mut tape = Tape::new(&(&x * 1.0));
        let [_unused] = tape.cut([&(&x * 3.0)]);
        tape.backward().unwrap();
        assert_eq!(Vec::<f32>::try_from(x.grad()).unwrap(), [0.0]);
    }

    #[test]
    fn nothing_is_recorded_without_gradients() {
        let x = leaf(&Tensor::from_slice(&[1.0f32]));
        assert!(Tape::new(&(&x * 1.0)).records());
        assert!(!tch::no_grad(|| Tape::new(&(&x * 1.0))).records());
        assert!(!Tape::without_loops(&(&x * 1.0)).records());
    }
}
