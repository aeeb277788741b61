//! Mixture of experts and head for one observation; the same as the training's `net::moe` and the network's head.
//!
//! Between an expert's hidden layer and the score there are only linear steps, so that they are one scalar product, and
//! the centres, which the router's first layer is linear in, are in its weights.

use super::gfe::mlp;
use super::weights::Weights;
use crate::error::ModelError;
use crate::vector::math::dot;
use crate::vector::{Dense, Isa, Matrix, Mlp, Work};
use cross_config::ModelConfig;

#[derive(Debug)]
pub(super) struct Moe {
    isa: Isa,
    hidden: usize,
    top_k: usize,
    tau: f32,
    router: Option<Mlp>,
    experts: Vec<Expert>,
    bias: f32,
}

/// First layer with ReLU, then a scalar product.
#[derive(Debug)]
struct Expert {
    first: Dense,
    score: Vec<f32>,
    offset: f32,
}

/// Buffers of [`Moe::forward`].
#[derive(Debug, Default)]
pub(super) struct MoeWork {
    joined: Vec<f32>,
    inner: Vec<f32>,
    logits: Vec<f32>,
    /// Row and weight of every row that an expert has.
    chosen: Vec<Vec<(usize, f32)>>,
    rows: Vec<f32>,
    best: Vec<(usize, f32)>,
}

impl MoeWork {
    /// Weight of every expert in every row `[rows, experts]`; empty without a router.
    pub(super) fn gates(&self, rows: usize) -> Vec<f32> {
        let experts = self.chosen.len();
        let mut gates = vec![0.0; rows * experts];
        for (expert, chosen) in self.chosen.iter().enumerate() {
            for &(row, weight) in chosen {
                gates[row * experts + expert] = weight;
            }
        }
        gates
    }
}

impl Moe {
    /// `weights` are the whole network's; `centres` `[clusters, latent]` if there is clustering.
    pub(super) fn new(
        isa: Isa,
        weights: &Weights<'_>,
        config: &ModelConfig,
        centres: Option<&Matrix>,
    ) -> Result<Self, ModelError> {
        let hidden = config.hidden as usize;
        let moe = weights.sub("moe");
        let (head, bias) = weights.linear("head")?;
        let expert = |name: &str| -> Result<Expert, ModelError> {
            let expert = moe.sub(name);
            let ((first, first_bias), (second, second_bias)) = (expert.linear("0")?, expert.linear("1")?);
            Ok(Expert {
                first: Dense::new(isa, &first, Some(&first_bias)),
                score: head.times(&second).row(0).to_vec(),
                offset: head.apply(&second_bias, &[0.0])[0],
            })
        };
        let names: Vec<String> = match config.moe {
            true => (0..config.experts).map(|m| format!("expert{m}")).collect(),
            false => vec!["dense".to_owned()],
        };
        let router = match (config.moe, centres) {
            (false, _) => None,
            (true, None) => Some(mlp(isa, &moe.sub("router"))?),
            (true, Some(centres)) => {
                let ((first, bias), (second, second_bias)) =
                    (moe.sub("router").linear("0")?, moe.sub("router").linear("1")?);
                let of_assignment = first.columns(hidden, first.columns).times(&centres.transposed());
                let first = first.columns(0, hidden).beside(&of_assignment);
                Some(Mlp {
                    first: Dense::new(isa, &first, Some(&bias)),
                    second: Dense::new(isa, &second, Some(&second_bias)),
                })
            }
        };
        Ok(Self {
            isa,
            hidden,
            top_k: config.top_k as usize,
            tau: config.tau_r as f32,
            router,
            experts: names.iter().map(|name| expert(name)).collect::<Result<_, _>>()?,
            bias: bias[0],
        })
    }

    /// The score of every phase `[rows]` from `h_sp` `[rows, hidden]` and the assignment `[rows, clusters]`, which is empty
    /// without clustering.
    pub(super) fn forward(
        &self,
        h_sp: &[f32],
        assignment: &[f32],
        work: &mut MoeWork,
        scores: &mut Vec<f32>,
    ) {
        scores.clear();
        scores.resize(h_sp.len() / self.hidden, self.bias);
        let Some(router) = &self.router else {
            for expert in &self.experts {
                expert.first.forward_relu(h_sp, &mut work.inner);
                self.isa.run(Add { expert, inner: &work.inner, chosen: None, scores });
            }
            return;
        };
        self.route(router, h_sp, assignment, work);
        for (expert, chosen) in self.experts.iter().zip(&work.chosen) {
            work.rows.clear();
            for &(row, _) in chosen {
                work.rows.extend_from_slice(&h_sp[row * self.hidden..(row + 1) * self.hidden]);
            }
            expert.first.forward_relu(&work.rows, &mut work.inner);
            self.isa.run(Add { expert, inner: &work.inner, chosen: Some(chosen), scores });
        }
    }

    /// Finds the experts of every row, the first of equals, and their weights.
    fn route(&self, router: &Mlp, h_sp: &[f32], assignment: &[f32], work: &mut MoeWork) {
        let rows = h_sp.len() / self.hidden;
        let clusters = assignment.len() / rows.max(1);
        work.joined.clear();
        for row in 0..rows {
            work.joined.extend_from_slice(&h_sp[row * self.hidden..(row + 1) * self.hidden]);
            work.joined.extend_from_slice(&assignment[row * clusters..(row + 1) * clusters]);
        }
        router.forward(&work.joined, &mut work.inner, &mut work.logits);
        work.chosen.resize_with(self.experts.len(), Vec::new);
        work.chosen.iter_mut().for_each(Vec::clear);
        for (row, logits) in work.logits.chunks_exact(self.experts.len()).enumerate() {
            gates(logits, self.top_k, self.tau, &mut work.best);
            for &(m, weight) in &work.best {
                work.chosen[m].push((row, weight));
            }
        }
    }
}

/// The `k` largest logits' indices, the lowest of equals first, with the softmax of these logits over `tau`.
fn gates(logits: &[f32], k: usize, tau: f32, best: &mut Vec<(usize, f32)>) {
    best.clear();
    for (m, &logit) in logits.iter().enumerate() {
        let at = best.iter().position(|&(_, other)| logit > other).unwrap_or(best.len());
        if at < k {
            best.truncate(k - 1);
            best.insert(at, (m, logit));
        }
    }
    let most = best.first().map_or(0.0, |b| b.1);
    let mut total = 0.0;
    for (_, value) in best.iter_mut() {
        *value = ((*value - most) / tau).exp();
        total += *value;
    }
    for (_, value) in best {
        *value /= total;
    }
}

/// Adds an expert's scores to those of its rows.
struct Add<'a> {
    expert: &'a Expert,
    /// Hidden layer of each of its rows.
    inner: &'a [f32],
    /// Its rows with their weights; none stands for all rows with weight 1.
    chosen: Option<&'a [(usize, f32)]>,
    scores: &'a mut [f32],
}

impl Work for Add<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let Expert { score, offset, .. } = self.expert;
        for (position, inner) in self.inner.chunks_exact(score.len()).enumerate() {
            let (row, weight) = self.chosen.map_or((position, 1.0), |chosen| chosen[position]);
            self.scores[row] += weight * (dot::<FUSED>(inner, score) + offset);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(logits: &[f32], k: usize, tau: f32) -> Vec<(usize, f32)> {
        let mut best = Vec::new();
        gates(logits, k, tau, &mut best);
        best
    }

    #[test]
    fn the_largest_logits_are_chosen_and_share_by_softmax() {
        let best = chosen(&[0.0, 3.0, -1.0, 2.0], 2, 0.5);
        assert_eq!([best[0].0, best[1].0], [1, 3]);
        let first = 1.0 / (1.0 + (-2.0f32).exp());
        assert!((best[0].1 - first).abs() < 1e-6 && (best[1].1 - (1.0 - first)).abs() < 1e-6, "{best:?}");
        assert_eq!(chosen(&[0.0, 3.0], 1, 1.0), [(1, 1.0)]);
    }

    #[test]
    fn of_equals_the_first_are_chosen() {
        assert_eq!(chosen(&[1.0; 6], 2, 1.0), [(0, 0.5), (1, 0.5)]);
        assert_eq!(chosen(&[0.0, 1.0, 1.0, 1.0], 2, 1.0), [(1, 0.5), (2, 0.5)]);
        assert_eq!(chosen(&[2.0, 2.0], 2, 1.0), [(0, 0.5), (1, 0.5)]);
    }
}
