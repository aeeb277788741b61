//! What the critic is asked to learn: returns at one size for all scenarios.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, id, ragged, tiny_config};
use cross_config::{Config, ValueScale};
use cross_model::features::{FeatureSizes, NetworkSpec};
use cross_model::losses::target_width;
use cross_model::net::{Net, Role};
use cross_model::rounds::{Minibatch, Round};
use cross_model::snapshot::{self, PolicyMetadata};
use cross_model::value_scale::ValueScales;
use cross_model::{Policy, Trainer};
use cross_sim::trajectory::{Fragment, FragmentEnd};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

const STEPS: u32 = 10;

struct World {
    config: Config,
    sizes: FeatureSizes,
    nets: (Net, Net),
}

impl World {
    fn new(change: impl Fn(&mut Config)) -> Self {
        let mut config = tiny_config();
        config.ppo.sequence_steps = STEPS;
        change(&mut config);
        let sizes = FeatureSizes::new(&config.env, &config.model);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut net = |role| Net::new(role, &config.model, &sizes, &mut rng);
        let nets = (net(Role::Actor), net(Role::Critic));
        Self { config, sizes, nets }
    }

    fn play(&self, scenario: &str, episode: u64) -> Fragment {
        let metadata = PolicyMetadata {
            policy_version: 1,
            env: self.config.env.clone(),
            model: self.config.model.clone(),
        };
        let weights = snapshot::write_policy(&self.nets.0, &self.nets.1, &metadata).unwrap();
        let mut policy = Policy::from_snapshot(&weights).unwrap();
        let mut toy = Toy::new(&ragged(), &self.config, 1);
        toy.play(&mut policy, scenario, id(episode, 0), 0, STEPS, FragmentEnd::Truncated, false).0
    }

    fn minibatch(&self, fragments: &[Fragment], scales: &mut ValueScales) -> Minibatch {
        let spec = Arc::new(NetworkSpec::new(&ragged(), &self.config.env, &self.config.model).unwrap());
        let networks = vec![("calm".to_owned(), Arc::clone(&spec)), ("jam".to_owned(), spec)];
        let (model, ppo) = (&self.config.model, &self.config.ppo);
        let nets = (&self.nets.0, &self.nets.1);
        let round = Round::new(fragments, &networks, nets, &self.sizes, model.hidden, ppo, scales).unwrap();
        round.minibatch(
            &round.slices(STEPS as usize)[&(STEPS as usize)],
            &self.sizes,
            target_width(model, &self.sizes),
        )
    }
}

/// Mean and deviation of one scenario's targets.
fn spread(minibatch: &Minibatch, scenario: i64) -> (f64, f64) {
    let own = minibatch.targets.returns.masked_select(&minibatch.scenario_of_sample.eq(scenario));
    (own.mean(tch::Kind::Float).double_value(&[]), own.std(false).double_value(&[]))
}

/// The same episode twice, in one scenario with a hundred times the rewards.
fn calm_and_jam(world: &World) -> [Fragment; 2] {
    let (calm, mut jam) = (world.play("calm", 0), world.play("jam", 1));
    jam.rewards.iter_mut().for_each(|reward| *reward *= 100.0);
    [calm, jam]
}

#[test]
fn a_jam_and_a_calm_network_give_targets_of_one_size() {
    cross_model::set_single_threaded();
    let world = World::new(|_| {});
    let minibatch = world.minibatch(&calm_and_jam(&world), &mut ValueScales::default());
    for scenario in [0, 1] {
        let (mean, deviation) = spread(&minibatch, scenario);
        assert!(
            mean.abs() < 1e-4 && (deviation - 1.0).abs() < 1e-3,
            "scenario {scenario}: {mean} {deviation}"
        );
    }
    let raw = World::new(|c| c.ppo.value_scale = ValueScale::Raw);
    let mut scales = ValueScales::default();
    let minibatch = raw.minibatch(&calm_and_jam(&raw), &mut scales);
    assert!(spread(&minibatch, 1).1 > 50.0 * spread(&minibatch, 0).1);
    assert_eq!(scales, ValueScales::default(), "raw values have no scale");
}

#[test]
fn outputs_are_scaled_back_before_advantages() {
    cross_model::set_single_threaded();
    // With lambda 0 an advantage is one step's: reward + gamma V' - V, and the target is reward + gamma V'.
    let world =
        World::new(|c| (c.ppo.gae_lambda, c.ppo.gamma, c.ppo.normalise_advantages) = (0.0, 0.5, false));
    let fragments = calm_and_jam(&world);
    let mut scales = ValueScales::default();
    scales.observe("calm", [-10.0, -30.0].into_iter());
    scales.observe("jam", [-10.0, -30.0].into_iter());
    let minibatch = world.minibatch(&fragments[..1], &mut scales.clone());
    let after = {
        let mut after = scales.clone();
        world.minibatch(&fragments[..1], &mut after);
        after.of("calm")
    };
    // Fresh critics say about 0, which stands for -20 under the moments before this round.
    let returns: Vec<f32> = Vec::try_from(&minibatch.targets.returns).unwrap();
    let advantages: Vec<f32> = Vec::try_from(&minibatch.targets.advantages).unwrap();
    for (value, advantage) in returns.iter().zip(&advantages) {
        let value = after.to_return(*value);
        // The return is advantage plus value, and the value -20 plus what little the critic says times 10.
        assert!((value - (advantage - 20.0)).abs() < 3.0, "return {value}, advantage {advantage}");
    }
}

#[test]
fn a_checkpoint_with_an_impossible_scale_is_refused() {
    cross_model::set_single_threaded();
    let config = tiny_config();
    let mut trainer = Trainer::new(&config, vec![("calm".to_owned(), ragged())]).unwrap();
    let world = World::new(|_| {});
    trainer.update(&[world.play("calm", 0)]).unwrap();
    let files = trainer.save().unwrap();
    // JSON in JSON in JSON.
    let key = br#"\\\"weight\\\":"#;
    let at = files.optimizer.windows(key.len()).position(|bytes| bytes == key).unwrap() + key.len();
    let mut damaged = files.optimizer.clone();
    // A weight is below 1 after one update; equal length, and still a number.
    assert_eq!(damaged[at], b'0');
    damaged[at] = b'9';
    let refused = trainer.restore(&files.model, &damaged).unwrap_err().to_string();
    assert!(refused.contains("no run leaves"), "{refused}");
    trainer.restore(&files.model, &files.optimizer).unwrap();
}
