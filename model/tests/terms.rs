//! Every loss term pulls at what it is named after, and at nothing when it is switched off.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, ragged, round, tiny_config};
use cross_config::{Config, PpoConfig};
use cross_model::{Trainer, UpdateStats};
use safetensors::SafeTensors;
use std::sync::LazyLock;

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

/// Some updates on one round.
struct Learned {
    /// What the last one said.
    stats: UpdateStats,
    /// Policy files before and after.
    before: Vec<u8>,
    after: Vec<u8>,
}

/// [`bare`], which most tests compare with.
static BARE: LazyLock<Learned> = LazyLock::new(|| learn(&bare()));

fn learn(config: &Config) -> Learned {
    cross_model::set_single_threaded();
    let mut trainer = Trainer::new(config, vec![("toy".to_owned(), ragged())]).unwrap();
    let fragments = round(&trainer, &mut Toy::new(&ragged(), config, 3), 12);
    let before = trainer.snapshot().unwrap();
    let mut stats = UpdateStats::default();
    for _ in 0..UPDATES {
        stats = trainer.update(&fragments).unwrap();
    }
    Learned { stats, before, after: trainer.snapshot().unwrap() }
}

/// With `change` every one of `terms` ends lower than in `base`, of which `without` is what was learned.
fn assert_lowered(terms: &[&str], base: &Config, without: &Learned, change: impl Fn(&mut PpoConfig)) {
    let mut with = base.clone();
    change(&mut with.ppo);
    let with = learn(&with);
    for term in terms {
        let (without, with) = (without.stats.losses[*term], with.stats.losses[*term]);
        assert!(with < 0.9 * without, "{term} is {without} without its weight and {with} with it");
    }
}

/// The bytes of one parameter.
fn weights<'a>(file: &'a [u8], name: &str) -> &'a [u8] {
    SafeTensors::deserialize(file).unwrap().tensor(name).unwrap().data()
}

/// Nothing but the clipped objective taught, and it taught none of these.
fn assert_untouched(names: &[&str]) {
    for name in names {
        assert!(weights(&BARE.before, name) == weights(&BARE.after, name), "{name} moved");
    }
    let head = "actor.head.weight";
    assert!(weights(&BARE.before, head) != weights(&BARE.after, head), "the policy did not learn");
}

#[test]
fn the_entropy_bonus_keeps_the_policy_open() {
    let mut base = bare();
    // Unclipped and fast, the policy closes on what went well in this one round.
    (base.ppo.actor_lr, base.ppo.clip_ratio) = (2e-2, 10.0);
    let without = learn(&base).stats.losses["actor_entropy"];
    base.ppo.entropy = 1.0;
    let with = learn(&base).stats.losses["actor_entropy"];
    assert!(with > without + 0.1, "{without} without, {with} with the bonus");
}

#[test]
fn the_value_term_alone_teaches_the_critic_returns() {
    assert_lowered(&["critic_value"], &bare(), &BARE, |ppo| ppo.value = 0.5);
    assert_untouched(&["critic.head.weight", "critic.gfe.gru.weight_hh", "critic.moe.router.0.weight"]);
}

#[test]
fn the_prediction_term_alone_teaches_prediction() {
    let terms = ["actor_prediction", "critic_prediction"];
    assert_lowered(&terms, &bare(), &BARE, |ppo| ppo.prediction = 1.0);
    assert_untouched(&["actor.pcc.predict.weight", "critic.pcc.predict.weight"]);
}

#[test]
fn contrast_makes_assignments_decisive_and_diversity_spreads_them() {
    let mut contrast = bare();
    (contrast.ppo.clustering, contrast.ppo.diversity) = (1.0, 0.0);
    let terms = ["actor_contrastive", "critic_contrastive"];
    assert_lowered(&terms, &bare(), &BARE, |ppo| *ppo = contrast.ppo.clone());
    let terms = ["actor_diversity", "critic_diversity"];
    assert_lowered(&terms, &contrast, &learn(&contrast), |ppo| ppo.diversity = 4.0);
}

#[test]
fn load_balancing_evens_out_the_experts() {
    let terms = ["actor_load_balance", "critic_load_balance"];
    assert_lowered(&terms, &bare(), &BARE, |ppo| ppo.load_balance = 1.0);
}

#[test]
fn selection_entropy_makes_the_router_choose() {
    let terms = ["actor_selection_entropy", "critic_selection_entropy"];
    assert_lowered(&terms, &bare(), &BARE, |ppo| ppo.selection_entropy = 1.0);
}
