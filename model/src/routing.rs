//! Which experts and clusters a decision went through, for whoever wants to see the mixture at work.

use crate::features::NetworkSpec;

/// Shares at one decision, means over the phases of each agent.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Routing {
    /// Gating weight of each expert `[agents, experts]`, row-major; each row sums to 1. Empty without a mixture.
    pub experts: Vec<f32>,
    /// Assignment to each cluster `[agents, clusters]`, row-major; each row sums to 1. Empty without clustering.
    pub clusters: Vec<f32>,
}

/// Means over each agent's phases of rows `[phases of all agents, width]`.
pub(crate) fn means_by_agent(network: &NetworkSpec, rows: &[f32], width: usize) -> Vec<f32> {
    let mut means = vec![0.0; if rows.is_empty() { 0 } else { network.agents.len() * width }];
    let mut rest = rows.chunks_exact(width.max(1));
    for (agent, mean) in network.agents.iter().zip(means.chunks_exact_mut(width.max(1))) {
        for row in rest.by_ref().take(agent.phases) {
            for (sum, share) in mean.iter_mut().zip(row) {
                *sum += share / agent.phases as f32;
            }
        }
    }
    means
}
