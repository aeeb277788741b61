//! The losses on padded outputs: every mean over phases is a masked one (paper, sections IV-B to IV-D).

use super::net::PlainForward;
use super::padded::{PaddedInputs, PaddedMinibatch};
use cross_config::{ModelConfig, PpoConfig};
use tch::{Kind, Tensor};

/// The actor's loss before the terms' weights, by name, and their weighted sum.
pub fn actor(
    forward: &PlainForward,
    batch: &PaddedMinibatch,
    model: &ModelConfig,
    ppo: &PpoConfig,
) -> (Tensor, Vec<(&'static str, Tensor)>) {
    let padding = batch.phase_mask.logical_not();
    let log_policy = forward.scores.masked_fill(&padding, f64::NEG_INFINITY).log_softmax(-1, Kind::Float);
    let taken = log_policy.gather(2, &batch.actions.unsqueeze(2), false).squeeze_dim(2);
    let ratio = (taken - &batch.log_probs).exp();
    let clipped = ratio.clamp(1.0 - ppo.clip_ratio, 1.0 + ppo.clip_ratio);
    let policy = -(ratio * &batch.advantages).minimum(&(clipped * &batch.advantages)).mean(Kind::Float);
    // Of padding the probability is zero and its logarithm has no finite value.
    let finite = log_policy.masked_fill(&padding, 0.0);
    let entropy = -(log_policy.exp() * finite).sum_dim_intlist(-1, false, Kind::Float).mean(Kind::Float);
    let mut terms = vec![("policy", policy), ("entropy", entropy)];
    add_auxiliary(forward, batch, model, &mut terms);
    (total(&terms, ppo), terms)
}

/// The critic's.
pub fn critic(
    forward: &PlainForward,
    batch: &PaddedMinibatch,
    model: &ModelConfig,
    ppo: &PpoConfig,
) -> (Tensor, Vec<(&'static str, Tensor)>) {
    let real = batch.phase_mask.to_kind(Kind::Float);
    let sum = (&forward.scores * &real).sum_dim_intlist(-1, false, Kind::Float);
    let error = sum / real.sum_dim_intlist(-1, false, Kind::Float) - &batch.returns;
    let mut terms = vec![("value", (&error * &error).mean(Kind::Float))];
    add_auxiliary(forward, batch, model, &mut terms);
    (total(&terms, ppo), terms)
}

fn total(terms: &[(&'static str, Tensor)], ppo: &PpoConfig) -> Tensor {
    let weight = |name: &str| match name {
        "entropy" => -ppo.entropy,
        "value" => ppo.value,
        "prediction" => ppo.prediction,
        "contrastive" => ppo.clustering,
        "diversity" => ppo.clustering * ppo.diversity,
        "load_balance" => ppo.load_balance,
        "selection_entropy" => ppo.selection_entropy,
        _ => 1.0,
    };
    let weighted: Vec<Tensor> = terms.iter().map(|(name, term)| term * weight(name)).collect();
    Tensor::stack(&weighted, 0).sum(Kind::Float)
}

fn add_auxiliary(
    forward: &PlainForward,
    batch: &PaddedMinibatch,
    model: &ModelConfig,
    terms: &mut Vec<(&'static str, Tensor)>,
) {
    let real = batch.phase_mask.to_kind(Kind::Float);
    let count = real.sum(Kind::Float);
    let mean = |per_phase: Tensor| (per_phase * &real).sum(Kind::Float) / &count;
    if let Some(pcc) = &forward.pcc {
        let target = pcc.predicted.size()[3];
        let taken =
            batch.actions.view([batch.sequences, batch.steps, 1, 1]).expand([-1, -1, 1, target], false);
        let error = pcc.predicted.gather(2, &taken, false).squeeze_dim(2) - &batch.next;
        let has_next = batch.has_next.unsqueeze(2);
        let mask = match &batch.inputs {
            PaddedInputs::Paper { real, .. } => real * has_next,
            PaddedInputs::Movement { .. } => has_next.expand_as(&error),
        };
        let square = (&error * &error * &mask).sum(Kind::Float);
        terms.push(("prediction", square / mask.sum(Kind::Float).clamp_min(1.0)));
        let aim =
            if model.detach_contrastive_target { pcc.weights.detach() } else { pcc.weights.shallow_clone() };
        let log_assignment = (&pcc.similarity / model.tau_c).log_softmax(-1, Kind::Float);
        let contrastive = -mean((aim * log_assignment).sum_dim_intlist(-1, false, Kind::Float));
        terms.push(("contrastive", contrastive));
        let used = masked_sum(&pcc.weights, &real) / &count;
        let entropy = -(&used * (&used + 1e-10).log()).sum(Kind::Float);
        terms.push(("diversity", 1.0 - entropy / (model.clusters as f64).ln()));
    }
    if let Some(alpha) = &forward.alpha {
        let sums = masked_sum(alpha, &real);
        let usage = &sums / sums.sum(Kind::Float);
        let uniform = 1.0 / model.experts as f64;
        terms.push(("load_balance", (&usage * ((&usage + 1e-10) / uniform).log()).sum(Kind::Float)));
        let entropy = -(alpha * (alpha + 1e-10).log()).sum_dim_intlist(-1, false, Kind::Float);
        terms.push(("selection_entropy", mean(entropy)));
    }
}

/// `[B, L, P, w]` summed over real phases `[w]`.
fn masked_sum(x: &Tensor, real: &Tensor) -> Tensor {
    (x * real.unsqueeze(-1)).sum_dim_intlist([0, 1, 2].as_slice(), false, Kind::Float)
}
