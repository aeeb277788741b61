//! Generalised advantage estimation (Schulman et al. 2015; paper, section IV-D).

/// Advantages of one agent over consecutive steps.
///
/// `rewards` has T entries, `values` T+1: the last is the bootstrap value of the state after the last step, 0 if the
/// episode terminated there. `next_advantage` is the advantage of the step after the last one where it is known, else 0.
/// Returns T advantages; the matching value targets are advantage plus value.
#[must_use]
pub fn advantages(rewards: &[f32], values: &[f32], next_advantage: f32, gamma: f64, lambda: f64) -> Vec<f32> {
    let (gamma, decay) = (gamma as f32, (gamma * lambda) as f32);
    let mut out = vec![0.0; rewards.len()];
    let mut running = next_advantage;
    for t in (0..rewards.len()).rev() {
        let delta = rewards[t] + gamma * values[t + 1] - values[t];
        running = delta + decay * running;
        out[t] = running;
    }
    out
}

/// Shifts and scales to mean 0 and standard deviation 1; leaves values without spread at 0.
pub fn normalise<'a>(values: impl Iterator<Item = &'a mut f32>) {
    let mut all: Vec<&mut f32> = values.collect();
    let count = all.len().max(1) as f64;
    let mean = all.iter().map(|v| f64::from(**v)).sum::<f64>() / count;
    let variance = all.iter().map(|v| (f64::from(**v) - mean).powi(2)).sum::<f64>() / count;
    let scale = 1.0 / (variance.sqrt() + 1e-8);
    for value in &mut all {
        **value = ((f64::from(**value) - mean) * scale) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition, summed term by term.
    fn by_definition(rewards: &[f32], values: &[f32], gamma: f64, lambda: f64) -> Vec<f64> {
        let delta =
            |t: usize| f64::from(rewards[t]) + gamma * f64::from(values[t + 1]) - f64::from(values[t]);
        (0..rewards.len())
            .map(|t| (t..rewards.len()).map(|k| (gamma * lambda).powi((k - t) as i32) * delta(k)).sum())
            .collect()
    }

    #[test]
    fn equals_the_definition() {
        let rewards = [-1.0, 0.5, -0.25, -3.0, 0.0];
        let values = [-2.0, -1.5, 0.3, -0.7, 0.1, -0.9];
        let fast = advantages(&rewards, &values, 0.0, 0.95, 0.98);
        for (a, b) in fast.iter().zip(by_definition(&rewards, &values, 0.95, 0.98)) {
            assert!((f64::from(*a) - b).abs() < 1e-5, "{a} {b}");
        }
    }

    #[test]
    fn a_split_episode_gives_the_same_advantages() {
        let rewards = [-1.0, 0.5, -0.25, -3.0, 0.0];
        let values = [-2.0, -1.5, 0.3, -0.7, 0.1, -0.9];
        let whole = advantages(&rewards, &values, 0.0, 0.95, 0.98);
        let tail = advantages(&rewards[2..], &values[2..], 0.0, 0.95, 0.98);
        let head = advantages(&rewards[..2], &values[..3], tail[0], 0.95, 0.98);
        assert_eq!([head, tail].concat(), whole);
    }

    #[test]
    fn normalised_values_have_mean_zero_and_deviation_one() {
        let mut values = [1.0, 2.0, 3.0, 6.0];
        normalise(values.iter_mut());
        let mean: f32 = values.iter().sum::<f32>() / 4.0;
        let variance: f32 = values.iter().map(|v| v * v).sum::<f32>() / 4.0;
        assert!(mean.abs() < 1e-6 && (variance - 1.0).abs() < 1e-5);
        let mut flat = [2.0; 3];
        normalise(flat.iter_mut());
        assert_eq!(flat, [0.0; 3]);
    }
}
