//! A sign of life under the lines that a benchmark prints.

use crate::train::progress::say;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::Duration;

/// On a terminal a spinner with the time so far; elsewhere nothing but the lines.
#[derive(Debug)]
pub(super) struct Live(Option<ProgressBar>);

impl Live {
    pub(super) fn start() -> Self {
        if !std::io::stderr().is_terminal() {
            return Self(None);
        }
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
        // The template is a constant; an unusable one would fall back to the default.
        if let Ok(style) = ProgressStyle::with_template("{spinner:.green} measuring, {elapsed}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(500));
        Self(Some(bar))
    }

    /// Prints a line above it.
    pub(super) fn tell(&self, line: &str) {
        match &self.0 {
            Some(bar) => bar.suspend(|| say(line)),
            None => say(line),
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        if let Some(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}
