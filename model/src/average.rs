//! One policy from several of a run: the mean of their weights (Izmailov et al. 2018, "Averaging weights leads to wider optima
//! and better generalization").
//!
//! Where traffic is chaotic, policies a few updates apart control it differently well. Their mean is less a matter of luck.

use crate::error::ModelError;
use crate::features::FeatureSizes;
use crate::policy::networks;
use crate::snapshot::{self, PolicyMetadata};
use tch::{Kind, Tensor};

/// The mean of policies of one configuration, as a policy file; version and description are the last one's. The mean of one is
/// that one, byte for byte.
///
/// # Errors
/// [`ModelError::Mismatch`] without any, or if they differ in environment or networks, and whatever is wrong
/// with a file.
pub fn average(policies: &[Vec<u8>]) -> Result<Vec<u8>, ModelError> {
    let last = match policies {
        [] => {
            let reason = "there is none to average".to_owned();
            return Err(ModelError::Mismatch { what: "policy", reason });
        }
        [only] => return Ok(only.clone()),
        [.., last] => last,
    };
    let metadata = snapshot::read_metadata(last)?;
    let sizes = FeatureSizes::new(&metadata.env, &metadata.model);
    let mean = networks(last, &metadata, &sizes)?;
    let weights = || mean.0.params().iter().chain(mean.1.params().iter()).map(|(_, tensor)| tensor);
    // In double precision, so that the order of adding does not matter.
    let mut sums: Vec<Tensor> =
        weights().map(|tensor| tensor.detach().zeros_like().to_kind(Kind::Double)).collect();
    for bytes in policies {
        let PolicyMetadata { env, model, .. } = snapshot::read_metadata(bytes)?;
        if env != metadata.env || model != metadata.model {
            return Err(ModelError::Mismatch {
                what: "policy",
                reason: "its env or model configuration differs from that of the others; average checkpoints of one run".to_owned(),
            });
        }
        let (actor, critic) = networks(bytes, &metadata, &sizes)?;
        for (sum, (_, tensor)) in sums.iter_mut().zip(actor.params().iter().chain(critic.params().iter())) {
            *sum += tensor.detach().to_kind(Kind::Double);
        }
    }
    tch::no_grad(|| {
        for (tensor, sum) in weights().zip(&sums) {
            tensor.shallow_clone().copy_(&(sum / policies.len() as f64));
        }
    });
    snapshot::write_policy(&mean.0, &mean.1, &metadata)
}
