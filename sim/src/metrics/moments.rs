//! Mean and standard deviation, in one pass and without storing the values.

use serde::{Deserialize, Serialize};

/// Mean and population standard deviation; both 0 where there was nothing to measure.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MeanStd {
    /// Arithmetic mean.
    pub mean: f64,
    /// Population standard deviation (divided by n).
    pub std: f64,
}

/// Running moments after Welford, which stays exact where the sum of squares would cancel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Moments {
    count: u64,
    mean: f64,
    squares: f64,
}

impl Moments {
    /// Takes one value in.
    pub fn add(&mut self, value: f64) {
        self.count += 1;
        let before = value - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (value - self.mean);
    }

    /// How many values were taken in.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// What they amount to.
    #[must_use]
    pub fn mean_std(&self) -> MeanStd {
        match self.count {
            0 => MeanStd::default(),
            count => MeanStd { mean: self.mean, std: (self.squares / count as f64).sqrt() },
        }
    }
}

impl FromIterator<f64> for Moments {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut moments = Self::default();
        values.into_iter().for_each(|value| moments.add(value));
        moments
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn nothing_measured_is_zero_and_one_value_has_no_spread() {
        assert_eq!(Moments::default().mean_std(), MeanStd { mean: 0.0, std: 0.0 });
        assert_eq!(Moments::from_iter([4.5]).mean_std(), MeanStd { mean: 4.5, std: 0.0 });
    }

    #[test]
    fn the_deviation_is_that_of_the_population() {
        let moments = Moments::from_iter([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]);
        assert_eq!(moments.mean_std(), MeanStd { mean: 5.0, std: 2.0 });
    }

    proptest! {
        #[test]
        fn equals_the_two_pass_formula(values in prop::collection::vec(-1e6_f64..1e6, 1..200)) {
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
            let got = Moments::from_iter(values).mean_std();
            prop_assert!((got.mean - mean).abs() < 1e-6 && (got.std - std).abs() < 1e-6);
        }
    }
}
