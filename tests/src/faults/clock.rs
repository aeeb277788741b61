//! Clocks that can be set: each process has its own, by libfaketime, and the machine's stays as it is.

use super::tools;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The wall clock of one process.
#[derive(Debug, Clone)]
pub(super) struct Clock {
    file: PathBuf,
}

impl Clock {
    /// A clock that is right.
    pub(super) fn new(folder: &Path, name: &str) -> Self {
        let clock = Self { file: folder.join(format!("{name}.clock")) };
        clock.set(0);
        clock
    }

    /// Sets it to so many seconds from the truth, in running processes within a second.
    pub(super) fn set(&self, seconds: i64) {
        // Replaced in one step: a process must not read half of it.
        let aside = self.file.with_extension("aside");
        std::fs::write(&aside, format!("{seconds:+}\n")).unwrap();
        std::fs::rename(&aside, &self.file).unwrap();
    }

    /// Has a command go by this clock. Only the wall clock: one that never jumps is what the other kind is for.
    pub(super) fn apply(&self, command: &mut Command) {
        let Some(library) = tools::faketime() else { return };
        command
            .env("LD_PRELOAD", library)
            .env("FAKETIME_TIMESTAMP_FILE", &self.file)
            .env("FAKETIME_CACHE_DURATION", "1")
            .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    }
}
