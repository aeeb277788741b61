//! Linear layers with their weights laid out as the processor reads them.

use super::isa::{Isa, Work};
use super::math::fma;
use super::matrix::Matrix;

/// Rows of the input that are computed together; with an [`Isa::width`] of outputs each they fill the registers.
const ROWS: usize = 4;

/// `y = x Wᵀ + b`.
#[derive(Debug)]
pub(crate) struct Dense {
    isa: Isa,
    inputs: usize,
    outputs: usize,
    /// `[panels, inputs, width]`: the weights of `width` outputs side by side, zero beyond the last.
    panels: Vec<f32>,
    /// `[panels, width]`.
    bias: Vec<f32>,
}

impl Dense {
    /// From `weight` `[outputs, inputs]` and `bias` `[outputs]`; no bias is zero.
    pub(crate) fn new(isa: Isa, weight: &Matrix, bias: Option<&[f32]>) -> Self {
        let (outputs, inputs, width) = (weight.rows, weight.columns, isa.width());
        let count = outputs.div_ceil(width);
        let mut panels = vec![0.0; count * inputs * width];
        for output in 0..outputs {
            let panel = &mut panels[output / width * inputs * width..];
            for (input, &value) in weight.row(output).iter().enumerate() {
                panel[input * width + output % width] = value;
            }
        }
        let mut padded = bias.map_or_else(Vec::new, <[f32]>::to_vec);
        padded.resize(count * width, 0.0);
        Self { isa, inputs, outputs, panels, bias: padded }
    }

    /// Number of outputs.
    pub(crate) fn outputs(&self) -> usize {
        self.outputs
    }

    /// `x` `[rows, inputs]` to `out` `[rows, outputs]`, whose length is adapted.
    pub(crate) fn forward(&self, x: &[f32], out: &mut Vec<f32>) {
        self.apply::<false>(x, out);
    }

    /// As [`forward`](Self::forward), negative results set to zero.
    pub(crate) fn forward_relu(&self, x: &[f32], out: &mut Vec<f32>) {
        self.apply::<true>(x, out);
    }

    fn apply<const RELU: bool>(&self, x: &[f32], out: &mut Vec<f32>) {
        out.resize(x.len() / self.inputs * self.outputs, 0.0);
        self.isa.run(Product::<RELU> { layer: self, x, out });
    }
}

/// Linear, ReLU, linear.
#[derive(Debug)]
pub(crate) struct Mlp {
    pub(crate) first: Dense,
    pub(crate) second: Dense,
}

impl Mlp {
    pub(crate) fn forward(&self, x: &[f32], hidden: &mut Vec<f32>, out: &mut Vec<f32>) {
        self.first.forward_relu(x, hidden);
        self.second.forward(hidden, out);
    }
}

struct Product<'a, const RELU: bool> {
    layer: &'a Dense,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl<const RELU: bool> Work for Product<'_, RELU> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let (inputs, outputs) = (self.layer.inputs, self.layer.outputs);
        let panels = self.layer.panels.chunks_exact(inputs * WIDTH);
        for (p, (panel, bias)) in panels.zip(self.layer.bias.as_chunks::<WIDTH>().0).enumerate() {
            let panel = panel.as_chunks::<WIDTH>().0;
            let columns = p * WIDTH..outputs.min((p + 1) * WIDTH);
            for (x, out) in self.x.chunks(ROWS * inputs).zip(self.out.chunks_mut(ROWS * outputs)) {
                // The last block may have fewer rows; it repeats its first one, and drops the repetitions.
                let row = |r: usize| {
                    if (r + 1) * inputs <= x.len() { &x[r * inputs..][..inputs] } else { &x[..inputs] }
                };
                let sums = tile::<WIDTH, FUSED>([row(0), row(1), row(2), row(3)], panel, bias);
                for (out, sums) in out.chunks_exact_mut(outputs).zip(&sums) {
                    for (out, &sum) in out[columns.clone()].iter_mut().zip(sums) {
                        *out = if RELU && sum < 0.0 { 0.0 } else { sum };
                    }
                }
            }
        }
    }
}

/// Products of four rows with one panel. The sums of a row do not depend on the other rows.
#[inline(always)]
fn tile<const WIDTH: usize, const FUSED: bool>(
    rows: [&[f32]; ROWS],
    panel: &[[f32; WIDTH]],
    bias: &[f32; WIDTH],
) -> [[f32; WIDTH]; ROWS] {
    // Four variables, not an array: that is what the compiler keeps in vector registers.
    let (mut sums0, mut sums1, mut sums2, mut sums3) = (*bias, *bias, *bias, *bias);
    let rows = panel.iter().zip(rows[0]).zip(rows[1]).zip(rows[2]).zip(rows[3]);
    for ((((weights, &x0), &x1), &x2), &x3) in rows {
        add_scaled::<WIDTH, FUSED>(&mut sums0, x0, weights);
        add_scaled::<WIDTH, FUSED>(&mut sums1, x1, weights);
        add_scaled::<WIDTH, FUSED>(&mut sums2, x2, weights);
        add_scaled::<WIDTH, FUSED>(&mut sums3, x3, weights);
    }
    [sums0, sums1, sums2, sums3]
}

#[inline(always)]
fn add_scaled<const WIDTH: usize, const FUSED: bool>(
    sums: &mut [f32; WIDTH],
    x: f32,
    weights: &[f32; WIDTH],
) {
    for i in 0..WIDTH {
        sums[i] = fma::<FUSED>(x, weights[i], sums[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Small whole numbers, so that every order of summation gives the same.
        #[test]
        fn every_instruction_set_gives_the_definition(rows in 0usize..10, inputs in 1usize..20, outputs in 1usize..70) {
            let number = |i: usize| (i * 7 % 11) as f32 - 5.0;
            let weight = Matrix::new(outputs, inputs, (0..outputs * inputs).map(number).collect());
            let bias: Vec<f32> = (0..outputs).map(|i| number(i + 3)).collect();
            let x: Vec<f32> = (0..rows * inputs).map(|i| number(i + 5)).collect();
            let exact: Vec<f32> = x
                .chunks(inputs)
                .flat_map(|x| {
                    (0..outputs)
                        .map(|o| bias[o] + x.iter().zip(weight.row(o)).map(|(x, w)| x * w).sum::<f32>())
                        .collect::<Vec<_>>()
                })
                .collect();
            for isa in Isa::available() {
                let layer = Dense::new(isa, &weight, Some(&bias));
                let mut out = vec![9.0; 3];
                layer.forward(&x, &mut out);
                prop_assert_eq!(&out, &exact, "{:?}", isa);
                layer.forward_relu(&x, &mut out);
                let positive: Vec<f32> = exact.iter().map(|v| v.max(0.0)).collect();
                prop_assert_eq!(&out, &positive, "{:?}", isa);
            }
        }
    }
}
