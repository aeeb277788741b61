//! What an update did, in all and scenario by scenario.

use crate::losses::{Loss, PolicyDiagnostics};
use crate::net::Forward;
use crate::policy::floats;
use std::collections::BTreeMap;
use tch::{Kind, Tensor};

/// What an update did, for logs and metrics.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct UpdateStats {
    /// Mean of every loss term over the minibatches, before its weight; names start with `actor_` or `critic_`.
    pub losses: BTreeMap<String, f64>,
    /// `approx_kl`, `clip_fraction`, `entropy`, `explained_variance`, gradient norms before the cut, learning rates.
    pub diagnostics: BTreeMap<String, f64>,
    /// Share of the gating weight per expert of the actor network.
    pub expert_usage: Vec<f64>,
    /// Mean assignment per cluster of the actor network.
    pub cluster_usage: Vec<f64>,
    /// The same of every scenario that the round held, by name.
    pub scenarios: BTreeMap<String, ScenarioStats>,
    /// Agent-decisions learned from.
    pub decisions: u64,
}

/// A scenario's part in an update.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScenarioStats {
    /// `approx_kl`, `clip_fraction`, `entropy`, `explained_variance`.
    pub diagnostics: BTreeMap<String, f64>,
    /// Share of the scenario's gating weight per expert of the actor network; empty without a mixture of experts.
    pub expert_usage: Vec<f64>,
    /// Mean assignment of its rows per cluster of the actor network; empty without clustering.
    pub cluster_usage: Vec<f64>,
}

/// Sums over minibatches that become means.
#[derive(Debug)]
pub(crate) struct Means {
    sums: BTreeMap<String, f64>,
    minibatches: f64,
    scenarios: Vec<Sums>,
}

/// Sums over one scenario's samples and rows.
#[derive(Debug, Clone, Default)]
struct Sums {
    samples: f64,
    approx_kl: f64,
    clipped: f64,
    entropy: f64,
    experts: Vec<f64>,
    clusters: Vec<f64>,
}

/// Numbers per sample that are summed by scenario, the first being 1.
const PER_SAMPLE: i64 = 4;

impl Means {
    /// Of a run with so many scenarios.
    pub(crate) fn new(scenarios: usize) -> Self {
        Self { sums: BTreeMap::new(), minibatches: 0.0, scenarios: vec![Sums::default(); scenarios] }
    }

    /// One more minibatch begins.
    pub(crate) fn begin(&mut self) {
        self.minibatches += 1.0;
    }

    /// A number per minibatch.
    pub(crate) fn add(&mut self, name: &str, value: f64) {
        *self.sums.entry(name.to_owned()).or_default() += value;
    }

    /// All terms of a network's loss, read back together.
    pub(crate) fn add_loss(&mut self, network: &str, loss: &Loss) {
        let all: Vec<Tensor> = std::iter::once(&loss.total())
            .chain(loss.terms.iter().map(|(_, term)| term))
            .map(Tensor::detach)
            .collect();
        let names = std::iter::once("total").chain(loss.terms.iter().map(|(name, _)| *name));
        for (name, value) in names.zip(floats(&Tensor::stack(&all, 0))) {
            self.add(&format!("loss/{network}_{name}"), f64::from(value));
        }
    }

    /// The actor's behaviour; `scenario_of_sample` and `scenario_of_row` are indices into the run's scenarios.
    pub(crate) fn add_policy(
        &mut self,
        forward: &Forward,
        diagnostics: &PolicyDiagnostics,
        scenario_of_sample: &Tensor,
        scenario_of_row: &Tensor,
        experts: i64,
    ) {
        let count = self.scenarios.len() as i64;
        let (clusters, numbers) = tch::no_grad(|| {
            let PolicyDiagnostics { approx_kl, clipped, entropy } = diagnostics;
            let per_sample = Tensor::stack(&[&approx_kl.ones_like(), approx_kl, clipped, entropy], 1);
            let mut parts = vec![by_scenario(&per_sample, scenario_of_sample, count)];
            if let Some(pcc) = &forward.pcc {
                parts.push(by_scenario(&pcc.weights, scenario_of_row, count));
            }
            if let Some((alpha, indices)) = &forward.moe.gates {
                let cell = scenario_of_row.unsqueeze(1) * experts + indices;
                let flat = Tensor::zeros([count * experts], (alpha.kind(), alpha.device()));
                let flat = flat.index_add(0, &cell.reshape([-1]), &alpha.reshape([-1]));
                parts.push(flat.view([count, experts]));
            }
            let clusters = forward.pcc.as_ref().map_or(0, |pcc| pcc.weights.size()[1]) as usize;
            (clusters, floats(&Tensor::cat(&parts, 1).to_kind(Kind::Float)))
        });
        let width = numbers.len() / self.scenarios.len().max(1);
        for (sums, row) in self.scenarios.iter_mut().zip(numbers.chunks(width.max(1))) {
            let (scalars, usage) = row.split_at(PER_SAMPLE as usize);
            sums.samples += f64::from(scalars[0]);
            sums.approx_kl += f64::from(scalars[1]);
            sums.clipped += f64::from(scalars[2]);
            sums.entropy += f64::from(scalars[3]);
            let (by_cluster, by_expert) = usage.split_at(clusters);
            accumulate(&mut sums.clusters, by_cluster.iter().map(|v| f64::from(*v)));
            accumulate(&mut sums.experts, by_expert.iter().map(|v| f64::from(*v)));
        }
    }

    /// The means. `names` are the run's scenarios in order.
    pub(crate) fn finish<'a>(self, names: impl Iterator<Item = &'a str>) -> UpdateStats {
        let mut stats = UpdateStats::default();
        let mut all = Sums::default();
        for (name, sums) in names.zip(&self.scenarios) {
            all.add(sums);
            // A round under way need not hold every scenario.
            if sums.samples > 0.0 {
                stats.scenarios.insert(name.to_owned(), sums.finish());
            }
        }
        let ScenarioStats { diagnostics, expert_usage, cluster_usage } = all.finish();
        (stats.diagnostics, stats.expert_usage, stats.cluster_usage) =
            (diagnostics, expert_usage, cluster_usage);
        let count = self.minibatches.max(1.0);
        for (name, sum) in self.sums {
            match name.strip_prefix("loss/") {
                Some(term) => stats.losses.insert(term.to_owned(), sum / count),
                None => stats.diagnostics.insert(name, sum / count),
            };
        }
        stats
    }
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.approx_kl += other.approx_kl;
        self.clipped += other.clipped;
        self.entropy += other.entropy;
        accumulate(&mut self.experts, other.experts.iter().copied());
        accumulate(&mut self.clusters, other.clusters.iter().copied());
    }

    fn finish(&self) -> ScenarioStats {
        let samples = self.samples.max(1.0);
        ScenarioStats {
            diagnostics: BTreeMap::from([
                ("approx_kl".to_owned(), self.approx_kl / samples),
                ("clip_fraction".to_owned(), self.clipped / samples),
                ("entropy".to_owned(), self.entropy / samples),
            ]),
            expert_usage: shares(&self.experts),
            cluster_usage: shares(&self.clusters),
        }
    }
}

/// Rows of `x` `[n, width]` summed by scenario `[scenarios, width]`.
fn by_scenario(x: &Tensor, scenario: &Tensor, scenarios: i64) -> Tensor {
    Tensor::zeros([scenarios, x.size()[1]], (x.kind(), x.device())).index_add(0, scenario, x)
}

fn accumulate(sums: &mut Vec<f64>, values: impl Iterator<Item = f64>) {
    for (i, value) in values.enumerate() {
        match sums.get_mut(i) {
            Some(sum) => *sum += value,
            None => sums.push(value),
        }
    }
}

/// Parts of the whole; every row's gating weights, and its assignment, sum to 1.
fn shares(sums: &[f64]) -> Vec<f64> {
    let total: f64 = sums.iter().sum();
    sums.iter().map(|sum| if total > 0.0 { sum / total } else { 0.0 }).collect()
}
