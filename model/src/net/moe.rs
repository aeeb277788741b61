//! Scenario-adaptive mixture of experts (paper, section IV-C): a router picks the top k experts of every phase row, and
//! only those run.

use super::layers::Mlp;
use crate::params::Init;
use cross_config::ModelConfig;
use tch::{Kind, Tensor};

/// What the mixture gives for every packed phase row.
#[derive(Debug)]
pub struct MoeOutput {
    /// Weighted sum of the chosen experts `[rows, hidden]`.
    pub h_moe: Tensor,
    /// Gating weights of the chosen experts `[rows, k]` and their indices, unless there is one dense expert.
    pub gates: Option<(Tensor, Tensor)>,
}

#[derive(Debug)]
pub(super) struct Moe {
    top_k: i64,
    tau_r: f64,
    router: Option<Mlp>,
    experts: Vec<Mlp>,
}

impl Moe {
    /// `context` is the width of `z_hat`, 0 without clustering.
    pub(super) fn new(init: &mut Init<'_>, config: &ModelConfig, context: i64) -> Self {
        let hidden = config.hidden;
        if !config.moe {
            // As wide as the experts that would be active together.
            let dense = Mlp::new(&mut init.sub("dense"), hidden, config.top_k * hidden, hidden);
            return Self { top_k: 1, tau_r: 1.0, router: None, experts: vec![dense] };
        }
        let router = Mlp::new(&mut init.sub("router"), hidden + context, hidden, config.experts);
        let experts = (0..config.experts)
            .map(|m| Mlp::new(&mut init.sub(&format!("expert{m}")), hidden, hidden, hidden))
            .collect();
        Self { top_k: config.top_k, tau_r: config.tau_r, router: Some(router), experts }
    }

    pub(super) fn forward(&self, h_sp: &Tensor, z_hat: Option<&Tensor>) -> MoeOutput {
        let Some(router) = &self.router else {
            return MoeOutput { h_moe: self.experts[0].forward(h_sp), gates: None };
        };
        let logits = match z_hat {
            Some(z_hat) => router.forward(&Tensor::cat(&[h_sp, z_hat], 1)),
            None => router.forward(h_sp),
        } / self.tau_r;
        let (chosen, indices) = logits.topk(self.top_k, -1, true, true);
        let alpha = chosen.softmax(-1, Kind::Float);
        let flat_alpha = alpha.reshape([-1, 1]);
        let flat_indices = indices.reshape([-1]);
        let mut h_moe = h_sp.zeros_like();
        for (m, expert) in self.experts.iter().enumerate() {
            // Positions in the flattened [rows, k] table; position / k is the row.
            let positions = flat_indices.eq(m as i64).nonzero().squeeze_dim(1);
            if positions.numel() == 0 {
                continue;
            }
            let rows = positions.divide_scalar_mode(self.top_k, "floor");
            let out = expert.forward(&h_sp.index_select(0, &rows)) * flat_alpha.index_select(0, &positions);
            h_moe = h_moe.index_add(0, &rows, &out);
        }
        MoeOutput { h_moe, gates: Some((alpha, indices)) }
    }
}
