//! How far the table is, with the time that is left.

use crate::train::progress::{say, spell};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::HashMap;
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(15);
/// Steps of the bar.
const STEPS: f64 = 1000.0;

/// Progress over episodes of unlike length, told from several threads.
#[derive(Debug)]
pub(crate) struct Progress {
    state: Mutex<State>,
    /// Work of all episodes of this call, in the unit of [`super::plan::Job::weight`].
    total: f64,
    episodes: usize,
    started: Instant,
}

#[derive(Debug)]
struct State {
    display: Display,
    finished: usize,
    finished_work: f64,
    /// Work done of the episodes under way, by their number.
    running: HashMap<usize, f64>,
}

#[derive(Debug)]
enum Display {
    Bar(ProgressBar),
    Lines { last: Instant },
}

impl Progress {
    pub(crate) fn new(episodes: usize, total: f64) -> Self {
        let started = Instant::now();
        let display = if std::io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(Some(STEPS as u64), ProgressDrawTarget::stderr());
            // A constant; an unusable one would fall back to the default.
            if let Ok(style) = ProgressStyle::with_template("{wide_bar:.green} {msg}") {
                bar.set_style(style);
            }
            Display::Bar(bar)
        } else {
            Display::Lines { last: started }
        };
        let state = State { display, finished: 0, finished_work: 0.0, running: HashMap::new() };
        Self { state: Mutex::new(state), total, episodes, started }
    }

    /// Episode number `job` has done this much of its work.
    pub(crate) fn step(&self, job: usize, work: f64) {
        let mut state = self.lock();
        state.running.insert(job, work);
        self.show(&mut state);
    }

    /// Episode number `job`, of this much work, is over and its result kept.
    pub(crate) fn finish(&self, job: usize, work: f64) {
        let mut state = self.lock();
        state.running.remove(&job);
        state.finished += 1;
        state.finished_work += work;
        self.show(&mut state);
    }

    /// Takes the bar off the screen.
    pub(crate) fn clear(&self) {
        if let Display::Bar(bar) = &self.lock().display {
            bar.finish_and_clear();
        }
    }

    fn show(&self, state: &mut State) {
        let done = state.finished_work + state.running.values().sum::<f64>();
        let text = self.text(state.finished, done, self.started.elapsed());
        match &mut state.display {
            Display::Bar(bar) => {
                bar.set_message(text);
                bar.set_position((STEPS * done / self.total.max(1.0)) as u64);
            }
            Display::Lines { last } if last.elapsed() >= LINE_EVERY => {
                *last = Instant::now();
                say(&text);
            }
            Display::Lines { .. } => {}
        }
    }

    fn text(&self, finished: usize, done: f64, elapsed: Duration) -> String {
        let mut text = format!("{finished} of {} episodes, {} elapsed", self.episodes, spell(elapsed));
        // After a moment, the pace so far is that of the rest.
        if done > 0.01 * self.total {
            let left = elapsed.mul_f64(((self.total - done) / done).max(0.0));
            text.push_str(&format!(", {} left", spell(left)));
        }
        text
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing that can panic runs while it is held.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_follows_the_work_and_not_the_number_of_episodes() {
        let progress = Progress::new(4, 100.0);
        let minute = Duration::from_secs(60);
        assert_eq!(progress.text(0, 0.0, minute), "0 of 4 episodes, 1m 00s elapsed");
        assert_eq!(progress.text(1, 75.0, minute), "1 of 4 episodes, 1m 00s elapsed, 20s left");
        assert_eq!(progress.text(4, 100.0, minute), "4 of 4 episodes, 1m 00s elapsed, 0s left");
    }

    #[test]
    fn an_episode_under_way_counts_in_part_and_once() {
        let progress = Progress::new(2, 10.0);
        progress.step(0, 2.0);
        progress.step(0, 3.0);
        progress.step(1, 1.0);
        progress.finish(0, 5.0);
        let state = progress.lock();
        assert_eq!((state.finished, state.finished_work), (1, 5.0));
        assert_eq!(state.running, HashMap::from([(1, 1.0)]));
    }
}
