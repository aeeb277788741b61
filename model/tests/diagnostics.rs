//! What an update tells about itself, scenario by scenario.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, id, intersection, ragged, tiny_config};
use cross_config::Config;
use cross_model::{Policy, Trainer, UpdateStats};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::{Fragment, FragmentEnd};
use std::sync::Arc;

type Scenario = (String, Arc<NetworkLayout>);

fn scenarios() -> Vec<Scenario> {
    let small = NetworkLayout { intersections: vec![intersection("a", 2, 1), intersection("b", 3, 2)] };
    vec![("large".to_owned(), ragged()), ("small".to_owned(), Arc::new(small)), ("idle".to_owned(), ragged())]
}

fn fragment(trainer: &Trainer, config: &Config, (name, layout): &Scenario, steps: u32) -> Fragment {
    let mut policy = Policy::from_snapshot(&trainer.snapshot().unwrap()).unwrap();
    let mut toy = Toy::new(layout, config, 8);
    toy.play(&mut policy, name, id(0, 0), 0, steps, FragmentEnd::Truncated, false).0
}

fn update(config: &Config, names: &[&str]) -> UpdateStats {
    cross_model::set_single_threaded();
    let scenarios = scenarios();
    let mut trainer = Trainer::new(config, scenarios.clone()).unwrap();
    let fragments: Vec<Fragment> = scenarios
        .iter()
        .filter(|(name, _)| names.contains(&name.as_str()))
        .map(|scenario| fragment(&trainer, config, scenario, 12))
        .collect();
    trainer.update(&fragments).unwrap()
}

/// One minibatch, so that weights are the same whatever else is in it.
fn one_minibatch() -> Config {
    let mut config = tiny_config();
    config.ppo.epochs = 1;
    config.ppo.sequence_steps = 12;
    config.ppo.minibatch_decisions = 1_000_000;
    config
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-5
}

#[test]
fn a_scenario_s_numbers_are_those_of_an_update_on_it_alone() {
    let config = one_minibatch();
    let both = update(&config, &["large", "small"]);
    assert_eq!(both.scenarios.keys().collect::<Vec<_>>(), ["large", "small"], "idle had no data");
    for name in ["large", "small"] {
        let (own, alone) = (&both.scenarios[name], update(&config, &[name]));
        for (key, value) in &own.diagnostics {
            assert!(
                close(*value, alone.diagnostics[key]),
                "{name} {key}: {value} {}",
                alone.diagnostics[key]
            );
        }
        assert_eq!(own.diagnostics.len(), 4);
        for (own, alone) in
            [(&own.expert_usage, &alone.expert_usage), (&own.cluster_usage, &alone.cluster_usage)]
        {
            assert_eq!(own.len(), 6);
            assert!(own.iter().zip(alone).all(|(a, b)| close(*a, *b)), "{name}: {own:?} {alone:?}");
            assert!(close(own.iter().sum(), 1.0));
        }
    }
    assert_ne!(both.scenarios["large"].cluster_usage, both.scenarios["small"].cluster_usage);
}

#[test]
fn the_whole_is_the_scenarios_weighted_by_their_decisions_and_rows() {
    let both = update(&one_minibatch(), &["large", "small"]);
    let (large, small) = (&both.scenarios["large"], &both.scenarios["small"]);
    // 7 and 2 intersections with 33 and 5 phases, as many steps.
    for key in ["approx_kl", "clip_fraction", "entropy"] {
        let mean = (7.0 * large.diagnostics[key] + 2.0 * small.diagnostics[key]) / 9.0;
        assert!(close(mean, both.diagnostics[key]), "{key}: {mean} {}", both.diagnostics[key]);
    }
    assert!(close(both.diagnostics["entropy"], both.losses["actor_entropy"]));
    for (all, large, small) in [
        (&both.expert_usage, &large.expert_usage, &small.expert_usage),
        (&both.cluster_usage, &large.cluster_usage, &small.cluster_usage),
    ] {
        for ((all, large), small) in all.iter().zip(large).zip(small) {
            assert!(close(*all, (33.0 * large + 5.0 * small) / 38.0), "{all} {large} {small}");
        }
    }
}

#[test]
fn what_is_switched_off_has_no_usage() {
    let mut config = one_minibatch();
    (config.model.pcc, config.model.moe) = (false, false);
    let stats = update(&config, &["small"]);
    assert!(stats.scenarios["small"].expert_usage.is_empty() && stats.cluster_usage.is_empty());
}
