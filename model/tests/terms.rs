//! Every loss term pulls at what it is named after, and at nothing when it is switched off.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, ragged, round, tiny_config};
use cross_config::{Config, PpoConfig};
use cross_model::{Trainer, UpdateStats};
use safetensors::SafeTensors;

const UPDATES: usize = 5;

/// No term but the clipped objective.
fn bare() -> Config {
    let mut config = tiny_config();
    config.ppo = PpoConfig {
        entropy: 0.0,
        value: 0.0,
        prediction: 0.0,
        clustering: 0.0,
        load_balance: 0.0,
        selection_entropy: 0.0,
        actor_lr: 3e-3,
        critic_lr: 3e-3,
        lr_decay: false,
        ..config.ppo
    };
    config
}

/// What the last of some updates on one round says, and the trainer after it.
fn learned(config: &Config) -> (UpdateStats, Trainer) {
    cross_model::set_single_threaded();
    let mut trainer = Trainer::new(config, vec![("toy".to_owned(), ragged())]).unwrap();
    let fragments = round(&trainer, &mut Toy::new(&ragged(), config, 3), 12);
    let mut stats = UpdateStats::default();
    for _ in 0..UPDATES {
        stats = trainer.update(&fragments).unwrap();
    }
    (stats, trainer)
}

/// The values of `terms` after learning without and with `change`.
fn effect(terms: &[&str], base: &Config, change: impl Fn(&mut PpoConfig)) -> Vec<(f64, f64)> {
    let mut with = base.clone();
    change(&mut with.ppo);
    let (without, with) = (learned(base).0, learned(&with).0);
    terms.iter().map(|term| (without.losses[*term], with.losses[*term])).collect()
}

fn assert_lowered(terms: &[&str], base: &Config, change: impl Fn(&mut PpoConfig)) {
    for (term, (without, with)) in terms.iter().zip(effect(terms, base, change)) {
        assert!(with < 0.9 * without, "{term} is {without} without its weight and {with} with it");
    }
}

/// The bytes of one parameter.
fn weights(trainer: &Trainer, name: &str) -> Vec<u8> {
    let bytes = trainer.snapshot().unwrap();
    SafeTensors::deserialize(&bytes).unwrap().tensor(name).unwrap().data().to_vec()
}

fn assert_untouched(config: &Config, names: &[&str]) {
    let fresh = Trainer::new(config, vec![("toy".to_owned(), ragged())]).unwrap();
    let (_, trained) = learned(config);
    for name in names {
        assert!(weights(&fresh, name) == weights(&trained, name), "{name} moved");
    }
    // The policy did learn meanwhile.
    assert!(weights(&fresh, "actor.head.weight") != weights(&trained, "actor.head.weight"));
}

#[test]
fn the_entropy_bonus_keeps_the_policy_open() {
    let mut base = bare();
    // Unclipped and fast, the policy closes on what went well in this one round.
    (base.ppo.actor_lr, base.ppo.clip_ratio) = (2e-2, 10.0);
    for (without, with) in effect(&["actor_entropy"], &base, |ppo| ppo.entropy = 1.0) {
        assert!(with > without + 0.01, "{without} without, {with} with the bonus");
    }
}

#[test]
fn the_value_term_alone_teaches_the_critic_returns() {
    assert_lowered(&["critic_value"], &bare(), |ppo| ppo.value = 0.5);
    assert_untouched(
        &bare(),
        &["critic.head.weight", "critic.gfe.gru.weight_hh", "critic.moe.router.0.weight"],
    );
}

#[test]
fn the_prediction_term_alone_teaches_prediction() {
    assert_lowered(&["actor_prediction", "critic_prediction"], &bare(), |ppo| ppo.prediction = 1.0);
    assert_untouched(&bare(), &["actor.pcc.predict.weight", "critic.pcc.predict.weight"]);
}

#[test]
fn the_contrastive_term_makes_assignments_decisive() {
    let change = |ppo: &mut PpoConfig| (ppo.clustering, ppo.diversity) = (1.0, 0.0);
    assert_lowered(&["actor_contrastive", "critic_contrastive"], &bare(), change);
}

#[test]
fn the_diversity_term_spreads_rows_over_the_clusters() {
    let mut base = bare();
    (base.ppo.clustering, base.ppo.diversity) = (1.0, 0.0);
    assert_lowered(&["actor_diversity", "critic_diversity"], &base, |ppo| ppo.diversity = 4.0);
}

#[test]
fn load_balancing_evens_out_the_experts() {
    assert_lowered(&["actor_load_balance", "critic_load_balance"], &bare(), |ppo| ppo.load_balance = 1.0);
}

#[test]
fn selection_entropy_makes_the_router_choose() {
    let terms = ["actor_selection_entropy", "critic_selection_entropy"];
    assert_lowered(&terms, &bare(), |ppo| ppo.selection_entropy = 1.0);
}
