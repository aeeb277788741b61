//! Values of all scenarios at one size (van Hasselt et al. 2016, "Learning values across many orders of magnitude"; the
//! running form without output rescaling is MAPPO's, Yu et al. 2022).
//!
//! Returns of a jammed network are a hundred times those of one where traffic flows. One critic for both would spend its
//! whole gradient on the jam. So it learns returns that are shifted and scaled to mean 0 and deviation 1, each scenario by
//! itself, and its outputs are scaled back before advantages are estimated.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Weight of the past in the running moments, per update.
const MEMORY: f64 = 0.9;
/// Least deviation: returns that never differ must not be divided by nothing.
const LEAST_DEVIATION: f64 = 1e-3;

/// From a critic's outputs to returns: `output * deviation + mean`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ValueScale {
    /// Mean return.
    pub mean: f64,
    /// Standard deviation of returns, above 0.
    pub deviation: f64,
}

impl ValueScale {
    /// Outputs are returns.
    pub const IDENTITY: Self = Self { mean: 0.0, deviation: 1.0 };

    /// The return that an output of the critic stands for.
    #[must_use]
    pub fn to_return(self, output: f32) -> f32 {
        (f64::from(output) * self.deviation + self.mean) as f32
    }

    /// What the critic should say for a return.
    #[must_use]
    pub fn to_output(self, value: f32) -> f32 {
        ((f64::from(value) - self.mean) / self.deviation) as f32
    }
}

/// Sums over past returns, older ones weighing less.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Moments {
    weight: f64,
    sum: f64,
    square_sum: f64,
}

/// Running moments of every scenario's returns. Part of a checkpoint.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ValueScales(BTreeMap<String, Moments>);

impl ValueScales {
    /// The scale of a scenario; the identity while nothing has been seen of it.
    #[must_use]
    pub fn of(&self, scenario: &str) -> ValueScale {
        let Some(own) = self.0.get(scenario).filter(|own| own.weight > 0.0) else {
            return ValueScale::IDENTITY;
        };
        let mean = own.sum / own.weight;
        let variance = (own.square_sum / own.weight - mean * mean).max(0.0);
        ValueScale { mean, deviation: variance.sqrt().max(LEAST_DEVIATION) }
    }

    /// Takes one update's returns of a scenario in. Returns that are not finite are left out: the losses will refuse them.
    pub fn observe(&mut self, scenario: &str, returns: impl Iterator<Item = f32>) {
        let (mut count, mut sum, mut square_sum) = (0.0, 0.0, 0.0);
        for value in returns.filter(|value| value.is_finite()).map(f64::from) {
            count += 1.0;
            sum += value;
            square_sum += value * value;
        }
        if count == 0.0 {
            return;
        }
        let own = self.0.entry(scenario.to_owned()).or_default();
        let add = |past: &mut f64, now: f64| *past = MEMORY * *past + (1.0 - MEMORY) * now / count;
        add(&mut own.weight, count);
        add(&mut own.sum, sum);
        add(&mut own.square_sum, square_sum);
    }

    /// Whether nothing has been seen of any scenario.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether every number in it is one that [`ValueScales::observe`] can have left.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let rounding = 1e-9;
        self.0.values().all(|own| {
            (1.0 - MEMORY - rounding..=1.0 + rounding).contains(&own.weight)
                && own.sum.is_finite()
                && own.square_sum.is_finite()
                && own.square_sum >= 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_returns_set_the_scale() {
        let mut scales = ValueScales::default();
        assert_eq!(scales.of("a"), ValueScale::IDENTITY);
        scales.observe("a", [-1.0, -3.0].into_iter());
        let scale = scales.of("a");
        assert!((scale.mean + 2.0).abs() < 1e-9 && (scale.deviation - 1.0).abs() < 1e-9, "{scale:?}");
        assert_eq!(scales.of("b"), ValueScale::IDENTITY);
    }

    #[test]
    fn there_and_back_is_the_same() {
        let scale = ValueScale { mean: -250.0, deviation: 80.0 };
        for value in [-400.0, -250.0, 0.0, 3.5] {
            assert!((scale.to_return(scale.to_output(value)) - value).abs() < 1e-3);
        }
    }

    #[test]
    fn newer_returns_weigh_more() {
        let mut scales = ValueScales::default();
        for _ in 0..20 {
            scales.observe("a", [-100.0, -90.0].into_iter());
        }
        for _ in 0..20 {
            scales.observe("a", [-10.0, -9.0].into_iter());
        }
        let mean = scales.of("a").mean;
        assert!((-25.0..-9.5).contains(&mean), "{mean}");
    }

    #[test]
    fn equal_or_broken_returns_leave_a_scale_that_can_be_divided_by() {
        let mut scales = ValueScales::default();
        scales.observe("a", [0.0, 0.0, f32::NAN, f32::INFINITY].into_iter());
        assert!(scales.of("a").deviation >= LEAST_DEVIATION);
        scales.observe("b", [f32::NAN].into_iter());
        assert_eq!(scales.of("b"), ValueScale::IDENTITY);
        assert!(scales.is_sound());
    }

    #[test]
    fn a_file_with_impossible_numbers_is_told() {
        let read = |text: &str| serde_json::from_str::<ValueScales>(text).map(|scales| scales.is_sound());
        assert!(read(r#"{"a":{"weight":0.5,"sum":-3.0,"square_sum":20.0}}"#).unwrap_or(false));
        assert!(!read(r#"{"a":{"weight":-0.5,"sum":-3.0,"square_sum":20.0}}"#).unwrap_or(true));
        assert!(!read(r#"{"a":{"weight":1e-320,"sum":-3.0,"square_sum":20.0}}"#).unwrap_or(true));
        assert!(!read(r#"{"a":{"weight":0.5,"sum":-3.0,"square_sum":-20.0}}"#).unwrap_or(true));
        assert!(read(r#"{"a":{"weight":1e999,"sum":0,"square_sum":0}}"#).is_err());
    }
}
