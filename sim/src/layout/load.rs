//! The layout of a scenario.

use super::NetworkLayout;
use crate::error::SimError;
use crate::net::Net;
use crate::scenario::Scenario;
use cross_config::EnvConfig;
use std::sync::Arc;

/// Reads a scenario's net and extracts its agents; no SUMO is needed.
///
/// # Errors
/// [`SimError::Net`] or [`SimError::Layout`].
pub fn load_layout(scenario: &Scenario, env: &EnvConfig) -> Result<Arc<NetworkLayout>, SimError> {
    Ok(read(scenario, env)?.1)
}

/// As [`load_layout`], with the net itself.
pub(crate) fn read(scenario: &Scenario, env: &EnvConfig) -> Result<(Net, Arc<NetworkLayout>), SimError> {
    let net = Net::read(&scenario.net)?;
    let layout = NetworkLayout::from_net(&net, env)?;
    let fixed = NetworkLayout::fixed_signals(&net);
    if !fixed.is_empty() {
        let lights: Vec<_> = fixed.iter().map(|signal| signal.id.as_str()).collect();
        tracing::warn!(
            scenario = %scenario.name,
            count = fixed.len(),
            ?lights,
            "traffic lights without two green phases keep their own program and are no agents"
        );
    }
    Ok((net, Arc::new(layout)))
}
