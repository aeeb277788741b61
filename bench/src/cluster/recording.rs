//! An episode, recorded once with SUMO, that every simulated actor sends over and over under its own name.

use crate::env::drive::by_policy;
use crate::env::snapshot;
use crate::error::BenchError;
use cross_config::Config;
use cross_model::Policy;
use cross_proto::v1;
use cross_sim::env::{Env, EnvOptions};
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use prost::Message;

/// What a gRPC stream puts before each message, bytes.
const PREFIX_BYTES: usize = 5;

/// The fragments of an episode, as a fresh policy acts and the actor's own recorder cuts them.
#[derive(Debug)]
pub(crate) struct Recording {
    /// In order; the last ends the episode.
    pub(crate) fragments: Vec<v1::Fragment>,
}

impl Recording {
    /// Simulates an episode.
    pub(crate) fn new(
        home: &SumoHome,
        scenario: &Scenario,
        config: &Config,
        seed: u32,
    ) -> Result<Self, BenchError> {
        cross_model::set_single_threaded();
        let mut policy = Policy::from_snapshot(&snapshot(config)?)?;
        let mut env = Env::new(home, scenario, EnvOptions::new(config.env.clone()))?;
        env.reset(seed)?;
        let mut fragments = Vec::new();
        let mut keep = |fragment| fragments.push(fragment);
        by_policy(&mut env, &mut policy, config.actor.fragment_steps, seed, &mut keep)?;
        env.finish()?;
        Ok(Self { fragments })
    }

    /// Decisions of all agents in a fragment, mean over the episode.
    pub(crate) fn decisions(&self) -> f64 {
        self.mean(|fragment| fragment.actions.len())
    }

    /// Bytes of a fragment on its stream, mean over the episode: the whole message and its prefix.
    pub(crate) fn wire_bytes(&self) -> f64 {
        self.mean(|fragment| {
            let message = v1::stream_fragments_request::Message::Fragment(fragment.clone());
            v1::StreamFragmentsRequest { message: Some(message) }.encoded_len() + PREFIX_BYTES
        })
    }

    fn mean(&self, of: impl Fn(&v1::Fragment) -> usize) -> f64 {
        self.fragments.iter().map(of).sum::<usize>() as f64 / self.fragments.len().max(1) as f64
    }

    #[cfg(test)]
    pub(crate) fn made_up(fragments: usize) -> Self {
        let fragment = |_| v1::Fragment { actions: vec![0; 4].into(), steps: 2, ..v1::Fragment::default() };
        Self { fragments: (0..fragments).map(fragment).collect() }
    }
}
