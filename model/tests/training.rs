//! PPO and the losses on a toy network: what must improve improves, what is switched off makes a difference, and a
//! restored trainer goes on exactly.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, id, ragged, round, tiny_config};
use cross_config::{Config, Detection, Gfe, RewardScale, ValueScale};
use cross_model::{ModelError, Policy, Trainer, snapshot};
use cross_sim::trajectory::FragmentEnd;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

fn trainer(config: &Config) -> Trainer {
    cross_model::set_single_threaded();
    Trainer::new(config, vec![("toy".to_owned(), ragged())]).unwrap()
}

fn learned_loss(config: &Config) -> (f32, f32) {
    let layout = ragged();
    let mut trainer = trainer(config);
    let mut toy = Toy::new(&layout, config, config.seed);
    let judge = |trainer: &Trainer| {
        let mut policy = Policy::from_snapshot(&trainer.snapshot().unwrap()).unwrap();
        let mut toy = Toy::new(&layout, config, 1000);
        toy.play(&mut policy, "toy", id(0, 0), 0, 40, FragmentEnd::Truncated, true).1
    };
    let before = judge(&trainer);
    for _ in 0..config.updates {
        let fragments = round(&trainer, &mut toy, 30);
        trainer.update(&fragments).unwrap();
    }
    (before, judge(&trainer))
}

#[test]
fn serving_the_longest_queue_is_learned_from_five_of_five_seeds() {
    for seed in 1..=5 {
        let mut config = tiny_config();
        config.seed = seed;
        config.updates = 15;
        config.ppo.gamma = 0.0;
        config.ppo.actor_lr = 5e-3;
        config.ppo.critic_lr = 5e-3;
        let (before, after) = learned_loss(&config);
        assert!(after < 0.25 * before, "seed {seed}: lost {before} a decision before, {after} after");
    }
}

#[test]
fn every_variant_trains() {
    let mut variants: Vec<(&str, Config)> = Vec::new();
    let mut with = |name, change: fn(&mut Config)| {
        let mut config = tiny_config();
        change(&mut config);
        variants.push((name, config));
    };
    with("paper", |c| {
        c.model.gfe = Gfe::Paper;
        c.env.detection = Detection::Paper;
    });
    with("no pcc", |c| c.model.pcc = false);
    with("no moe", |c| c.model.moe = false);
    with("neither", |c| (c.model.pcc, c.model.moe) = (false, false));
    with("top 1 of 3 experts, 4 centres", |c| (c.model.top_k, c.model.experts, c.model.clusters) = (1, 3, 4));
    with("contrastive target detached", |c| c.model.detach_contrastive_target = true);
    for (name, config) in variants {
        let mut trainer = trainer(&config);
        let before = trainer.snapshot().unwrap();
        let mut toy = Toy::new(&ragged(), &config, 3);
        let fragments = round(&trainer, &mut toy, 12);
        let stats = trainer.update(&fragments).unwrap();
        assert!(
            stats.losses.values().chain(stats.diagnostics.values()).all(|v| v.is_finite()),
            "{name}: {stats:?}"
        );
        assert_eq!(stats.losses.contains_key("actor_contrastive"), config.model.pcc, "{name}");
        assert_eq!(stats.losses.contains_key("critic_load_balance"), config.model.moe, "{name}");
        assert!(before != trainer.snapshot().unwrap(), "{name}: the weights did not move");
        assert_eq!(stats.decisions, 2 * 12 * 7, "{name}");
        let shares = |usage: &[f64]| usage.iter().sum::<f64>();
        if config.model.moe {
            assert!((shares(&stats.expert_usage) - 1.0).abs() < 1e-4, "{name}");
        }
        if config.model.pcc {
            assert!((shares(&stats.cluster_usage) - 1.0).abs() < 1e-4, "{name}");
        }
    }
}

#[test]
fn every_loss_weight_matters() {
    let base = tiny_config();
    let after = |config: &Config| {
        let mut trainer = trainer(config);
        let mut toy = Toy::new(&ragged(), config, 3);
        let fragments = round(&trainer, &mut toy, 12);
        trainer.update(&fragments).unwrap();
        trainer.snapshot().unwrap()
    };
    let reference = after(&base);
    type Change = (&'static str, fn(&mut Config));
    let changes: [Change; 11] = [
        ("entropy", |c| c.ppo.entropy = 0.0),
        ("value", |c| c.ppo.value = 0.0),
        ("prediction", |c| c.ppo.prediction = 0.0),
        ("clustering", |c| c.ppo.clustering = 0.0),
        ("diversity", |c| c.ppo.diversity = 0.0),
        ("load_balance", |c| c.ppo.load_balance = 0.0),
        ("selection_entropy", |c| c.ppo.selection_entropy = 0.0),
        ("normalise_advantages", |c| c.ppo.normalise_advantages = false),
        ("reward_factor", |c| c.ppo.reward_factor = 1.0),
        ("reward_scale", |c| c.ppo.reward_scale = RewardScale::Raw),
        ("value_scale", |c| c.ppo.value_scale = ValueScale::Raw),
    ];
    for (name, change) in changes {
        let mut config = base.clone();
        change(&mut config);
        assert!(reference != after(&config), "{name} changes nothing");
    }
}

#[test]
fn a_detached_contrastive_target_teaches_nothing_at_equal_temperatures() {
    let after = |detach: bool, tau_c: f64, diversity: f64, clustering: f64| {
        let mut config = tiny_config();
        config.model.detach_contrastive_target = detach;
        config.model.tau_c = tau_c;
        config.ppo.diversity = diversity;
        config.ppo.clustering = clustering;
        let mut trainer = trainer(&config);
        let mut toy = Toy::new(&ragged(), &config, 3);
        let fragments = round(&trainer, &mut toy, 12);
        trainer.update(&fragments).unwrap().losses["actor_contrastive"]
    };
    // Two epochs: the second sees what the first taught.
    let without = after(true, 0.1, 0.0, 0.0);
    assert!((after(true, 0.1, 0.0, 1.0) - without).abs() < 1e-4, "detached, equal temperatures: no effect");
    assert!(after(false, 0.1, 0.0, 1.0) < without - 1e-3, "attached: the assignment becomes decisive");
    assert!(
        after(true, 0.2, 0.0, 1.0) < after(true, 0.2, 0.0, 0.0) - 1e-3,
        "detached, unequal temperatures: learns"
    );
}

#[test]
fn a_restored_trainer_goes_on_bit_for_bit() {
    let config = tiny_config();
    let layout = ragged();
    let mut whole = trainer(&config);
    let mut toy = Toy::new(&layout, &config, 9);
    let rounds: Vec<_> = (0..4)
        .map(|_| {
            let fragments = round(&whole, &mut toy, 12);
            whole.update(&fragments).unwrap();
            fragments
        })
        .collect();
    let mut first = trainer(&config);
    first.update(&rounds[0]).unwrap();
    first.update(&rounds[1]).unwrap();
    let files = first.save().unwrap();
    let mut other = config;
    other.seed = 99;
    let mut second = Trainer::new(&other, vec![("toy".to_owned(), Arc::clone(&layout))]).unwrap();
    second.restore(&files.model, &files.optimizer).unwrap();
    assert_eq!(second.updates(), 2);
    second.update(&rounds[2]).unwrap();
    second.update(&rounds[3]).unwrap();
    assert!(second.save().unwrap() == whole.save().unwrap(), "weights, moments or counters differ");
}

#[test]
fn a_reward_that_is_not_a_number_leaves_the_trainer_as_it_was() {
    let config = tiny_config();
    let mut trainer = trainer(&config);
    let mut toy = Toy::new(&ragged(), &config, 9);
    let good = round(&trainer, &mut toy, 12);
    let before = trainer.save().unwrap();
    let mut bad = good.clone();
    bad[1].rewards[5] = f32::NAN;
    assert!(matches!(trainer.update(&bad), Err(ModelError::NotFinite(_))));
    assert!(trainer.save().unwrap() == before, "the failed update left traces");
    trainer.update(&good).unwrap();
}

#[test]
fn fragments_that_do_not_fit_are_refused() {
    let config = tiny_config();
    let mut trainer = trainer(&config);
    let mut toy = Toy::new(&ragged(), &config, 9);
    let good = round(&trainer, &mut toy, 6).remove(0);
    let refused = |trainer: &mut Trainer, change: fn(&mut cross_sim::trajectory::Fragment)| {
        let mut fragment = good.clone();
        change(&mut fragment);
        trainer.update(&[fragment]).unwrap_err().to_string()
    };
    assert!(refused(&mut trainer, |f| f.scenario = "elsewhere".into()).contains("elsewhere"));
    assert!(refused(&mut trainer, |f| f.actions[0] = 200).contains("action"));
    assert!(refused(&mut trainer, |f| f.phases[0] = 200).contains("phase"));
    assert!(refused(&mut trainer, |f| f.counts.truncate(7)).contains("counts"));
    assert!(refused(&mut trainer, |f| f.first_step = 6).contains("state"));
    assert!(matches!(trainer.update(&[]), Err(ModelError::Empty)));
}

#[test]
fn damaged_and_foreign_files_are_told_apart() {
    let config = tiny_config();
    let mut trainer = trainer(&config);
    let files = trainer.save().unwrap();
    let half = &files.model[..files.model.len() / 2];
    assert!(matches!(Policy::from_snapshot(half), Err(ModelError::Damaged { .. })));
    assert!(matches!(Policy::from_snapshot(b"not a tensor file"), Err(ModelError::Damaged { .. })));
    assert!(matches!(Policy::from_snapshot(&files.optimizer), Err(ModelError::Foreign { .. })));
    assert!(matches!(trainer.restore(&files.model, &files.model), Err(ModelError::Foreign { .. })));
    let mut other = config;
    other.model.experts = 3;
    let mut other = Trainer::new(&other, vec![("toy".to_owned(), ragged())]).unwrap();
    assert!(matches!(other.restore(&files.model, &files.optimizer), Err(ModelError::Mismatch { .. })));
}

#[test]
fn a_critic_goes_on_at_the_size_that_it_has_learned() {
    let scaled = tiny_config();
    let mut raw = tiny_config();
    raw.ppo.value_scale = ValueScale::Raw;
    for (own, other) in [(&scaled, &raw), (&raw, &scaled)] {
        let mut first = trainer(own);
        let fresh = first.save().unwrap();
        let fragments = round(&first, &mut Toy::new(&ragged(), own, 9), 12);
        first.update(&fragments).unwrap();
        let files = first.save().unwrap();
        let mut second = trainer(other);
        let refused = second.restore(&files.model, &files.optimizer).unwrap_err().to_string();
        assert!(refused.contains("ppo.value_scale"), "{refused}");
        // Before the first update nothing has been learned at any size.
        second.restore(&fresh.model, &fresh.optimizer).unwrap();
        trainer(own).restore(&files.model, &files.optimizer).unwrap();
    }
}

#[test]
fn a_count_of_updates_that_has_no_successor_is_refused() {
    let mut trainer = trainer(&tiny_config());
    let files = trainer.save().unwrap();
    let text = |key: &str, value: &str| (key.to_owned(), value.to_owned());
    let rng = serde_json::to_string(&ChaCha8Rng::seed_from_u64(0)).unwrap();
    let metadata = snapshot::Metadata::from([
        text("format", snapshot::OPTIMIZER_FORMAT),
        text("format_version", snapshot::OPTIMIZER_FORMAT_VERSION),
        text("updates", &u64::MAX.to_string()),
        text("value_scales", "{}"),
        text("rng", &rng),
        text("actor_t", "0"),
        text("critic_t", "0"),
    ]);
    let optimizer = snapshot::write(std::iter::empty(), &metadata).unwrap();
    assert!(matches!(trainer.restore(&files.model, &optimizer), Err(ModelError::Mismatch { .. })));
}
