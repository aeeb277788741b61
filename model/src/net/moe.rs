//! Scenario-adaptive mixture of experts (paper, section IV-C): a router picks the top k experts of every phase row, and
//! only those run.
//!
//! The head is linear, so it is applied to each expert's output instead of to their weighted sum, and an expert's second
//! layer and the head are one vector: `head(sum alpha_m E_m(x)) = sum alpha_m (W_head W_m) relu(..) + ..`. The sum itself,
//! `h_moe`, is computed only for who asks for it.

use super::experts::{self, Parts, Table};
use super::gfe::PhaseFeatures;
use super::join;
use super::layers::{Linear, Mlp};
use super::tape::Tape;
use crate::batch::{Batch, whole_numbers};
use crate::params::Init;
use cross_config::ModelConfig;
use tch::{Kind, Tensor};

/// What the mixture gives for every packed phase row.
#[derive(Debug)]
pub struct MoeOutput {
    /// The head on the weighted sum of the chosen experts `[rows]`.
    pub scores: Tensor,
    /// Gating weights of the chosen experts `[rows, k]` and their indices, unless there is one dense expert.
    pub gates: Option<(Tensor, Tensor)>,
}

/// The pattern that the router sees beside the phase's features, as a combination of cluster centres.
pub(super) struct Pattern<'a> {
    /// `[rows, clusters]`.
    pub(super) weights: &'a Tensor,
    /// `[clusters, latent]`.
    pub(super) centres: &'a Tensor,
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

    /// Scores of every row under a head of one output.
    pub(super) fn forward(
        &self,
        batch: &Batch,
        h_sp: &PhaseFeatures,
        pattern: Option<&Pattern<'_>>,
        head: &Linear,
        tape: &mut Tape,
    ) -> MoeOutput {
        let Some(router) = &self.router else {
            let dense = &self.experts[0];
            let hidden = h_sp.project(batch, dense.first()).relu_();
            let scores = head.after(dense.second()).forward(&hidden).squeeze_dim(1);
            return MoeOutput { scores, gates: None };
        };
        let logits = router.second().forward(&routed(router.first(), batch, h_sp, pattern)) / self.tau_r;
        let (chosen, indices) = logits.topk(self.top_k, -1, true, true);
        let alpha = chosen.softmax(-1, Kind::Float);
        // Alpha sums to 1, so the head's bias comes once, at the end.
        let scores = match h_sp {
            PhaseFeatures::Sum(phases, samples, phase_of_row) if tape.loops() => {
                let parts = self.parts(phases, samples, head);
                let (phase, sample) = (whole_numbers(phase_of_row), whole_numbers(batch.sample_of_row()));
                let table = Table { k: self.top_k as usize, expert: whole_numbers(&indices), phase, sample };
                experts::scores(parts, table, tape)
            }
            _ => self.planned(batch, h_sp, &indices, head).view_as(&alpha),
        };
        let scores = (scores * &alpha).sum_dim_intlist(-1, false, Kind::Float) + head.bias();
        MoeOutput { scores, gates: Some((alpha, indices)) }
    }

    /// What the chosen experts' scores are made of where rows are sums.
    fn parts(&self, phases: &Tensor, samples: &Tensor, head: &Linear) -> Parts {
        // All experts on phases and on samples are less work than the chosen ones on rows.
        let layers = self.first_layers();
        let (v, c): (Vec<Tensor>, Vec<Tensor>) = self.experts.iter().map(|expert| onto(head, expert)).unzip();
        Parts {
            phases: layers.forward(phases),
            samples: layers.without_bias().forward(samples),
            v: Tensor::cat(&v, 0),
            c: Tensor::cat(&c, 0),
        }
    }

    /// The first layers of all experts side by side.
    fn first_layers(&self) -> Linear {
        Linear::beside(&self.experts.iter().map(Mlp::first))
    }

    /// Scores of every row's chosen experts, expert by expert `[rows * k]`.
    fn planned(&self, batch: &Batch, h_sp: &PhaseFeatures, indices: &Tensor, head: &Linear) -> Tensor {
        let plan = Plan::new(indices, self.experts.len());
        let hidden = self.hidden(batch, h_sp, &plan);
        let scores = self.experts.iter().zip(&hidden).filter(|(_, own)| own.numel() > 0);
        let scores = scores.map(|(expert, own)| {
            let (weight, bias) = onto(head, expert);
            own.linear(&weight, Some(bias))
        });
        // Back from the experts' order to [rows, k].
        join(scores.collect()).index_select(0, &plan.places)
    }

    /// Hidden layer of each expert on its rows.
    fn hidden(&self, batch: &Batch, h_sp: &PhaseFeatures, plan: &Plan) -> Vec<Tensor> {
        let counts = plan.counts.as_slice();
        match h_sp {
            PhaseFeatures::Rows(rows) => {
                let own = rows.index_select(0, &plan.rows).split_with_sizes(counts, 0);
                self.experts.iter().zip(&own).map(|(expert, own)| expert.hidden(own)).collect()
            }
            PhaseFeatures::Sum(phases, samples, phase_of_row) => {
                let layers = self.first_layers();
                let count = self.experts.len() as i64;
                let width = samples.size()[1];
                let chosen = |all: Tensor, of_row: &Tensor| {
                    let index = of_row.index_select(0, &plan.rows) * count + &plan.experts;
                    all.view([-1, width]).index_select(0, &index)
                };
                let mut sum = chosen(layers.forward(phases), phase_of_row);
                let _ = sum.g_add_(&chosen(layers.without_bias().forward(samples), batch.sample_of_row()));
                sum.relu_().split_with_sizes(counts, 0)
            }
        }
    }

    /// Weighted sum of the chosen experts `[rows, hidden]`.
    pub(super) fn mixed(&self, h_sp: &Tensor, output: &MoeOutput) -> Tensor {
        let Some((alpha, indices)) = &output.gates else { return self.experts[0].forward(h_sp) };
        let mut mixed = h_sp.zeros_like();
        for (m, expert) in self.experts.iter().enumerate() {
            let weight = (alpha * indices.eq(m as i64)).sum_dim_intlist(-1, true, Kind::Float);
            mixed += expert.forward(h_sp) * weight;
        }
        mixed
    }
}

/// An expert's second layer and the head as one: weight `[1, width]` and bias `[1]`, without the head's own bias.
fn onto(head: &Linear, expert: &Mlp) -> (Tensor, Tensor) {
    let second = expert.second();
    (head.weight().matmul(second.weight()), head.weight().mv(second.bias()))
}

/// The router's hidden layer from `[h_sp, z_hat]`, without putting the two side by side: the pattern's part is taken at the
/// centres and combined by their weights.
fn routed(first: &Linear, batch: &Batch, h_sp: &PhaseFeatures, pattern: Option<&Pattern<'_>>) -> Tensor {
    let Some(Pattern { weights, centres }) = pattern else { return h_sp.project(batch, first).relu_() };
    let (latent, all) = (centres.size()[1], first.weight().size()[1]);
    let of_pattern = first.weight().narrow(1, all - latent, latent).matmul(&centres.transpose(0, 1));
    let mut sum = h_sp.project(batch, &first.first_columns(all - latent));
    let _ = sum.addmm_(weights, &of_pattern.transpose(0, 1));
    sum.relu_()
}

/// Who computes what: the table `[rows, k]` of chosen experts, sorted by expert.
struct Plan {
    /// Row of every entry `[rows * k]`, by expert, then by row.
    rows: Tensor,
    /// Expert of every entry, in the same order.
    experts: Tensor,
    /// Entries of each expert.
    counts: Vec<i64>,
    /// Where the table's entries are in that order `[rows * k]`.
    places: Tensor,
}

impl Plan {
    /// One reading of the table and a counting sort: cheaper than a search per expert, on a GPU too.
    fn new(table: &Tensor, experts: usize) -> Self {
        let k = table.size()[1];
        let entries = whole_numbers(table);
        let mut counts = vec![0i64; experts];
        for &expert in &entries {
            counts[expert as usize] += 1;
        }
        let mut next: Vec<i64> = counts
            .iter()
            .scan(0, |sum, count| {
                *sum += count;
                Some(*sum - count)
            })
            .collect();
        let sorted = counts.iter().enumerate();
        let sorted = sorted.flat_map(|(expert, &count)| std::iter::repeat_n(expert as i64, count as usize));
        let sorted: Vec<i64> = sorted.collect();
        let (mut rows, mut places) = (vec![0i64; entries.len()], Vec::with_capacity(entries.len()));
        for (position, &expert) in entries.iter().enumerate() {
            let place = &mut next[expert as usize];
            rows[*place as usize] = position as i64 / k;
            places.push(*place);
            *place += 1;
        }
        let tensor = |values: &[i64]| Tensor::from_slice(values).to_device(table.device());
        Self { rows: tensor(&rows), experts: tensor(&sorted), places: tensor(&places), counts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_sorts_by_expert_and_finds_back() {
        let table = Tensor::from_slice(&[2i64, 0, 0, 2, 2, 3]).view([3, 2]);
        let plan = Plan::new(&table, 4);
        assert_eq!(plan.counts, [2, 0, 3, 1]);
        assert_eq!(whole_numbers(&plan.rows), [0, 1, 0, 1, 2, 2]);
        assert_eq!(whole_numbers(&plan.experts), [0, 0, 2, 2, 2, 3]);
        assert_eq!(whole_numbers(&plan.places), [2, 0, 1, 3, 4, 5]);
    }
}
