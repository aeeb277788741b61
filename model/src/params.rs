//! Named parameters, with deterministic initial values that do not depend on libtorch's generator.

use crate::placement::Placement;
use cross_config::Precision;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor};

/// The parameters of one network in the order they were made, by dotted path.
#[derive(Debug)]
pub struct Params {
    entries: Vec<(String, Tensor)>,
}

/// Makes parameters while a network is being built.
pub struct Init<'a> {
    prefix: String,
    params: &'a mut Params,
    rng: &'a mut ChaCha8Rng,
    placement: Placement,
}

impl Params {
    /// No parameters yet.
    #[must_use]
    pub fn new() -> Self {
        Self { entries: Vec::new() }
    }

    /// Names and tensors in order of creation.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.entries.iter().map(|(name, tensor)| (name.as_str(), tensor))
    }

    /// The tensors alone.
    pub fn tensors(&self) -> impl Iterator<Item = &Tensor> {
        self.entries.iter().map(|(_, tensor)| tensor)
    }

    /// Number of parameters (scalars).
    #[must_use]
    pub fn scalars(&self) -> usize {
        self.tensors().map(Tensor::numel).sum()
    }
}

impl Default for Params {
    fn default() -> Self {
        Self::new()
    }
}

impl<'a> Init<'a> {
    /// The root of a network called `name`, in single precision on the CPU.
    pub fn new(name: &str, params: &'a mut Params, rng: &'a mut ChaCha8Rng) -> Self {
        Self::placed(name, params, rng, Placement::CPU)
    }

    /// The root of a network called `name`.
    pub fn placed(name: &str, params: &'a mut Params, rng: &'a mut ChaCha8Rng, placement: Placement) -> Self {
        Self { prefix: name.to_owned(), params, rng, placement }
    }

    /// Where the network is.
    #[must_use]
    pub fn device(&self) -> Device {
        self.placement.device
    }

    /// Kind in which its linear layers multiply, unless it is that of the weights.
    #[must_use]
    pub fn product_kind(&self) -> Option<Kind> {
        match self.placement.precision {
            Precision::F32 => None,
            Precision::Bf16 => Some(Kind::BFloat16),
        }
    }

    /// A module below this one.
    pub fn sub(&mut self, name: &str) -> Init<'_> {
        Init {
            prefix: format!("{}.{name}", self.prefix),
            params: self.params,
            rng: self.rng,
            placement: self.placement,
        }
    }

    /// A parameter uniform in `±bound`.
    pub fn uniform(&mut self, name: &str, shape: &[i64], bound: f64) -> Tensor {
        let count: i64 = shape.iter().product();
        let values: Vec<f32> =
            (0..count).map(|_| (bound * (2.0 * self.rng.random::<f64>() - 1.0)) as f32).collect();
        self.add(name, &Tensor::from_slice(&values).view(shape))
    }

    /// A parameter filled with one value.
    pub fn constant(&mut self, name: &str, shape: &[i64], value: f64) -> Tensor {
        self.add(name, &Tensor::full(shape, value, (Kind::Float, Device::Cpu)))
    }

    /// Drawn on the CPU and moved before it becomes a leaf, so that a seed gives the same weights everywhere.
    fn add(&mut self, name: &str, tensor: &Tensor) -> Tensor {
        let tensor = tensor.to_device(self.placement.device).set_requires_grad(true);
        self.params.entries.push((format!("{}.{name}", self.prefix), tensor.shallow_clone()));
        tensor
    }
}
