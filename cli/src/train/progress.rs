//! Progress that a person can read: a live display on a terminal, plain lines elsewhere.

use crate::evaluate::Episodes;
use cross_proto::v1::TrainingStatus;
use cross_proto::v1::training_status::Phase;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt::Write as _;
use std::io::{IsTerminal, Write as _};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Where progress goes. Always standard error: standard output belongs to the result.
#[derive(Debug)]
pub(crate) struct Progress {
    display: Display,
    started: Instant,
    /// Updates that were done before this process began, from which the time left must not be judged.
    first_updates: Option<u64>,
}

#[derive(Debug)]
enum Display {
    Live(ProgressBar),
    Lines { last: Option<(Instant, u64)> },
    Silent,
}

impl Display {
    fn new(wanted: bool, template: &str, length: u64) -> Self {
        if !wanted {
            return Self::Silent;
        }
        if !std::io::stderr().is_terminal() {
            return Self::Lines { last: None };
        }
        let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
        // The templates are constants; an unusable one would fall back to the default.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(500));
        Self::Live(bar)
    }
}

impl Progress {
    pub(crate) fn new(wanted: bool, updates: u64) -> Self {
        let display = Display::new(wanted, "{wide_bar:.green} {pos}/{len} updates\n{msg}", updates);
        Self { display, started: Instant::now(), first_updates: None }
    }

    /// Shows a new status; `alive` actors run.
    pub(crate) fn show(&mut self, status: &TrainingStatus, alive: usize) {
        let first = *self.first_updates.get_or_insert(status.updates);
        let elapsed = self.started.elapsed();
        let left = time_left(elapsed, status.updates.saturating_sub(first), status);
        match &mut self.display {
            Display::Live(bar) => {
                bar.set_length(status.updates_wanted);
                bar.set_position(status.updates);
                bar.set_message(live_text(status, alive, elapsed, left));
            }
            Display::Lines { last } => {
                let now = Instant::now();
                let due = last.is_none_or(|(when, _)| now.duration_since(when) >= LINE_EVERY);
                let finished = status.updates >= status.updates_wanted
                    && last.is_none_or(|(_, updates)| updates != status.updates);
                if due || finished {
                    *last = Some((now, status.updates));
                    say(&line(status, alive, elapsed, left));
                }
            }
            Display::Silent => {}
        }
    }

    /// Says something beside the progress.
    pub(crate) fn tell(&self, text: &str) {
        match &self.display {
            Display::Live(bar) => bar.suspend(|| say(text)),
            Display::Lines { .. } | Display::Silent => say(text),
        }
    }

    /// Ends the live display and leaves its last state on the screen.
    pub(crate) fn finish(&self) {
        if let Display::Live(bar) = &self.display {
            bar.abandon();
        }
    }
}

/// Progress of an evaluation, shown from several threads.
#[derive(Debug)]
pub(crate) struct EpisodeProgress {
    display: Mutex<Display>,
}

impl EpisodeProgress {
    pub(crate) fn new(wanted: bool, episodes: usize) -> Self {
        let template = "{wide_bar:.green} {pos}/{len} episodes evaluated";
        Self { display: Mutex::new(Display::new(wanted, template, episodes as u64)) }
    }

    /// Called after every decision of every episode, so it does little.
    pub(crate) fn show(&self, episodes: Episodes) {
        // Whoever else is showing says the same.
        let Ok(mut display) = self.display.try_lock() else { return };
        match &mut *display {
            Display::Live(bar) => {
                bar.set_position(episodes.finished as u64);
            }
            Display::Lines { last } => {
                let now = Instant::now();
                if last.is_none_or(|(when, _)| now.duration_since(when) >= LINE_EVERY) {
                    // The first line would only say that nothing is done yet.
                    if last.is_some() {
                        say(&format!("evaluated {} of {} episodes", episodes.finished, episodes.all));
                    }
                    *last = Some((now, 0));
                }
            }
            Display::Silent => {}
        }
    }

    /// Takes the bar off the screen: the table follows.
    pub(crate) fn finish(&self) {
        if let Display::Live(bar) = &*self.display.lock().unwrap_or_else(PoisonError::into_inner) {
            bar.finish_and_clear();
        }
    }
}

/// A line on standard error; with nobody there to read it, there is nobody to tell.
pub(crate) fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// What is left at the pace so far; unknown before the first update of this session.
fn time_left(elapsed: Duration, done: u64, status: &TrainingStatus) -> Option<Duration> {
    let remaining = status.updates_wanted.saturating_sub(status.updates);
    (done > 0).then(|| elapsed.mul_f64(remaining as f64 / done as f64))
}

/// One line with everything.
fn line(status: &TrainingStatus, alive: usize, elapsed: Duration, left: Option<Duration>) -> String {
    let mut text = format!(
        "update {}/{} | {} | {} decisions/s",
        status.updates,
        status.updates_wanted,
        phase(status),
        grouped(status.decisions_per_second)
    );
    for scenario in &status.scenarios {
        let _ = write!(text, " | {}", scenario_text(scenario));
    }
    for (name, loss) in headline_losses(status) {
        let _ = write!(text, " | {name} loss {loss:.4}");
    }
    let _ = write!(text, " | {} | {}", actors(alive), times(elapsed, left));
    text
}

/// The same over a few lines, below the bar.
fn live_text(status: &TrainingStatus, alive: usize, elapsed: Duration, left: Option<Duration>) -> String {
    let mut text = format!(
        "{} | {} decisions/s | {} | {}",
        phase(status),
        grouped(status.decisions_per_second),
        actors(alive),
        times(elapsed, left)
    );
    for scenario in &status.scenarios {
        let _ = write!(text, "\n{}", scenario_text(scenario));
    }
    let losses: Vec<_> =
        headline_losses(status).into_iter().map(|(name, loss)| format!("{name} {loss:.4}")).collect();
    if !losses.is_empty() {
        let _ = write!(text, "\nloss: {}", losses.join(", "));
    }
    text
}

fn scenario_text(scenario: &cross_proto::v1::ScenarioStatus) -> String {
    // A finished episode is counted a moment before its figures are there.
    let (Some(episode_return), Some(queue_length)) = (scenario.episode_return, scenario.queue_length) else {
        return format!("{}: first episodes under way", scenario.name);
    };
    format!(
        "{}: return {episode_return:.1}, queue {queue_length:.3}, {} episodes",
        scenario.name, scenario.episodes
    )
}

/// The totals of the two networks where the learner names them, else whatever terms it reports.
pub(crate) fn headline_losses(status: &TrainingStatus) -> Vec<(&str, f64)> {
    let mut losses: Vec<_> = status.losses.iter().map(|(name, &loss)| (name.as_str(), loss)).collect();
    losses.sort_by(|a, b| a.0.cmp(b.0));
    let totals: Vec<_> = losses
        .iter()
        .copied()
        .filter_map(|(name, loss)| Some((name.strip_suffix("_total")?, loss)))
        .collect();
    if totals.is_empty() { losses.into_iter().take(3).collect() } else { totals }
}

fn phase(status: &TrainingStatus) -> &'static str {
    match status.phase() {
        Phase::Unspecified => "starting",
        Phase::Collecting => "collecting",
        Phase::Updating => "updating",
        Phase::Paused => "paused",
        Phase::Draining => "draining",
        Phase::Complete => "complete",
    }
}

fn actors(alive: usize) -> String {
    if alive == 1 { "1 actor".to_owned() } else { format!("{alive} actors") }
}

fn times(elapsed: Duration, left: Option<Duration>) -> String {
    match left {
        Some(left) => format!("{} elapsed, {} left", spell(elapsed), spell(left)),
        None => format!("{} elapsed", spell(elapsed)),
    }
}

/// `7s`, `3m 07s`, `2h 03m`.
pub(crate) fn spell(duration: Duration) -> String {
    let seconds = duration.as_secs();
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, s) => format!("{s}s"),
        (0, m, s) => format!("{m}m {s:02}s"),
        (h, m, _) => format!("{h}h {m:02}m"),
    }
}

/// A whole number with its thousands apart: `12,345`.
fn grouped(value: f64) -> String {
    let digits = format!("{:.0}", value.max(0.0));
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i) % 3 == 0 {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use cross_proto::v1::ScenarioStatus;

    fn status() -> TrainingStatus {
        TrainingStatus {
            phase: Phase::Collecting.into(),
            updates: 12,
            updates_wanted: 100,
            decisions_per_second: 12345.6,
            scenarios: vec![ScenarioStatus {
                name: "grid4x4".to_owned(),
                episodes: 24,
                episode_return: Some(-43.21),
                queue_length: Some(0.4217),
                ..Default::default()
            }],
            losses: [("actor_total", 0.5), ("critic_total", 0.25), ("actor_entropy", 1.0)]
                .into_iter()
                .map(|(name, loss)| (name.to_owned(), loss))
                .collect(),
            ..Default::default()
        }
    }

    #[test]
    fn a_line_says_it_all() {
        let text = line(&status(), 2, Duration::from_secs(65), Some(Duration::from_secs(3700)));
        assert_eq!(
            text,
            "update 12/100 | collecting | 12,346 decisions/s | grid4x4: return -43.2, queue 0.422, 24 episodes \
             | actor loss 0.5000 | critic loss 0.2500 | 2 actors | 1m 05s elapsed, 1h 01m left"
        );
    }

    #[test]
    fn time_left_counts_only_the_updates_of_this_session() {
        let status = status();
        assert_eq!(time_left(Duration::from_secs(60), 0, &status), None);
        assert_eq!(time_left(Duration::from_secs(60), 2, &status), Some(Duration::from_secs(60 * 44)));
    }

    #[test]
    fn a_scenario_without_a_finished_episode_shows_no_numbers() {
        let mut status = status();
        (status.scenarios[0].episode_return, status.scenarios[0].queue_length) = (None, None);
        let text = line(&status, 1, Duration::ZERO, None);
        assert!(text.contains("first episodes under way") && text.contains("1 actor |"), "{text}");
        // Empty streets give a return of 0, which is a figure like any other.
        (status.scenarios[0].episode_return, status.scenarios[0].queue_length) = (Some(0.0), Some(0.0));
        let text = line(&status, 1, Duration::ZERO, None);
        assert!(text.contains("return 0.0, queue 0.000"), "{text}");
    }
}
