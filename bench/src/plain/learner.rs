//! PPO's epochs with the plain networks.

use super::losses;
use super::net::PlainNet;
use super::padded::PaddedMinibatch;
use cross_config::Config;
use cross_model::adam::{Adam, zero_gradients};
use cross_model::features::{FeatureSizes, NetworkSpec};
use cross_model::net::{Net, Role};
use cross_model::rounds::{Networks, Round};
use cross_model::value_scale::ValueScales;
use cross_model::{ModelError, losses::target_width, snapshot};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::Fragment;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use tch::Tensor;

/// Actor and critic in plain form with their optimisers: an update as `Trainer` makes it, schedules and statistics apart.
#[derive(Debug)]
pub struct PlainLearner {
    config: Config,
    sizes: FeatureSizes,
    networks: Networks,
    actor: Side,
    critic: Side,
    value_scales: ValueScales,
    rng: ChaCha8Rng,
}

/// One network: its parameters, the plain form over them, and its optimiser.
#[derive(Debug)]
struct Side {
    net: Net,
    plain: PlainNet,
    adam: Adam,
    lr: f64,
}

impl PlainLearner {
    /// A learner that starts from a policy file's weights.
    ///
    /// # Errors
    /// [`ModelError`] if the file is of another configuration, or a scenario exceeds the model's limits.
    pub fn new(
        config: &Config,
        layouts: Vec<(String, Arc<NetworkLayout>)>,
        policy: &[u8],
    ) -> Result<Self, ModelError> {
        let sizes = FeatureSizes::new(&config.env, &config.model);
        let mut networks = Networks::with_capacity(layouts.len());
        for (name, layout) in layouts {
            networks.push((name, Arc::new(NetworkSpec::new(&layout, &config.env, &config.model)?)));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let actor = Net::new(Role::Actor, &config.model, &sizes, &mut rng);
        let critic = Net::new(Role::Critic, &config.model, &sizes, &mut rng);
        snapshot::load_weights(policy, &actor, &critic)?;
        let side = |net: Net, lr| Side {
            plain: PlainNet::new(&net, &config.model),
            adam: Adam::new(net.params()),
            net,
            lr,
        };
        Ok(Self {
            sizes,
            networks,
            actor: side(actor, config.ppo.actor_lr),
            critic: side(critic, config.ppo.critic_lr),
            value_scales: ValueScales::default(),
            config: config.clone(),
            rng,
        })
    }

    /// Weights of both networks by name.
    pub fn weights(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.actor.net.params().iter().chain(self.critic.net.params().iter())
    }

    /// One update: `epochs` passes over the fragments.
    ///
    /// # Errors
    /// [`ModelError`] if a fragment does not fit or a loss is not finite.
    pub fn update(&mut self, fragments: &[Fragment], epochs: u32) -> Result<(), ModelError> {
        let (model, ppo) = (&self.config.model, &self.config.ppo);
        let nets = (&self.actor.net, &self.critic.net);
        let scales = &mut self.value_scales;
        let round = Round::new(fragments, &self.networks, nets, &self.sizes, model.hidden, ppo, scales)?;
        let target = target_width(model, &self.sizes);
        for _ in 0..epochs {
            for slices in round.minibatches(ppo, &mut self.rng) {
                let packed = round.minibatch(&slices, &self.sizes, target);
                let batch = PaddedMinibatch::new(&packed, &self.config.env);
                let forward = self.actor.plain.forward(&batch, &batch.actor_state);
                let loss = losses::actor(&forward, &batch, model, ppo).0;
                self.actor.descend(&loss, ppo.max_grad_norm, "actor's loss")?;
                let forward = self.critic.plain.forward(&batch, &batch.critic_state);
                let loss = losses::critic(&forward, &batch, model, ppo).0;
                self.critic.descend(&loss, ppo.max_grad_norm, "critic's loss")?;
            }
        }
        Ok(())
    }
}

impl Side {
    fn descend(&mut self, loss: &Tensor, max_norm: f64, what: &'static str) -> Result<(), ModelError> {
        zero_gradients(self.net.params());
        loss.f_backward()?;
        let norm = self.adam.step(self.net.params(), self.lr, max_norm);
        if norm.is_finite() { Ok(()) } else { Err(ModelError::NotFinite(what)) }
    }
}
