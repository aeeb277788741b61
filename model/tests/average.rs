//! The mean of several policies.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{ragged, tiny_config};
use cross_config::Config;
use cross_model::{ModelError, Trainer, average};
use safetensors::SafeTensors;

fn policy(config: &Config) -> Vec<u8> {
    cross_model::set_single_threaded();
    Trainer::new(config, vec![("toy".to_owned(), ragged())]).unwrap().snapshot().unwrap()
}

fn seeded(seed: u64) -> Vec<u8> {
    policy(&Config { seed, ..tiny_config() })
}

/// All weights, by name and in their own order.
fn weights(policy: &[u8]) -> Vec<(String, Vec<f32>)> {
    let file = SafeTensors::deserialize(policy).unwrap();
    let floats =
        |data: &[u8]| data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let mut all: Vec<_> = file.iter().map(|(name, view)| (name.to_owned(), floats(view.data()))).collect();
    all.sort_by(|a: &(String, Vec<f32>), b| a.0.cmp(&b.0));
    all
}

#[test]
fn every_weight_is_the_mean_of_its_likes() {
    let policies = [seeded(1), seeded(2), seeded(3)];
    let mean = weights(&average(&policies).unwrap());
    let all = policies.map(|policy| weights(&policy));
    let mut differ = 0;
    for (at, (name, values)) in mean.iter().enumerate() {
        for (i, value) in values.iter().enumerate() {
            let own = [0, 1, 2].map(|policy| f64::from(all[policy][at].1[i]));
            assert!(
                (f64::from(*value) - own.iter().sum::<f64>() / 3.0).abs() < 1e-7,
                "{name}[{i}]: {value} of {own:?}"
            );
            differ += usize::from(own[0] != own[1]);
        }
    }
    assert!(differ > 1000, "the policies hardly differ");
}

#[test]
fn the_mean_of_one_or_of_equals_is_that() {
    let one = seeded(1);
    assert!(average(std::slice::from_ref(&one)).unwrap() == one);
    assert!(average(&[one.clone(), one.clone(), one.clone(), one.clone()]).unwrap() == one);
}

#[test]
fn what_does_not_belong_together_is_refused() {
    assert!(matches!(average(&[]), Err(ModelError::Mismatch { .. })));
    let mut other = tiny_config();
    other.model.experts = 3;
    assert!(matches!(average(&[policy(&other), seeded(1)]), Err(ModelError::Mismatch { .. })));
    assert!(matches!(average(&[b"nothing".to_vec(), seeded(1)]), Err(ModelError::Damaged { .. })));
}
