//! Multi-scenario recurrent PPO (paper, section IV-D): owns both networks and their optimisers.

use crate::adam::{Adam, zero_gradients};
use crate::error::ModelError;
use crate::features::{FeatureSizes, NetworkSpec};
use crate::losses::{self, Loss};
use crate::net::{Forward, Net, Role};
use crate::rounds::{Minibatch, Networks, Round, Slice};
use crate::snapshot::{self, File, OPTIMIZER_FORMAT, PolicyMetadata};
use cross_config::{Config, EntropySchedule};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::Fragment;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;
use tch::{Kind, Tensor};

/// What the linear schedules fall to, as a share of the start.
const SCHEDULE_FLOOR: f64 = 0.1;

/// Bytes from which a trainer resumes exactly.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrainerFiles {
    /// Policy file: weights of both networks. Also what evaluation reads.
    pub model: Vec<u8>,
    /// Adam's moments and steps, random generator, counters.
    pub optimizer: Vec<u8>,
}

/// What an update did, for logs and metrics.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct UpdateStats {
    /// Mean of every loss term over the minibatches, before its weight; names start with `actor_` or `critic_`.
    pub losses: BTreeMap<String, f64>,
    /// `approx_kl`, `clip_fraction`, `explained_variance`, gradient norms, learning rates.
    pub diagnostics: BTreeMap<String, f64>,
    /// Share of the gating weight per expert of the actor network.
    pub expert_usage: Vec<f64>,
    /// Mean assignment per cluster of the actor network.
    pub cluster_usage: Vec<f64>,
    /// Agent-decisions learned from.
    pub decisions: u64,
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
    rng: ChaCha8Rng,
    updates: u64,
}

/// Sums over minibatches that become means.
#[derive(Default)]
struct Means {
    sums: BTreeMap<String, f64>,
    experts: Vec<f64>,
    clusters: Vec<f64>,
    count: f64,
}

impl Trainer {
    /// Fresh weights from the configuration's seed.
    ///
    /// # Errors
    /// [`ModelError::TooLarge`] if a scenario exceeds the model's limits.
    pub fn new(config: &Config, layouts: Vec<(String, Arc<NetworkLayout>)>) -> Result<Self, ModelError> {
        let sizes = FeatureSizes::new(&config.env, &config.model);
        let mut networks = Networks::with_capacity(layouts.len());
        for (name, layout) in layouts {
            networks.push((name, Arc::new(NetworkSpec::new(&layout, &config.env, &config.model)?)));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let actor = Net::new(Role::Actor, &config.model, &sizes, &mut rng);
        let critic = Net::new(Role::Critic, &config.model, &sizes, &mut rng);
        let (actor_adam, critic_adam) = (Adam::new(actor.params()), Adam::new(critic.params()));
        Ok(Self {
            config: config.clone(),
            sizes,
            networks,
            actor,
            critic,
            actor_adam,
            critic_adam,
            rng,
            updates: 0,
        })
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
        match self.try_update(fragments) {
            Ok(stats) => {
                self.updates += 1;
                Ok(stats)
            }
            Err(error) => {
                self.restore(&before.model, &before.optimizer)?;
                Err(error)
            }
        }
    }

    fn try_update(&mut self, fragments: &[Fragment]) -> Result<UpdateStats, ModelError> {
        let ppo = self.config.ppo.clone();
        let nets = (&self.actor, &self.critic);
        let round = Round::new(fragments, &self.networks, nets, &self.sizes, self.config.model.hidden, &ppo)?;
        let slices = round.slices(ppo.sequence_steps as usize);
        let target = losses::target_width(&self.config.model, &self.sizes);
        let mut means = Means::default();
        for _ in 0..ppo.epochs {
            for chunk in self.minibatches(&slices) {
                let minibatch = round.minibatch(&chunk, &self.sizes, target);
                self.learn(&minibatch, &mut means)?;
            }
        }
        let mut stats = means.finish();
        stats.decisions = round.decisions();
        stats.diagnostics.insert("explained_variance".to_owned(), round.explained_variance());
        stats.diagnostics.insert("actor_lr".to_owned(), ppo.actor_lr * self.lr_factor());
        stats.diagnostics.insert("critic_lr".to_owned(), ppo.critic_lr * self.lr_factor());
        stats.diagnostics.insert("entropy_weight".to_owned(), self.entropy_weight());
        Ok(stats)
    }

    /// Shuffled sequences in minibatches of one length each.
    fn minibatches(&mut self, slices: &BTreeMap<usize, Vec<Slice>>) -> Vec<Vec<Slice>> {
        let mut out = Vec::new();
        for (&steps, own) in slices {
            let mut own = own.clone();
            own.shuffle(&mut self.rng);
            // Equal sizes, each as near the configured one as a whole number of minibatches allows.
            let decisions = own.len() * steps;
            let count = (decisions / self.config.ppo.minibatch_decisions as usize).max(1);
            out.extend(own.chunks(own.len().div_ceil(count)).map(<[Slice]>::to_vec));
        }
        out.shuffle(&mut self.rng);
        out
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
        means.count += 1.0;
        means.add_loss("actor", &loss);
        means.add("approx_kl", diagnostics.approx_kl);
        means.add("clip_fraction", diagnostics.clip_fraction);
        means.add("actor_grad_norm", norm);
        means.add_usage(&forward, model.experts);

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
        let metadata = snapshot::Metadata::from([
            ("format".to_owned(), OPTIMIZER_FORMAT.to_owned()),
            ("format_version".to_owned(), snapshot::FORMAT_VERSION.to_owned()),
            ("updates".to_owned(), self.updates.to_string()),
            ("rng".to_owned(), rng),
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
        let steps: (u64, u64) = (file.value("actor_t")?, file.value("critic_t")?);
        if metadata.policy_version != updates + 1 {
            return Err(ModelError::Mismatch {
                what: "checkpoint",
                reason: format!(
                    "its weights are of version {} and its optimizer of update {updates}",
                    metadata.policy_version
                ),
            });
        }
        snapshot::load_weights(model, &self.actor, &self.critic)?;
        for (name, moment) in self.moments() {
            file.copy_into(&name, moment)?;
        }
        (self.actor_adam.t, self.critic_adam.t) = steps;
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
    if !loss.total.double_value(&[]).is_finite() {
        return Err(ModelError::NotFinite(what));
    }
    loss.total.f_backward()?;
    let norm = adam.step(net.params(), lr, max_norm);
    if norm.is_finite() { Ok(norm) } else { Err(ModelError::NotFinite(what)) }
}

impl Means {
    fn add(&mut self, name: &str, value: f64) {
        *self.sums.entry(name.to_owned()).or_default() += value;
    }

    fn add_loss(&mut self, network: &str, loss: &Loss) {
        self.add(&format!("loss/{network}_total"), loss.total.double_value(&[]));
        for (name, term) in &loss.terms {
            self.add(&format!("loss/{network}_{name}"), term.double_value(&[]));
        }
    }

    fn add_usage(&mut self, forward: &Forward, experts: i64) {
        tch::no_grad(|| {
            if let Some((alpha, indices)) = &forward.moe.gates {
                accumulate(&mut self.experts, &losses::expert_usage(alpha, indices, experts));
            }
            if let Some(pcc) = &forward.pcc {
                accumulate(&mut self.clusters, &pcc.weights.mean_dim(0, false, Kind::Float));
            }
        });
    }

    fn finish(self) -> UpdateStats {
        let count = self.count.max(1.0);
        let mut stats = UpdateStats {
            expert_usage: self.experts.iter().map(|v| v / count).collect(),
            cluster_usage: self.clusters.iter().map(|v| v / count).collect(),
            ..UpdateStats::default()
        };
        for (name, sum) in self.sums {
            match name.strip_prefix("loss/") {
                Some(term) => stats.losses.insert(term.to_owned(), sum / count),
                None => stats.diagnostics.insert(name, sum / count),
            };
        }
        stats
    }
}

fn accumulate(sums: &mut Vec<f64>, values: &Tensor) {
    let values = crate::policy::floats(values);
    sums.resize(values.len(), 0.0);
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += f64::from(value);
    }
}
