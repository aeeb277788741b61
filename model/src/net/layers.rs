//! The few layers that the modules are made of.

use crate::params::Init;
use tch::{Kind, Tensor};

/// `y = x Wᵀ + b`, initialised uniformly in `±gain/√inputs`.
#[derive(Debug)]
pub(super) struct Linear {
    weight: Tensor,
    bias: Tensor,
    product_kind: Option<Kind>,
}

impl Linear {
    pub(super) fn new(init: &mut Init<'_>, inputs: i64, outputs: i64) -> Self {
        Self::with_gain(init, inputs, outputs, 1.0)
    }

    pub(super) fn with_gain(init: &mut Init<'_>, inputs: i64, outputs: i64, gain: f64) -> Self {
        let bound = gain / (inputs as f64).sqrt();
        Self {
            weight: init.uniform("weight", &[outputs, inputs], bound),
            bias: init.uniform("bias", &[outputs], bound),
            product_kind: init.product_kind(),
        }
    }

    /// The layer, multiplying in the kind of its weights whatever the network's placement says.
    pub(super) fn in_full_precision(self) -> Self {
        Self { product_kind: None, ..self }
    }

    /// `[.., inputs]` to `[.., outputs]`.
    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        product(x, &self.weight, Some(&self.bias), self.product_kind)
    }

    /// Two linear layers as one: what `self` makes of the output of `inner`. The weights' product costs next to nothing
    /// beside a pass over a batch, and gradients reach both layers through it.
    pub(super) fn after(&self, inner: &Self) -> Self {
        Self {
            weight: self.weight.matmul(&inner.weight),
            bias: self.weight.mv(&inner.bias) + &self.bias,
            product_kind: self.product_kind.and(inner.product_kind),
        }
    }

    /// A matrix `[outputs, ..]` applied to what the layer gives, as one layer.
    pub(super) fn under(&self, matrix: &Tensor) -> Self {
        let (weight, bias) = (matrix.matmul(&self.weight), matrix.mv(&self.bias));
        Self { weight, bias, product_kind: self.product_kind }
    }

    /// The layer on what a matrix `[inputs, ..]` gives, as one layer.
    pub(super) fn after_product(&self, matrix: &Tensor) -> Self {
        let (weight, bias) = (self.weight.matmul(matrix), self.bias.shallow_clone());
        Self { weight, bias, product_kind: self.product_kind }
    }

    /// Several layers of the same input side by side.
    pub(super) fn beside<'a>(layers: &(impl Iterator<Item = &'a Self> + Clone)) -> Self {
        let parts =
            |part: fn(&Self) -> &Tensor| Tensor::cat(&layers.clone().map(part).collect::<Vec<_>>(), 0);
        let product_kind = layers.clone().next().and_then(|layer| layer.product_kind);
        Self { weight: parts(Self::weight), bias: parts(Self::bias), product_kind }
    }

    /// The first `inputs` columns, as a layer of these alone.
    pub(super) fn first_columns(&self, inputs: i64) -> Self {
        let (weight, bias) = (self.weight.narrow(1, 0, inputs), self.bias.shallow_clone());
        Self { weight, bias, product_kind: self.product_kind }
    }

    /// The first `outputs` rows, as a layer of these alone.
    pub(super) fn first_rows(&self, outputs: i64) -> Self {
        let (weight, bias) = (self.weight.narrow(0, 0, outputs), self.bias.narrow(0, 0, outputs));
        Self { weight, bias, product_kind: self.product_kind }
    }

    /// The layer without its bias.
    pub(super) fn without_bias(&self) -> Projection {
        Projection { weight: self.weight.shallow_clone(), product_kind: self.product_kind }
    }

    /// `[outputs, inputs]`.
    pub(super) fn weight(&self) -> &Tensor {
        &self.weight
    }

    /// `[outputs]`.
    pub(super) fn bias(&self) -> &Tensor {
        &self.bias
    }
}

/// `x Wᵀ + b`, computed in `kind` where one is given; the result has the kind of `x`.
///
/// This is what PyTorch's autocast does to a linear layer; `tch` offers autocast on CUDA alone.
fn product(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>, kind: Option<Kind>) -> Tensor {
    match kind {
        None => x.linear(weight, bias),
        Some(kind) => {
            let bias = bias.map(|bias| bias.to_kind(kind));
            x.to_kind(kind).linear(&weight.to_kind(kind), bias.as_ref()).to_kind(x.kind())
        }
    }
}

/// A linear layer without bias, for sums of several parts that share one bias.
#[derive(Debug)]
pub(super) struct Projection {
    weight: Tensor,
    product_kind: Option<Kind>,
}

impl Projection {
    /// `fan_in` is the width of the whole concatenated input, of which this layer reads `inputs` columns.
    pub(super) fn new(init: &mut Init<'_>, inputs: i64, outputs: i64, fan_in: i64) -> Self {
        let weight = init.uniform("weight", &[outputs, inputs], 1.0 / (fan_in as f64).sqrt());
        Self { weight, product_kind: init.product_kind() }
    }

    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        product(x, &self.weight, None, self.product_kind)
    }

    /// The first `inputs` columns, as a layer of these alone.
    pub(super) fn first_columns(&self, inputs: i64) -> Self {
        Self { weight: self.weight.narrow(1, 0, inputs), product_kind: self.product_kind }
    }

    /// `[outputs, inputs]`.
    pub(super) fn weight(&self) -> &Tensor {
        &self.weight
    }
}

/// Linear, ReLU, linear.
#[derive(Debug)]
pub(super) struct Mlp {
    first: Linear,
    second: Linear,
}

impl Mlp {
    pub(super) fn new(init: &mut Init<'_>, inputs: i64, hidden: i64, outputs: i64) -> Self {
        Self {
            first: Linear::new(&mut init.sub("0"), inputs, hidden),
            second: Linear::new(&mut init.sub("1"), hidden, outputs),
        }
    }

    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        self.second.forward(&self.hidden(x))
    }

    /// What the second layer is given.
    pub(super) fn hidden(&self, x: &Tensor) -> Tensor {
        // In place: no gradient needs the numbers before it.
        self.first.forward(x).relu_()
    }

    pub(super) fn first(&self) -> &Linear {
        &self.first
    }

    pub(super) fn second(&self) -> &Linear {
        &self.second
    }
}

/// Layer normalisation over the last dimension.
#[derive(Debug)]
pub(super) struct LayerNorm {
    width: i64,
    weight: Tensor,
    bias: Tensor,
}

impl LayerNorm {
    pub(super) fn new(init: &mut Init<'_>, width: i64) -> Self {
        Self {
            width,
            weight: init.constant("weight", &[width], 1.0),
            bias: init.constant("bias", &[width], 0.0),
        }
    }

    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        x.layer_norm([self.width], Some(&self.weight), Some(&self.bias), 1e-5, false)
    }
}
