//! The losses of actor and critic (paper, sections IV-B to IV-D), each term apart.

use crate::batch::{Batch, Inputs};
use crate::features::FeatureSizes;
use crate::net::{Forward, Net, PccOutput, WayBack};
use cross_config::{ModelConfig, PpoConfig};
use tch::{Device, Kind, TchError, Tensor};

/// What a minibatch should fit, in packed sample order.
#[derive(Debug)]
pub struct Targets {
    /// Row of each sample's action `[samples]`.
    pub chosen_rows: Tensor,
    /// Behaviour log-probabilities `[samples]`.
    pub log_probs: Tensor,
    /// Advantages `[samples]`.
    pub advantages: Tensor,
    /// Value targets `[samples]`, at the size of the critic's outputs.
    pub returns: Tensor,
    /// Features of the next step that prediction should meet `[samples, target]`.
    pub next: Tensor,
    /// 1 where the next step exists inside the episode, else 0 `[samples]`.
    pub has_next: Tensor,
}

impl Targets {
    /// The same targets on a device.
    #[must_use]
    pub fn to_device(self, device: Device) -> Self {
        Self {
            chosen_rows: self.chosen_rows.to_device(device),
            log_probs: self.log_probs.to_device(device),
            advantages: self.advantages.to_device(device),
            returns: self.returns.to_device(device),
            next: self.next.to_device(device),
            has_next: self.has_next.to_device(device),
        }
    }
}

/// One network's loss.
#[derive(Debug)]
pub struct Loss {
    /// Every term before its weight, by name.
    pub terms: Vec<(&'static str, Tensor)>,
    total: Tensor,
    way_back: WayBack,
}

impl Loss {
    /// What is minimised: the terms' weighted sum, without a graph.
    pub fn total(&self) -> Tensor {
        self.total.detach()
    }

    /// Leaves gradients at all parameters of the network. Once for each loss.
    ///
    /// # Errors
    /// libtorch's.
    pub fn backward(&self) -> Result<(), TchError> {
        self.way_back.descend_from(&self.total)
    }
}

/// How far the policy is from the one that collected, sample by sample `[samples]`, without gradients. Their means over
/// samples are what is usually reported (CleanRL's definitions).
#[derive(Debug)]
pub struct PolicyDiagnostics {
    /// `(ratio - 1) - log ratio`, whose mean estimates the KL divergence.
    pub approx_kl: Tensor,
    /// 1 where the ratio left the clip range, else 0.
    pub clipped: Tensor,
    /// Entropy of the policy over the sample's phases.
    pub entropy: Tensor,
}

/// The actor's loss; `entropy_weight` follows the schedule.
#[must_use]
pub fn actor(
    net: &Net,
    forward: &Forward,
    batch: &Batch,
    targets: &Targets,
    model: &ModelConfig,
    ppo: &PpoConfig,
    entropy_weight: f64,
) -> (Loss, PolicyDiagnostics) {
    let log_probs = batch.log_softmax(&forward.scores);
    let log_ratio = log_probs.index_select(0, &targets.chosen_rows) - &targets.log_probs;
    let ratio = log_ratio.exp();
    let clipped = ratio.clamp(1.0 - ppo.clip_ratio, 1.0 + ppo.clip_ratio);
    let gain = (&ratio * &targets.advantages).minimum(&(clipped * &targets.advantages));
    let policy = -gain.mean(Kind::Float);
    let entropies = -batch.sum_over_phases(&(log_probs.exp() * &log_probs));
    let entropy = entropies.mean(Kind::Float);
    let diagnostics = tch::no_grad(|| PolicyDiagnostics {
        approx_kl: (&ratio - 1.0) - &log_ratio,
        clipped: (&ratio - 1.0).abs().gt(ppo.clip_ratio).to_kind(Kind::Float),
        entropy: entropies.detach(),
    });
    let mut total = &policy - &entropy * entropy_weight;
    let mut terms = vec![("policy", policy), ("entropy", entropy)];
    add_auxiliary(net, forward, batch, targets, model, ppo, &mut total, &mut terms);
    (Loss { terms, total, way_back: forward.way_back() }, diagnostics)
}

/// The critic's loss.
#[must_use]
pub fn critic(
    net: &Net,
    forward: &Forward,
    batch: &Batch,
    targets: &Targets,
    model: &ModelConfig,
    ppo: &PpoConfig,
) -> Loss {
    let error = values(batch, forward) - &targets.returns;
    let value = (&error * &error).mean(Kind::Float);
    let mut total = &value * ppo.value;
    let mut terms = vec![("value", value)];
    add_auxiliary(net, forward, batch, targets, model, ppo, &mut total, &mut terms);
    Loss { terms, total, way_back: forward.way_back() }
}

/// Values `[samples]`: mean of the critic's scores over each junction's phases.
pub fn values(batch: &Batch, forward: &Forward) -> Tensor {
    batch.map_groups(&forward.scores, |own| own.squeeze_dim(2).mean_dim(1, false, Kind::Float))
}

#[allow(
    clippy::too_many_arguments,
    reason = "one call each from actor and critic, whose own arguments these are"
)]
fn add_auxiliary(
    net: &Net,
    forward: &Forward,
    batch: &Batch,
    targets: &Targets,
    model: &ModelConfig,
    ppo: &PpoConfig,
    total: &mut Tensor,
    terms: &mut Vec<(&'static str, Tensor)>,
) {
    let mut add = |name: &'static str, weight: f64, term: Tensor| {
        *total = &*total + &term * weight;
        terms.push((name, term));
    };
    if let Some(pcc) = &forward.pcc {
        if let Some(prediction) = prediction(net, pcc, batch, targets) {
            add("prediction", ppo.prediction, prediction);
        }
        let target =
            if model.detach_contrastive_target { pcc.weights.detach() } else { pcc.weights.shallow_clone() };
        let log_assignment = if model.tau_c == model.tau_k {
            pcc.log_weights.shallow_clone()
        } else {
            (&pcc.similarity / model.tau_c).log_softmax(-1, Kind::Float)
        };
        let contrastive =
            -(target * log_assignment).sum_dim_intlist(-1, false, Kind::Float).mean(Kind::Float);
        add("contrastive", ppo.clustering, contrastive);
        let mean = pcc.weights.mean_dim(0, false, Kind::Float);
        let diversity: Tensor = 1.0 - entropy_of(&mean) / (model.clusters as f64).ln();
        add("diversity", ppo.clustering * ppo.diversity, diversity);
    }
    if let Some((alpha, indices)) = &forward.moe.gates {
        let usage = expert_usage(alpha, indices, model.experts);
        let uniform = 1.0 / model.experts as f64;
        let balance = (&usage * ((&usage + 1e-10) / uniform).log()).sum(Kind::Float);
        add("load_balance", ppo.load_balance, balance);
        let selection =
            -(alpha * (alpha + 1e-10).log()).sum_dim_intlist(-1, false, Kind::Float).mean(Kind::Float);
        add("selection_entropy", ppo.selection_entropy, selection);
    }
}

/// Mean square error over real entries of samples that have a next step.
fn prediction(net: &Net, pcc: &PccOutput, batch: &Batch, targets: &Targets) -> Option<Tensor> {
    let square_sum = |error: &Tensor, mask: &Tensor| (error * error * mask).sum(Kind::Float);
    let has_next = targets.has_next.unsqueeze(1);
    let (sum, count) = match &batch.inputs {
        Inputs::Paper(paper) => {
            let mask = &paper.real * has_next;
            let (next, masks) = (batch.real_columns(&targets.next), batch.real_columns(&mask));
            let predicted = net.predict_real(pcc, batch, &targets.chosen_rows)?;
            let groups = predicted.iter().zip(&next).zip(&masks);
            let sums: Vec<_> =
                groups.map(|((predicted, next), mask)| square_sum(&(predicted - next), mask)).collect();
            (Tensor::stack(&sums, 0).sum(Kind::Float), mask.sum(Kind::Float))
        }
        Inputs::Movement(_) => {
            let predicted = net.predict(pcc, &targets.chosen_rows)?;
            let width = predicted.size()[1] as f64;
            (square_sum(&(predicted - &targets.next), &has_next), has_next.sum(Kind::Float) * width)
        }
    };
    Some(sum / count.clamp_min(1.0))
}

fn entropy_of(distribution: &Tensor) -> Tensor {
    -(distribution * (distribution + 1e-10).log()).sum(Kind::Float)
}

/// Share of the gating weight that each expert received `[experts]`, sums to 1.
pub fn expert_usage(alpha: &Tensor, indices: &Tensor, experts: i64) -> Tensor {
    let zeros = Tensor::zeros([experts], (Kind::Float, alpha.device()));
    let sums = zeros.index_add(0, &indices.reshape([-1]), &alpha.reshape([-1]));
    let total = sums.sum(Kind::Float);
    sums / total
}

/// Width of a prediction target.
#[must_use]
pub fn target_width(model: &ModelConfig, sizes: &FeatureSizes) -> i64 {
    match model.gfe {
        cross_config::Gfe::Paper => sizes.state,
        cross_config::Gfe::Movement => sizes.pooled,
    }
}
