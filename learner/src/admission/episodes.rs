//! Episodes: their seeds, how far each has come, and what it earned.

use super::types::ScenarioSettings;
use cross_sim::trajectory::{Fragment, FragmentEnd};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// Evaluations use the small SUMO seeds; training never does, so that no result is measured on traffic trained on.
pub const FIRST_TRAINING_SEED: u32 = 1_000_000;

/// Seeds of an episode for SUMO and for action sampling, a function of the run's seed and the episode's id alone.
#[must_use]
pub fn episode_seeds(run_seed: u64, episode: u64) -> (u32, u64) {
    let mut key = [0; 32];
    key[..8].copy_from_slice(&run_seed.to_le_bytes());
    key[8..16].copy_from_slice(&episode.to_le_bytes());
    key[16..].copy_from_slice(b"cross episode v1");
    let mut rng = ChaCha8Rng::from_seed(key);
    // SUMO reads its seed as a signed 32-bit number.
    let span = i32::MAX.unsigned_abs() - FIRST_TRAINING_SEED;
    let sumo_seed = FIRST_TRAINING_SEED + rng.next_u32() % span;
    (sumo_seed, rng.next_u64())
}

/// An episode that an actor simulates.
#[derive(Debug, Clone)]
pub(super) struct Episode {
    pub(super) id: u64,
    pub(super) scenario: usize,
    /// Sequence number that the next fragment must have.
    pub(super) next_sequence: u32,
    /// Step at which it must start.
    pub(super) next_step: u32,
    /// Raw reward so far, summed over agents and steps.
    reward: f64,
}

impl Episode {
    pub(super) fn new(id: u64, scenario: usize) -> Self {
        Self { id, scenario, next_sequence: 0, next_step: 0, reward: 0.0 }
    }

    /// Steps still to come if it runs to its full length.
    pub(super) fn remaining_steps(&self, episode_steps: u32) -> u64 {
        u64::from(episode_steps.saturating_sub(self.next_step))
    }

    /// Whether the fragment continues this episode, else the field at fault.
    pub(super) fn check(
        &self,
        fragment: &Fragment,
        episode_steps: u32,
    ) -> Result<(), (&'static str, String)> {
        if fragment.id.sequence != self.next_sequence {
            let problem = format!("is {}, expected {}", fragment.id.sequence, self.next_sequence);
            return Err((
                "sequence",
                format!("{problem}; a fragment is missing, so the episode is given up"),
            ));
        }
        if fragment.first_step != self.next_step {
            return Err(("first_step", format!("is {}, expected {}", fragment.first_step, self.next_step)));
        }
        let end = u64::from(fragment.first_step) + u64::from(fragment.steps);
        if fragment.steps == 0 || end > u64::from(episode_steps) {
            let problem = format!("is {}, which from step {} on", fragment.steps, fragment.first_step);
            return Err(("steps", format!("{problem} does not fit an episode of {episode_steps} steps")));
        }
        if fragment.end == FragmentEnd::Continues && end == u64::from(episode_steps) {
            return Err(("end", "continues past the episode's last step".to_owned()));
        }
        Ok(())
    }

    /// Counts a fragment that [`check`](Self::check) let pass.
    pub(super) fn advance(&mut self, fragment: &Fragment) {
        self.next_sequence += 1;
        self.next_step += fragment.steps;
        self.reward += fragment.rewards.iter().map(|&r| f64::from(r)).sum::<f64>();
    }
}

/// What the episodes finished since the last round gave.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Finished {
    episodes: u64,
    return_sum: f64,
    queue_sum: f64,
}

impl Finished {
    pub(super) fn add(&mut self, episode: &Episode, scenario: &ScenarioSettings) {
        self.episodes += 1;
        self.return_sum += episode.reward / scenario.agents.max(1) as f64;
        let lane_steps = scenario.incoming_lanes.max(1) as f64 * f64::from(episode.next_step.max(1));
        self.queue_sum += -episode.reward / lane_steps;
    }

    /// Mean return and queue length, `None` without an episode.
    pub(super) fn means(&self) -> Option<(f64, f64)> {
        let n = self.episodes as f64;
        (self.episodes > 0).then(|| (self.return_sum / n, self.queue_sum / n))
    }
}

/// The newest finished episodes of an actor with their number of fragments: what tells a fragment that is sent again after
/// its episode from one that belongs nowhere.
#[derive(Debug, Default)]
pub(super) struct Closed(VecDeque<(u64, u32)>);

impl Closed {
    pub(super) fn push(&mut self, episode: &Episode, keep: usize) {
        self.0.push_back((episode.id, episode.next_sequence));
        while self.0.len() > keep {
            self.0.pop_front();
        }
    }

    pub(super) fn contains(&self, episode: u64, sequence: u32) -> bool {
        self.0.iter().any(|&(id, fragments)| id == episode && sequence < fragments)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_depend_on_run_and_episode_and_avoid_evaluation() {
        assert_eq!(episode_seeds(7, 3), episode_seeds(7, 3));
        assert_ne!(episode_seeds(7, 3), episode_seeds(7, 4));
        assert_ne!(episode_seeds(7, 3), episode_seeds(8, 3));
        for episode in 0..10_000 {
            let (sumo, _) = episode_seeds(1, episode);
            assert!((FIRST_TRAINING_SEED..=i32::MAX.unsigned_abs()).contains(&sumo));
        }
    }
}
