//! A network's weights as plain numbers.

use crate::error::ModelError;
use crate::params::Params;
use crate::policy::floats;
use crate::vector::Matrix;
use std::collections::HashMap;
use tch::Tensor;

/// A network's parameters below a name.
#[derive(Debug, Clone)]
pub(super) struct Weights<'a> {
    tensors: &'a HashMap<String, Tensor>,
    prefix: String,
}

/// All parameters by their full names.
pub(super) fn by_name(params: &Params) -> HashMap<String, Tensor> {
    params.iter().map(|(name, tensor)| (name.to_owned(), tensor.detach())).collect()
}

impl<'a> Weights<'a> {
    pub(super) fn new(tensors: &'a HashMap<String, Tensor>, prefix: &str) -> Self {
        Self { tensors, prefix: prefix.to_owned() }
    }

    /// What is below `name`.
    pub(super) fn sub(&self, name: &str) -> Self {
        Self { tensors: self.tensors, prefix: format!("{}.{name}", self.prefix) }
    }

    /// A matrix by name.
    ///
    /// # Errors
    /// [`ModelError::Mismatch`] if there is none of that name.
    pub(super) fn matrix(&self, name: &str) -> Result<Matrix, ModelError> {
        let tensor = self.tensor(name)?;
        match tensor.size().as_slice() {
            [rows, columns] => Ok(Matrix::new(*rows as usize, *columns as usize, floats(tensor))),
            shape => Err(self.wrong(name, &format!("has the shape {shape:?}, not that of a matrix"))),
        }
    }

    /// A vector by name.
    ///
    /// # Errors
    /// As [`Weights::matrix`].
    pub(super) fn vector(&self, name: &str) -> Result<Vec<f32>, ModelError> {
        Ok(floats(self.tensor(name)?))
    }

    /// Weight and bias of a linear layer.
    ///
    /// # Errors
    /// As [`Weights::matrix`].
    pub(super) fn linear(&self, name: &str) -> Result<(Matrix, Vec<f32>), ModelError> {
        let layer = self.sub(name);
        Ok((layer.matrix("weight")?, layer.vector("bias")?))
    }

    fn tensor(&self, name: &str) -> Result<&Tensor, ModelError> {
        self.tensors.get(&format!("{}.{name}", self.prefix)).ok_or_else(|| self.wrong(name, "is missing"))
    }

    fn wrong(&self, name: &str, problem: &str) -> ModelError {
        ModelError::Mismatch {
            what: "policy",
            reason: format!("the tensor {}.{name} {problem}", self.prefix),
        }
    }
}
