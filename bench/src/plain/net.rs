//! One network on padded inputs, written down as in the paper (section IV).

use super::padded::{PaddedInputs, PaddedMinibatch};
use cross_config::ModelConfig;
use cross_model::net::Net;
use cross_model::params::Params;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;
use tch::{Kind, Tensor};

const NORM_EPSILON: f64 = 1e-5;

/// A network by its parameters' names.
#[derive(Debug)]
pub struct PlainNet {
    model: ModelConfig,
    /// By name without the network's.
    weights: HashMap<String, Tensor>,
    /// Query and key of the attention over one token. Over one token the softmax is 1, so they change no result and the
    /// packed form has none; written out they are computed, backwards too.
    query: Tensor,
    key: Tensor,
}

/// What a pass gives; `P` phases, padded.
#[derive(Debug)]
pub struct PlainForward {
    /// A logit or a value per phase `[B, L, P]`.
    pub scores: Tensor,
    /// Clustering: similarities `[B, L, P, K]`, assignment `[B, L, P, K]`, predictions `[B, L, P, target]`.
    pub pcc: Option<PlainPcc>,
    /// Gating weights of all experts, zero where not chosen `[B, L, P, experts]`.
    pub alpha: Option<Tensor>,
}

/// Clustering on padded phases.
#[derive(Debug)]
pub struct PlainPcc {
    /// Cosine similarities to the centres `[B, L, P, K]`.
    pub similarity: Tensor,
    /// Soft assignment `[B, L, P, K]`.
    pub weights: Tensor,
    /// Predicted next features for every phase `[B, L, P, target]`.
    pub predicted: Tensor,
    z_hat: Tensor,
}

impl PlainNet {
    /// A network that shares the parameters of `net`: gradients go to the same tensors.
    #[must_use]
    pub fn new(net: &Net, model: &ModelConfig) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let width = model.hidden;
        let bound = 1.0 / (width as f32).sqrt();
        let mut square = || {
            let values: Vec<f32> =
                (0..width * width).map(|_| bound * (2.0 * rng.random::<f32>() - 1.0)).collect();
            Tensor::from_slice(&values).view([width, width]).set_requires_grad(true)
        };
        Self { model: model.clone(), query: square(), key: square(), weights: by_name(net.params()) }
    }

    /// The whole pass from the recurrent state `[B, hidden]`.
    #[must_use]
    pub fn forward(&self, batch: &PaddedMinibatch, state: &Tensor) -> PlainForward {
        let h_sp = self.gfe(batch, state);
        let pcc = self.model.pcc.then(|| self.pcc(batch));
        let (h_moe, alpha) = self.moe(&h_sp, pcc.as_ref().map(|pcc| &pcc.z_hat));
        let scores = self.linear("head", &h_moe).squeeze_dim(-1);
        PlainForward { scores, pcc, alpha }
    }

    /// `h_sp` `[B, L, P, hidden]` (IV-A).
    fn gfe(&self, batch: &PaddedMinibatch, state: &Tensor) -> Tensor {
        let (h_p, e) = match &batch.inputs {
            PaddedInputs::Paper { states, greens, .. } => {
                (self.mlp("gfe.phase", greens), self.mlp("gfe.state", states))
            }
            PaddedInputs::Movement { phases, .. } => {
                let h_p = self.mlp("gfe.phase", phases);
                let padding = batch.phase_mask.logical_not().unsqueeze(-1);
                let count = batch.phase_mask.sum_dim_intlist(2, true, Kind::Float);
                let mean = h_p.masked_fill(&padding, 0.0).sum_dim_intlist(2, false, Kind::Float) / count;
                let most = h_p.masked_fill(&padding, f64::NEG_INFINITY).amax(2, false);
                let e = self.mlp("gfe.state", &Tensor::cat(&[mean, most], -1));
                (h_p, e)
            }
        };
        let gru = ["weight_ih", "weight_hh", "bias_ih", "bias_hh"]
            .map(|part| self.weight(&format!("gfe.gru.{part}")).shallow_clone());
        let states = e.gru(&state.unsqueeze(0), &gru, true, 1, 0.0, false, false, true).0;
        let token = (e + states).unsqueeze(2);
        let value = self.linear("gfe.value", &token);
        let attended = match &batch.inputs {
            PaddedInputs::Paper { .. } => {
                let width = self.model.hidden;
                let normed = h_p.layer_norm([width], None::<&Tensor>, None::<&Tensor>, NORM_EPSILON, false);
                let query = normed.linear(&self.query, None::<&Tensor>);
                let key = token.linear(&self.key, None::<&Tensor>);
                self.attention(&query, &key, &value, None)
            }
            PaddedInputs::Movement { lanes, lane_mask, .. } => {
                let query = self.linear("gfe.attention.query", &self.norm("gfe.attention.norm", &h_p));
                let state_key = self.linear("gfe.attention.state_key", &token);
                let key = Tensor::cat(&[self.linear("gfe.attention.lane_key", lanes), state_key], 2);
                let value = Tensor::cat(&[self.linear("gfe.attention.lane_value", lanes), value], 2);
                let one = batch.phase_mask.narrow(2, 0, 1).ones_like();
                let mask = Tensor::cat(&[lane_mask, &one], 2);
                self.attention(&query, &key, &value, Some(&mask))
            }
        };
        h_p + self.linear("gfe.output", &attended)
    }

    /// Multi-head attention: queries `[B, L, P, d]`, keys and values `[B, L, K, d]`, mask `[B, L, K]`; `[B, L, P, d]`.
    fn attention(&self, query: &Tensor, key: &Tensor, value: &Tensor, mask: Option<&Tensor>) -> Tensor {
        let heads = self.model.heads;
        let width = self.model.hidden / heads;
        let split = |x: &Tensor| {
            let size = x.size();
            x.view([size[0], size[1], size[2], heads, width]).transpose(2, 3)
        };
        let (query, key, value) = (split(query), split(key), split(value));
        let mut scores = query.matmul(&key.transpose(-1, -2)) / (width as f64).sqrt();
        if let Some(mask) = mask {
            scores = scores.masked_fill(&mask.logical_not().unsqueeze(2).unsqueeze(2), f64::NEG_INFINITY);
        }
        let joined = scores.softmax(-1, Kind::Float).matmul(&value).transpose(2, 3);
        let size = joined.size();
        joined.reshape([size[0], size[1], size[2], self.model.hidden])
    }

    /// Clustering of every phase from `[S, G^p, I]` (IV-B).
    fn pcc(&self, batch: &PaddedMinibatch) -> PlainPcc {
        let (state, phase) = match &batch.inputs {
            PaddedInputs::Paper { states, greens, .. } => (states, greens),
            PaddedInputs::Movement { phases, context, .. } => (context, phases),
        };
        let over_phases = |x: &Tensor| x.unsqueeze(2).expand([-1, -1, batch.phases, -1], false);
        let joined = Tensor::cat(&[&over_phases(state), phase, &over_phases(&batch.topology)], -1);
        let weight = Tensor::cat(
            &["state", "phase", "topology"].map(|part| self.weight(&format!("pcc.{part}.weight"))),
            1,
        );
        let hidden = joined.linear(&weight, Some(self.weight("pcc.topology.bias"))).glu(-1);
        let z = self.linear("pcc.second", &hidden);
        let phi = self.norm("pcc.norm", &self.linear("pcc.project", &z));
        let centres = self.weight("pcc.centres");
        let similarity = unit(&phi).matmul(&unit(centres).transpose(0, 1));
        let weights = (&similarity / self.model.tau_k).softmax(-1, Kind::Float);
        let z_hat = weights.matmul(centres);
        PlainPcc { predicted: self.linear("pcc.predict", &z), similarity, weights, z_hat }
    }

    /// All experts on every phase, weighted (IV-C).
    fn moe(&self, h_sp: &Tensor, z_hat: Option<&Tensor>) -> (Tensor, Option<Tensor>) {
        if !self.model.moe {
            return (self.mlp("moe.dense", h_sp), None);
        }
        let logits = match z_hat {
            Some(z_hat) => self.mlp("moe.router", &Tensor::cat(&[h_sp, z_hat], -1)),
            None => self.mlp("moe.router", h_sp),
        } / self.model.tau_r;
        let (_, chosen) = logits.topk(self.model.top_k, -1, true, true);
        let left_out = logits.ones_like().scatter_value(-1, &chosen, 0.0).to_kind(Kind::Bool);
        let alpha = logits.masked_fill(&left_out, f64::NEG_INFINITY).softmax(-1, Kind::Float);
        let outputs: Vec<Tensor> =
            (0..self.model.experts).map(|m| self.mlp(&format!("moe.expert{m}"), h_sp)).collect();
        let mixed =
            (Tensor::stack(&outputs, -2) * alpha.unsqueeze(-1)).sum_dim_intlist(-2, false, Kind::Float);
        (mixed, Some(alpha))
    }

    /// The parameter of that name, which the form and the ablations that are configured have.
    fn weight(&self, name: &str) -> &Tensor {
        &self.weights[name]
    }

    fn linear(&self, name: &str, x: &Tensor) -> Tensor {
        x.linear(self.weight(&format!("{name}.weight")), self.weights.get(&format!("{name}.bias")))
    }

    fn mlp(&self, name: &str, x: &Tensor) -> Tensor {
        self.linear(&format!("{name}.1"), &self.linear(&format!("{name}.0"), x).relu())
    }

    fn norm(&self, name: &str, x: &Tensor) -> Tensor {
        let (weight, bias) = (self.weight(&format!("{name}.weight")), self.weight(&format!("{name}.bias")));
        x.layer_norm(weight.size(), Some(weight), Some(bias), NORM_EPSILON, false)
    }
}

fn by_name(params: &Params) -> HashMap<String, Tensor> {
    params
        .iter()
        .map(|(name, tensor)| {
            let own = name.split_once('.').map_or(name, |(_, own)| own);
            (own.to_owned(), tensor.shallow_clone())
        })
        .collect()
}

/// Scaled to length 1 along the last dimension.
fn unit(x: &Tensor) -> Tensor {
    let square: Tensor = x * x;
    x / square.sum_dim_intlist(-1, true, Kind::Float).clamp_min(1e-12).sqrt()
}
