//! Clocks that can be set: each process has its own, by libfaketime, and the machine's stays as it is.

use super::tools;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Removes what libfaketime leaves in shared memory of processes that were killed.
pub(super) fn sweep() {
    for entry in std::fs::read_dir("/dev/shm").into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let owner =
            ["faketime_shm_", "sem.faketime_sem_"].iter().find_map(|prefix| name.strip_prefix(prefix));
        if owner.is_some_and(|pid| pid.parse::<i32>().is_ok() && !Path::new("/proc").join(pid).exists()) {
            // Another suite may have been quicker.
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

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
