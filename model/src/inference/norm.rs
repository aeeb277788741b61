//! Layer normalisation.

use super::weights::Weights;
use crate::error::ModelError;
use crate::vector::math::{dot, fma, sum};
use crate::vector::{Isa, Work};

/// Layer normalisation.
#[derive(Debug)]
pub(super) struct Norm {
    isa: Isa,
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Norm {
    pub(super) fn new(isa: Isa, weights: &Weights<'_>) -> Result<Self, ModelError> {
        Ok(Self { isa, weight: weights.vector("weight")?, bias: weights.vector("bias")? })
    }

    /// `x` `[rows, width]` to `out` of the same shape.
    pub(super) fn forward(&self, x: &[f32], out: &mut Vec<f32>) {
        out.resize(x.len(), 0.0);
        self.isa.run(Normalise { norm: self, x, out });
    }
}

struct Normalise<'a> {
    norm: &'a Norm,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl Work for Normalise<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Norm { weight, bias, .. } = self.norm;
        let width = weight.len();
        for (x, out) in self.x.chunks_exact(width).zip(self.out.chunks_exact_mut(width)) {
            let mean = sum(x) / width as f32;
            for (out, x) in out.iter_mut().zip(x) {
                *out = x - mean;
            }
            let scale = 1.0 / (dot::<FUSED>(out, out) / width as f32 + 1e-5).sqrt();
            for ((out, weight), bias) in out.iter_mut().zip(weight).zip(bias) {
                *out = fma::<FUSED>(*out * scale, *weight, *bias);
            }
        }
    }
}
