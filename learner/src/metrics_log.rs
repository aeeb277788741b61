//! `metrics.jsonl`: one line per update, for curves, reports and comparisons.
//!
//! Everything in a line but `time` and `timing` follows from the data alone: two serial runs of one seed write equal lines.

use crate::admission::{Lag, Progress};
use cross_model::UpdateStats;
use cross_support::files::replace_file;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// Name of the file in a run directory.
pub const FILE: &str = "metrics.jsonl";

/// One update.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// Number of the update, from 1.
    pub update: u64,
    /// Version of the weights that it gave.
    pub policy_version: u64,
    /// Agent-decisions trained on so far.
    pub decisions: u64,
    /// Episodes finished so far.
    pub episodes: u64,
    /// By scenario.
    pub scenarios: BTreeMap<String, ScenarioLine>,
    /// Loss terms by name, before their weights.
    pub losses: BTreeMap<String, f64>,
    /// `approx_kl`, `clip_fraction`, `entropy`, `explained_variance`, gradient norms, learning rates.
    pub diagnostics: BTreeMap<String, f64>,
    /// Share of the gating weight per expert.
    pub expert_usage: Vec<f64>,
    /// Mean assignment per cluster.
    pub cluster_usage: Vec<f64>,
    /// Policy versions that the data was behind.
    pub lag: Lag,
    /// Where the update was computed: `cpu` or `cuda:0`. Empty in lines of a version that did not say.
    #[serde(default)]
    pub device: String,
    /// Precision of its large products: `f32` or `bf16`.
    #[serde(default)]
    pub precision: String,
    /// When the update was done, seconds since 1970.
    pub time: f64,
    /// How long things took.
    pub timing: Timing,
}

/// A scenario in a [`Line`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScenarioLine {
    /// Finished episodes so far.
    pub episodes: u64,
    /// Agent-decisions trained on so far.
    pub decisions: u64,
    /// Mean over the agents of the summed raw reward, mean over the newest finished episodes.
    pub episode_return: Option<f64>,
    /// Stopped vehicles per incoming lane as the reward counts them (beyond its range by `env.reward_beyond`), over the same
    /// episodes.
    pub queue_length: Option<f64>,
    /// `approx_kl`, `clip_fraction`, `entropy`, `explained_variance` over this scenario's data; empty if the round held none.
    #[serde(default)]
    pub diagnostics: BTreeMap<String, f64>,
    /// Share of this scenario's gating weight per expert.
    #[serde(default)]
    pub expert_usage: Vec<f64>,
    /// Mean assignment of this scenario's rows per cluster.
    #[serde(default)]
    pub cluster_usage: Vec<f64>,
}

/// Durations of an update, seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// From the end of the update before to the start of this one: waiting for data.
    pub collect_seconds: f64,
    /// The update itself.
    pub update_seconds: f64,
    /// Since this learner process started.
    pub uptime_seconds: f64,
}

impl Line {
    /// The scenarios' part, from the counters and the update.
    #[must_use]
    pub fn scenarios(progress: &Progress, stats: &UpdateStats) -> BTreeMap<String, ScenarioLine> {
        progress
            .scenarios
            .iter()
            .map(|(name, s)| {
                let own = stats.scenarios.get(name).cloned().unwrap_or_default();
                let line = ScenarioLine {
                    episodes: s.episodes,
                    decisions: s.decisions,
                    episode_return: s.episode_return,
                    queue_length: s.queue_length,
                    diagnostics: own.diagnostics,
                    expert_usage: own.expert_usage,
                    cluster_usage: own.cluster_usage,
                };
                (name.clone(), line)
            })
            .collect()
    }
}

/// The open file.
#[derive(Debug)]
pub struct MetricsLog {
    file: File,
}

impl MetricsLog {
    /// Opens a run's file to go on after `updates`. Lines of later updates are removed: a learner that was killed wrote them
    /// after its last checkpoint, and those updates are now done again. So is a line that was cut short.
    ///
    /// # Errors
    /// Any of reading or writing the file.
    pub fn open(run: &Path, updates: u64) -> io::Result<Self> {
        let path = run.join(FILE);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(error) => return Err(error),
        };
        let text = String::from_utf8_lossy(&bytes);
        #[derive(Deserialize)]
        struct Update {
            update: u64,
        }
        let kept: String = text
            .split_inclusive('\n')
            .filter(|line| line.ends_with('\n'))
            .filter(|line| serde_json::from_str::<Update>(line).is_ok_and(|line| line.update <= updates))
            .collect();
        let at_the_end = bytes.starts_with(kept.as_bytes());
        if !at_the_end {
            replace_file(&path, kept.as_bytes())?;
        }
        let file = OpenOptions::new().create(true).append(true).open(&path)?;
        if at_the_end && kept.len() < bytes.len() {
            // Needs no room, so that a run on a full disk can be resumed.
            file.set_len(kept.len() as u64)?;
        }
        Ok(Self { file })
    }

    /// Appends a line, in one write, so that a reader sees a whole line or none.
    ///
    /// # Errors
    /// Of the write; the file is then as it was, so that the next line does not continue half of this one.
    pub fn append(&mut self, line: &Line) -> io::Result<()> {
        let mut text = serde_json::to_vec(line)?;
        text.push(b'\n');
        let before = self.file.metadata()?.len();
        self.file.write_all(&text).inspect_err(|_| {
            // The failure that matters is the first one.
            let _ = self.file.set_len(before);
        })
    }

    /// Bytes that an ordinary user can still write to the run directory's file system.
    ///
    /// # Errors
    /// If the file system does not say.
    pub fn disk_available(&self) -> io::Result<u64> {
        let space = rustix::fs::fstatvfs(&self.file)?;
        Ok(space.f_bavail.saturating_mul(space.f_frsize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(update: u64) -> Line {
        Line {
            update,
            policy_version: update + 1,
            decisions: 0,
            episodes: 0,
            scenarios: BTreeMap::new(),
            losses: BTreeMap::new(),
            diagnostics: BTreeMap::new(),
            expert_usage: Vec::new(),
            cluster_usage: Vec::new(),
            lag: Lag::default(),
            device: "cpu".to_owned(),
            precision: "f32".to_owned(),
            time: 0.0,
            timing: Timing::default(),
        }
    }

    fn updates(run: &Path) -> Vec<u64> {
        let text = std::fs::read_to_string(run.join(FILE)).unwrap();
        text.lines().map(|line| serde_json::from_str::<Line>(line).unwrap().update).collect()
    }

    #[test]
    fn resuming_removes_lines_that_will_come_again_and_torn_ones() {
        let run = tempfile::tempdir().unwrap();
        let mut log = MetricsLog::open(run.path(), 0).unwrap();
        for update in 1..=5 {
            log.append(&line(update)).unwrap();
        }
        drop(log);
        let mut text = std::fs::read_to_string(run.path().join(FILE)).unwrap();
        text.push_str("{\"update\": 2, \"pol");
        std::fs::write(run.path().join(FILE), text).unwrap();
        let mut log = MetricsLog::open(run.path(), 3).unwrap();
        log.append(&line(4)).unwrap();
        assert_eq!(updates(run.path()), [1, 2, 3, 4]);
    }

    #[test]
    fn resuming_needs_no_room_on_the_disk() {
        const RUN: &str = "CROSS_TEST_FULL_DISK";
        if let Some(run) = std::env::var_os(RUN) {
            assert!(MetricsLog::open(Path::new(&run), 3).unwrap().append(&line(4)).is_err());
            return;
        }
        let run = tempfile::tempdir().unwrap();
        let mut log = MetricsLog::open(run.path(), 0).unwrap();
        for update in 1..=5 {
            log.append(&line(update)).unwrap();
        }
        limited("resuming_needs_no_room_on_the_disk", 0, RUN, run.path());
        assert_eq!(updates(run.path()), [1, 2, 3]);
    }

    /// Runs a test of this module again, as a process whose files may have so many blocks: more is refused, as on a full disk.
    fn limited(name: &str, blocks: u32, variable: &str, run: &Path) {
        let status = std::process::Command::new("/bin/sh")
            .args(["-c", "trap '' XFSZ; ulimit -f $2; exec \"$0\" --exact \"$1\" --nocapture"])
            .arg(std::env::current_exe().unwrap())
            .arg(format!("metrics_log::tests::{name}"))
            .arg(blocks.to_string())
            .env(variable, run)
            .stdout(std::process::Stdio::null())
            .status()
            .unwrap();
        assert!(status.success(), "the child's words are above");
    }

    /// The kernel takes half a line and refuses the rest, as a full disk does.
    #[test]
    fn a_line_that_does_not_fit_leaves_nothing_behind() {
        const RUN: &str = "CROSS_TEST_FULL_DISK";
        if let Some(run) = std::env::var_os(RUN) {
            let mut log = MetricsLog::open(Path::new(&run), 0).unwrap();
            assert!((1..=1000).any(|update| log.append(&line(update)).is_err()));
            return;
        }
        let run = tempfile::tempdir().unwrap();
        limited("a_line_that_does_not_fit_leaves_nothing_behind", 3, RUN, run.path());
        let done = updates(run.path());
        assert!(!done.is_empty() && done.len() < 1000, "{done:?}");
        assert!(std::fs::read(run.path().join(FILE)).unwrap().ends_with(b"\n"));
    }
}
