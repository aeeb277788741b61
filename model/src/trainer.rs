//! Multi-scenario recurrent PPO (paper, section IV-D): owns both networks and their optimisers.

use crate::adam::{Adam, zero_gradients};
use crate::error::ModelError;
use crate::features::{FeatureSizes, NetworkSpec};
use crate::guard::guarded;
use crate::losses::{self, Loss};
use crate::net::{Net, Role};
use crate::placement::Placement;
use crate::rounds::{Minibatch, Networks, Round};
use crate::snapshot::{self, File, OPTIMIZER_FORMAT, PolicyMetadata};
use crate::stats::{Means, UpdateStats};
use crate::value_scale::ValueScales;
use cross_config::{Config, EntropySchedule, ValueScale};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::Fragment;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use tch::Tensor;

/// What the linear schedules fall to, as a share of the start.
const SCHEDULE_FLOOR: f64 = 0.1;

/// Bytes from which a trainer resumes exactly.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrainerFiles {
    /// Policy file: weights of both networks. Also what evaluation reads.
    pub model: Vec<u8>,
    /// Adam's moments and steps, random generator, counters, sizes of values.
    pub optimizer: Vec<u8>,
}

/// The learner's model. Owned by one thread.
#[derive(Debug)]
pub struct Trainer {
    config: Config,
    sizes: FeatureSizes,
    networks: Networks,
    actor: Net,
    critic: Net,
    actor_adam: Adam,
    critic_adam: Adam,
    value_scales: ValueScales,
    rng: ChaCha8Rng,
    updates: u64,
    placement: Placement,
}

impl Trainer {
    /// Fresh weights from the configuration's seed, on the device that it names.
    ///
    /// # Errors
    /// [`ModelError::TooLarge`] or [`ModelError::TooManyRoads`] if a scenario exceeds the model's limits,
    /// [`ModelError::NoCuda`] or [`ModelError::NoBf16`] if the machine lacks what the configuration asks for.
    pub fn new(config: &Config, layouts: Vec<(String, Arc<NetworkLayout>)>) -> Result<Self, ModelError> {
        Self::placed(config, layouts, Placement::resolve(&config.learner)?)
    }

    /// As [`Trainer::new`], wherever the configuration would put it.
    ///
    /// # Errors
    /// As [`Trainer::new`], but for the machine.
    pub fn placed(
        config: &Config,
        layouts: Vec<(String, Arc<NetworkLayout>)>,
        placement: Placement,
    ) -> Result<Self, ModelError> {
        let sizes = FeatureSizes::new(&config.env, &config.model);
        let mut networks = Networks::with_capacity(layouts.len());
        for (name, layout) in layouts {
            networks.push((name, Arc::new(NetworkSpec::new(&layout, &config.env, &config.model)?)));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let actor = Net::placed(Role::Actor, &config.model, &sizes, &mut rng, placement);
        let critic = Net::placed(Role::Critic, &config.model, &sizes, &mut rng, placement);
        let (actor_adam, critic_adam) = (Adam::new(actor.params()), Adam::new(critic.params()));
        Ok(Self {
            config: config.clone(),
            sizes,
            networks,
            actor,
            critic,
            actor_adam,
            critic_adam,
            value_scales: ValueScales::default(),
            rng,
            updates: 0,
            placement,
        })
    }

    /// Where and in which precision updates are computed.
    #[must_use]
    pub fn placement(&self) -> Placement {
        self.placement
    }

    /// Updates made, over all resumptions.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Version of the weights: 1 for fresh ones, one more with every update.
    #[must_use]
    pub fn policy_version(&self) -> u64 {
        self.updates + 1
    }

    /// Parameters (scalars) of actor and critic.
    #[must_use]
    pub fn parameters(&self) -> (usize, usize) {
        (self.actor.params().scalars(), self.critic.params().scalars())
    }

    /// One PPO update on a round of fragments.
    ///
    /// # Errors
    /// [`ModelError`] if a fragment does not fit or a loss is not finite; weights, optimisers and generator are then as
    /// they were before.
    pub fn update(&mut self, fragments: &[Fragment]) -> Result<UpdateStats, ModelError> {
        if fragments.is_empty() {
            return Err(ModelError::Empty);
        }
        let before = self.save()?;
        match guarded(|| self.try_update(fragments)) {
            Ok(stats) => {
                self.updates += 1;
                Ok(stats)
            }
            Err(error) => {
                // Also guarded: a GPU that failed may fail again.
                guarded(|| self.restore(&before.model, &before.optimizer))?;
                Err(error)
            }
        }
    }

    fn try_update(&mut self, fragments: &[Fragment]) -> Result<UpdateStats, ModelError> {
        let ppo = self.config.ppo.clone();
        let nets = (&self.actor, &self.critic);
        let hidden = self.config.model.hidden;
        let round =
            Round::new(fragments, &self.networks, nets, &self.sizes, hidden, &ppo, &mut self.value_scales)?;
        let target = losses::target_width(&self.config.model, &self.sizes);
        let mut means = Means::new(self.networks.len());
        for _ in 0..ppo.epochs {
            for chunk in round.minibatches(&ppo, &mut self.rng) {
                let minibatch = round.minibatch(&chunk, &self.sizes, target).to_device(self.placement.device);
                self.learn(&minibatch, &mut means)?;
            }
        }
        let mut stats = means.finish(self.networks.iter().map(|(name, _)| name.as_str()));
        stats.decisions = round.decisions();
        stats.diagnostics.insert("explained_variance".to_owned(), round.explained_variance());
        for (scenario, (name, _)) in self.networks.iter().enumerate() {
            if let Some(own) = stats.scenarios.get_mut(name) {
                let explained = round.explained_variance_of(scenario);
                own.diagnostics.insert("explained_variance".to_owned(), explained);
            }
        }
        stats.diagnostics.insert("actor_lr".to_owned(), ppo.actor_lr * self.lr_factor());
        stats.diagnostics.insert("critic_lr".to_owned(), ppo.critic_lr * self.lr_factor());
        stats.diagnostics.insert("entropy_weight".to_owned(), self.entropy_weight());
        Ok(stats)
    }

    fn learn(&mut self, minibatch: &Minibatch, means: &mut Means) -> Result<(), ModelError> {
        let (model, ppo) = (&self.config.model, &self.config.ppo);
        let batch = &minibatch.batch;

        zero_gradients(self.actor.params());
        let forward = self.actor.forward(batch, &minibatch.actor_state);
        let (loss, diagnostics) = losses::actor(
            &self.actor,
            &forward,
            batch,
            &minibatch.targets,
            model,
            ppo,
            self.entropy_weight(),
        );
        let lr = ppo.actor_lr * self.lr_factor();
        let norm = descend(&loss, &self.actor, &mut self.actor_adam, lr, ppo.max_grad_norm, "actor's loss")?;
        means.begin();
        means.add_loss("actor", &loss);
        means.add("actor_grad_norm", norm);
        let scenario_of_row = batch.repeat_over_phases(&minibatch.scenario_of_sample);
        means.add_policy(
            &forward,
            &diagnostics,
            &minibatch.scenario_of_sample,
            &scenario_of_row,
            model.experts,
        );

        zero_gradients(self.critic.params());
        let forward = self.critic.forward(batch, &minibatch.critic_state);
        let loss = losses::critic(&self.critic, &forward, batch, &minibatch.targets, model, ppo);
        let lr = ppo.critic_lr * self.lr_factor();
        let norm =
            descend(&loss, &self.critic, &mut self.critic_adam, lr, ppo.max_grad_norm, "critic's loss")?;
        means.add_loss("critic", &loss);
        means.add("critic_grad_norm", norm);
        Ok(())
    }

    /// Share of the run that is done, 0 to 1.
    fn progress(&self) -> f64 {
        (self.updates as f64 / self.config.updates.max(1) as f64).min(1.0)
    }

    fn lr_factor(&self) -> f64 {
        if self.config.ppo.lr_decay { 1.0 - (1.0 - SCHEDULE_FLOOR) * self.progress() } else { 1.0 }
    }

    fn entropy_weight(&self) -> f64 {
        match self.config.ppo.entropy_schedule {
            EntropySchedule::Constant => self.config.ppo.entropy,
            EntropySchedule::Linear => {
                self.config.ppo.entropy * (1.0 - (1.0 - SCHEDULE_FLOOR) * self.progress())
            }
        }
    }

    /// The policy file of the present weights.
    ///
    /// # Errors
    /// [`ModelError`] if it cannot be serialised.
    pub fn snapshot(&self) -> Result<Vec<u8>, ModelError> {
        let metadata = PolicyMetadata {
            policy_version: self.policy_version(),
            env: self.config.env.clone(),
            model: self.config.model.clone(),
        };
        snapshot::write_policy(&self.actor, &self.critic, &metadata)
    }

    /// Everything that [`Trainer::restore`] needs.
    ///
    /// # Errors
    /// As [`Trainer::snapshot`].
    pub fn save(&self) -> Result<TrainerFiles, ModelError> {
        // Plain data serialises.
        let rng = serde_json::to_string(&self.rng).expect("a generator serialises");
        let value_scales = serde_json::to_string(&self.value_scales).expect("sums serialise");
        let metadata = snapshot::Metadata::from([
            ("format".to_owned(), OPTIMIZER_FORMAT.to_owned()),
            ("format_version".to_owned(), snapshot::OPTIMIZER_FORMAT_VERSION.to_owned()),
            ("updates".to_owned(), self.updates.to_string()),
            ("rng".to_owned(), rng),
            ("value_scales".to_owned(), value_scales),
            ("actor_t".to_owned(), self.actor_adam.t.to_string()),
            ("critic_t".to_owned(), self.critic_adam.t.to_string()),
        ]);
        let optimizer = snapshot::write(self.moments(), &metadata)?;
        Ok(TrainerFiles { model: self.snapshot()?, optimizer })
    }

    fn moments(&self) -> impl Iterator<Item = (String, &Tensor)> {
        [(&self.actor, &self.actor_adam), (&self.critic, &self.critic_adam)].into_iter().flat_map(
            |(net, adam)| {
                net.params().iter().zip(adam.m.iter().zip(&adam.v)).flat_map(|((name, _), (m, v))| {
                    [(format!("{name}.adam_m"), m), (format!("{name}.adam_v"), v)]
                })
            },
        )
    }

    /// Takes up exactly where [`Trainer::save`] was called.
    ///
    /// # Errors
    /// [`ModelError`] if a file is damaged, foreign, or of another configuration.
    pub fn restore(&mut self, model: &[u8], optimizer: &[u8]) -> Result<(), ModelError> {
        let metadata = snapshot::read_metadata(model)?;
        if metadata.model != self.config.model || metadata.env != self.config.env {
            return Err(ModelError::Mismatch {
                what: "checkpoint",
                reason: "its env or model section differs from this run's; resume with the configuration it was made with"
                    .to_owned(),
            });
        }
        let file = File::read(optimizer, OPTIMIZER_FORMAT, "optimizer state")?;
        let updates: u64 = file.value("updates")?;
        let rng: ChaCha8Rng = file.json("rng")?;
        let value_scales: ValueScales = file.json("value_scales")?;
        if !value_scales.is_sound() {
            return Err(ModelError::Mismatch {
                what: "optimizer state",
                reason: "its value_scales hold a number that no run leaves".to_owned(),
            });
        }
        let steps: (u64, u64) = (file.value("actor_t")?, file.value("critic_t")?);
        if updates.checked_add(1) != Some(metadata.policy_version) {
            return Err(ModelError::Mismatch {
                what: "checkpoint",
                reason: format!(
                    "its weights are of version {} and its optimizer of update {updates}",
                    metadata.policy_version
                ),
            });
        }
        // The critic's outputs are of the size that it has learned.
        let scaled = self.config.ppo.value_scale == ValueScale::Scenario;
        if updates > 0 && scaled == value_scales.is_empty() {
            return Err(ModelError::Mismatch {
                what: "checkpoint",
                reason: "its run has another ppo.value_scale; resume with the one that it was begun with"
                    .to_owned(),
            });
        }
        snapshot::load_weights(model, &self.actor, &self.critic)?;
        for (name, moment) in self.moments() {
            file.copy_into(&name, moment)?;
        }
        (self.actor_adam.t, self.critic_adam.t) = steps;
        self.value_scales = value_scales;
        self.rng = rng;
        self.updates = updates;
        Ok(())
    }
}

/// Backward pass and one step; an error if either is not finite.
fn descend(
    loss: &Loss,
    net: &Net,
    adam: &mut Adam,
    lr: f64,
    max_norm: f64,
    what: &'static str,
) -> Result<f64, ModelError> {
    if !loss.total().double_value(&[]).is_finite() {
        return Err(ModelError::NotFinite(what));
    }
    loss.backward()?;
    let norm = adam.step(net.params(), lr, max_norm);
    if norm.is_finite() { Ok(norm) } else { Err(ModelError::NotFinite(what)) }
}
