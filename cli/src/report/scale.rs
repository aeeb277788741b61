//! From values to pixels, with round numbers at the ticks.

use super::number;

/// A linear axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    low: f64,
    high: f64,
    step: f64,
    /// What `step` was rounded up from.
    rough: f64,
    start: f64,
    end: f64,
}

impl Scale {
    /// An axis that holds every finite value, from `start` to `end` in pixels, with about `ticks` ticks.
    ///
    /// Its ends are the nearest round numbers outside, so that the first and last tick are its ends. Without values, or
    /// with one alone, it is an axis around that.
    pub(super) fn around(values: impl IntoIterator<Item = f64>, pixels: (f64, f64), ticks: usize) -> Self {
        let finite = values.into_iter().filter(|value| value.is_finite());
        let (low, high) =
            finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        // Values so close together that their difference is noise in the last digits get an axis that shows them as equal.
        let room =
            if high - low > high.abs().max(low.abs()) * 1e-9 { 0.0 } else { (high.abs() * 0.1).max(0.5) };
        // A constant that cannot be negative is not shown on an axis that is.
        let bottom = if low >= 0.0 { (low - room).max(0.0) } else { low - room };
        let rough = (high + room - bottom) / ticks.max(1) as f64;
        let step = round_step(rough);
        // The small allowance keeps 0.3 / 0.1 from being rounded up to 4.
        let low = (bottom / step + 1e-9).floor() * step;
        let high = ((high + room) / step - 1e-9).ceil() * step;
        Self { low, high, step, rough, start: pixels.0, end: pixels.1 }
    }

    /// An axis from the least to the greatest value and no further, ticks at round numbers between them.
    pub(super) fn exact(values: impl IntoIterator<Item = f64>, pixels: (f64, f64), ticks: usize) -> Self {
        let finite: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
        let low = finite.iter().copied().fold(f64::INFINITY, f64::min);
        let high = finite.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if low >= high || finite.is_empty() {
            return Self::around(finite, pixels, ticks);
        }
        let rough = (high - low) / ticks.max(1) as f64;
        Self { low, high, step: round_step(rough), rough, start: pixels.0, end: pixels.1 }
    }

    /// With ticks at whole numbers alone: there is nothing between two updates.
    pub(super) fn whole(mut self) -> Self {
        self.step = if self.step.fract() == 0.0 { self.step } else { (2.0 * self.step).ceil() };
        self
    }

    /// Ticks a minute, ten minutes, an hour apart instead of round numbers of seconds.
    pub(super) fn in_minutes(mut self) -> Self {
        // Round numbers of a clock from the unrounded step, or the axis would have half of its ticks.
        let steps = [10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0, 14_400.0];
        let fits = |step: &f64| *step >= self.rough * 0.999;
        self.step = steps.into_iter().find(fits).unwrap_or(self.step);
        self
    }

    /// Where a value stands, pixels.
    pub(super) fn at(&self, value: f64) -> f64 {
        self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)
    }

    /// Least value of the axis.
    pub(super) fn low(&self) -> f64 {
        self.low
    }

    /// Greatest value of the axis.
    pub(super) fn high(&self) -> f64 {
        self.high
    }

    /// The round numbers on it.
    pub(super) fn ticks(&self) -> Vec<f64> {
        let first = (self.low / self.step - 1e-9).ceil();
        let count = ((self.high / self.step + 1e-9).floor() - first).clamp(0.0, 100.0) as u32;
        // Adding zero turns -0 into 0.
        (0..=count).map(|tick| (first + f64::from(tick)) * self.step + 0.0).collect()
    }

    /// A tick's number, with the digits that tell it from its neighbours.
    pub(super) fn label(&self, value: f64) -> String {
        let digits = (-(self.step * 1.000_001).log10().floor()).max(0.0);
        if digits > 4.0 || self.step >= 1e6 {
            return if value == 0.0 { "0".to_owned() } else { format!("{value:.0e}").replace('-', "−") };
        }
        // A step of 2.5 or 0.25 needs one more digit than its size says.
        let odd = (self.step / 10_f64.powf(-digits)).fract();
        let further = usize::from(odd > 1e-6 && odd < 1.0 - 1e-6);
        number::fixed(value, digits as usize + further)
    }
}

/// The smallest of 1, 2, 2.5, 5 times a power of ten that is not below `rough`.
fn round_step(rough: f64) -> f64 {
    if !(rough.is_finite() && rough > 0.0) {
        return 1.0;
    }
    let power = 10_f64.powf(rough.log10().floor());
    let factors = [1.0, 2.0, 2.5, 5.0];
    factors
        .into_iter()
        .map(|factor| factor * power)
        .find(|step| *step >= rough * 0.999_999)
        .unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(scale: &Scale) -> Vec<String> {
        scale.ticks().into_iter().map(|tick| scale.label(tick)).collect()
    }

    #[test]
    fn ticks_are_round_and_hold_the_values() {
        let scale = Scale::around([0.013, 0.118], (100.0, 0.0), 4);
        assert_eq!(labels(&scale), ["0.00", "0.05", "0.10", "0.15"]);
        assert!((scale.at(0.0) - 100.0).abs() < 1e-9 && scale.at(0.15).abs() < 1e-9);
        assert_eq!(
            labels(&Scale::around([-86.0, -12.0], (0.0, 1.0), 4)),
            ["−100", "−80", "−60", "−40", "−20", "0"]
        );
        assert_eq!(labels(&Scale::around([0.1, 0.3], (0.0, 1.0), 2)), ["0.1", "0.2", "0.3"]);
        assert_eq!(labels(&Scale::exact([1.0, 60.0], (0.0, 1.0), 4)), ["20", "40", "60"]);
        assert_eq!(labels(&Scale::exact([1.0, 12.0], (0.0, 1.0), 5).whole()), ["5", "10"]);
        assert_eq!(labels(&Scale::exact([1.0, 3.0], (0.0, 1.0), 6).whole()), ["1", "2", "3"]);
    }

    #[test]
    fn time_has_the_ticks_of_a_clock() {
        let scale = Scale::exact([0.0, 3600.0], (0.0, 600.0), 6).in_minutes();
        assert_eq!(scale.ticks().len(), 7, "{:?}", scale.ticks());
    }

    #[test]
    fn odd_values_make_an_axis_too() {
        for values in [
            vec![],
            vec![f64::NAN],
            vec![3.0],
            vec![0.0, 0.0],
            vec![-1e-12, 1e-12],
            vec![1e300, -1e300],
            vec![5e-7, 6e-7],
        ] {
            let scale = Scale::around(values.clone(), (0.0, 10.0), 4);
            assert!(scale.low() < scale.high() || values.contains(&1e300), "{values:?}: {scale:?}");
            assert!(scale.ticks().len() >= 2, "{values:?}: {scale:?}");
            for value in values.iter().filter(|value| value.is_finite()) {
                let at = scale.at(*value);
                assert!((-1e-6..=10.0 + 1e-6).contains(&at), "{value} stands at {at} in {scale:?}");
            }
        }
    }
}
