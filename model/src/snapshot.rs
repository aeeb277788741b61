//! Weights as safetensors bytes with the metadata to rebuild their network.

use crate::error::ModelError;
use crate::net::{Net, Role};
use cross_config::{EnvConfig, ModelConfig};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::{BTreeMap, HashMap};
use tch::{Kind, Tensor};

/// Version of the policy file's layout.
pub const FORMAT_VERSION: &str = "1";
/// Version of the optimiser file's layout; 2 since the critic's outputs have a size of their own in each scenario.
pub const OPTIMIZER_FORMAT_VERSION: &str = "2";
/// What a file of weights calls itself.
pub const POLICY_FORMAT: &str = "cross-policy";
/// What a file of optimiser state calls itself.
pub const OPTIMIZER_FORMAT: &str = "cross-optimizer";

/// The one metadata key of a file: a JSON object of strings. With several keys the header's order, and so the file's
/// bytes, would differ from run to run.
const METADATA_KEY: &str = "cross";

/// Text metadata of a file.
pub type Metadata = BTreeMap<String, String>;

/// Metadata of a policy file.
#[derive(Debug, Clone, PartialEq)]
pub struct PolicyMetadata {
    /// Version of the policy.
    pub policy_version: u64,
    /// Environment that the weights were trained for.
    pub env: EnvConfig,
    /// Networks.
    pub model: ModelConfig,
}

impl PolicyMetadata {
    fn to_map(&self) -> Metadata {
        // Plain data serialises.
        let json = |value: Result<String, serde_json::Error>| value.expect("a configuration serialises");
        Metadata::from([
            ("format".to_owned(), POLICY_FORMAT.to_owned()),
            ("format_version".to_owned(), FORMAT_VERSION.to_owned()),
            ("policy_version".to_owned(), self.policy_version.to_string()),
            ("env".to_owned(), json(serde_json::to_string(&self.env))),
            ("model".to_owned(), json(serde_json::to_string(&self.model))),
        ])
    }
}

/// Serialises tensors by name.
///
/// # Errors
/// [`ModelError::Mismatch`] if a tensor cannot be written, which float32 tensors always can.
pub fn write<'a>(
    tensors: impl Iterator<Item = (String, &'a Tensor)>,
    metadata: &Metadata,
) -> Result<Vec<u8>, ModelError> {
    let buffers: Vec<(String, Vec<usize>, Vec<u8>)> = tensors
        .map(|(name, tensor)| {
            let shape = tensor.size().iter().map(|&d| d as usize).collect();
            (name, shape, bytes_of(tensor))
        })
        .collect();
    let mut views = Vec::with_capacity(buffers.len());
    for (name, shape, data) in &buffers {
        let view = TensorView::new(Dtype::F32, shape.clone(), data)
            .map_err(|e| ModelError::Mismatch { what: "snapshot", reason: format!("{name}: {e}") })?;
        views.push((name.as_str(), view));
    }
    // Plain data serialises.
    let metadata = serde_json::to_string(metadata).expect("strings serialise");
    safetensors::serialize(views, Some(HashMap::from([(METADATA_KEY.to_owned(), metadata)])))
        .map_err(|e| ModelError::Mismatch { what: "snapshot", reason: e.to_string() })
}

fn bytes_of(tensor: &Tensor) -> Vec<u8> {
    let flat = tensor.detach().to_kind(Kind::Float).contiguous().view([-1]);
    let mut values = vec![0.0f32; flat.numel()];
    let count = values.len();
    flat.copy_data(&mut values, count);
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Parsed bytes and their metadata.
pub struct File<'a> {
    what: &'static str,
    tensors: SafeTensors<'a>,
    metadata: Metadata,
}

impl<'a> File<'a> {
    /// Reads bytes that should be of the given format; `what` is how errors call them.
    ///
    /// # Errors
    /// [`ModelError::Damaged`] if it is no complete safetensors file, [`ModelError::Foreign`] if another program's.
    pub fn read(bytes: &'a [u8], format: &str, what: &'static str) -> Result<Self, ModelError> {
        let damaged = |e: safetensors::SafeTensorError| ModelError::Damaged { what, reason: e.to_string() };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let text = header.metadata().as_ref().and_then(|map| map.get(METADATA_KEY));
        let metadata: Metadata = text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let found = metadata.get("format").map_or("no format key", String::as_str);
        if found != format {
            return Err(ModelError::Foreign { what, reason: format!("expected {format}, found {found}") });
        }
        let version = metadata.get("format_version").map_or("none", String::as_str);
        let readable = if format == OPTIMIZER_FORMAT { OPTIMIZER_FORMAT_VERSION } else { FORMAT_VERSION };
        if version != readable {
            return Err(ModelError::Foreign {
                what,
                reason: format!("format version {version}, this program reads {readable}"),
            });
        }
        Ok(Self { what, tensors, metadata })
    }

    /// A metadata value.
    ///
    /// # Errors
    /// [`ModelError::Foreign`] if it is missing or does not parse.
    pub fn value<T: std::str::FromStr>(&self, key: &str) -> Result<T, ModelError> {
        let text = self.metadata.get(key).ok_or_else(|| self.foreign(format!("the key {key} is missing")))?;
        text.parse().map_err(|_| self.foreign(format!("the key {key} reads {text:?}")))
    }

    /// A metadata value that is JSON.
    ///
    /// # Errors
    /// As [`File::value`].
    pub fn json<T: serde::de::DeserializeOwned>(&self, key: &str) -> Result<T, ModelError> {
        let text: String = self.value(key)?;
        serde_json::from_str(&text).map_err(|e| self.foreign(format!("the key {key}: {e}")))
    }

    fn foreign(&self, reason: String) -> ModelError {
        ModelError::Foreign { what: self.what, reason }
    }

    /// Copies the tensor `name` into `target`, whose shape it must have.
    ///
    /// # Errors
    /// [`ModelError::Mismatch`] names the tensor that is missing or has another shape, or holds what is not a number.
    pub fn copy_into(&self, name: &str, target: &Tensor) -> Result<(), ModelError> {
        let mismatch = |reason: String| ModelError::Mismatch { what: self.what, reason };
        let view =
            self.tensors.tensor(name).map_err(|_| mismatch(format!("the tensor {name} is missing")))?;
        let wanted: Vec<usize> = target.size().iter().map(|&d| d as usize).collect();
        if view.dtype() != Dtype::F32 || view.shape() != wanted {
            return Err(mismatch(format!(
                "the tensor {name} is {:?} {:?} where {wanted:?} float32 is needed",
                view.dtype(),
                view.shape()
            )));
        }
        let values: Vec<f32> =
            view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        if values.iter().any(|v| !v.is_finite()) {
            return Err(mismatch(format!("the tensor {name} holds a value that is not a finite number")));
        }
        let source = Tensor::from_slice(&values).view(target.size().as_slice());
        tch::no_grad(|| target.shallow_clone().copy_(&source));
        Ok(())
    }
}

/// Weights of both networks with their metadata.
///
/// # Errors
/// As [`write()`].
pub fn write_policy(actor: &Net, critic: &Net, metadata: &PolicyMetadata) -> Result<Vec<u8>, ModelError> {
    let tensors = actor.params().iter().chain(critic.params().iter()).map(|(name, t)| (name.to_owned(), t));
    write(tensors, &metadata.to_map())
}

/// Metadata of a policy file: of networks that can be built.
///
/// # Errors
/// As [`File::read`] and [`File::value`]; [`ModelError::Foreign`] also for values that a configuration may not have.
pub fn read_metadata(bytes: &[u8]) -> Result<PolicyMetadata, ModelError> {
    let file = File::read(bytes, POLICY_FORMAT, "policy")?;
    let (env, mut model): (EnvConfig, ModelConfig) = (file.json("env")?, file.json("model")?);
    let written: serde_json::Value = file.json("model")?;
    model.complete_older(|key| written.get(key).is_some());
    env.validate().and_then(|()| model.validate()).map_err(|error| file.foreign(error.to_string()))?;
    Ok(PolicyMetadata { policy_version: file.value("policy_version")?, env, model })
}

/// Copies a policy file's weights into networks of the same configuration.
///
/// # Errors
/// [`ModelError`] says which part does not fit; the networks may then be partly overwritten.
pub fn load_weights(bytes: &[u8], actor: &Net, critic: &Net) -> Result<(), ModelError> {
    let file = File::read(bytes, POLICY_FORMAT, "policy")?;
    for (role, net) in [(Role::Actor, actor), (Role::Critic, critic)] {
        for (name, tensor) in net.params().iter() {
            debug_assert!(name.starts_with(role.name()));
            file.copy_into(name, tensor)?;
        }
    }
    Ok(())
}
