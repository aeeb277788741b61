//! Small training runs.

use crate::binaries;
use crate::processes::{self, Found};
use crate::wait;
use rustix::process::Signal;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Twenty decisions an episode, one episode a round, a tiny network: an update takes a fraction of a second.
pub const SMALL: &str = r#"
[env]
episode_seconds = 200
[model]
hidden = 16
latent = 8
heads = 2
clusters = 2
experts = 2
top_k = 1
[ppo]
round_steps = 20
epochs = 1
sequence_steps = 10
minibatch_decisions = 64
[learner]
checkpoint_updates = 1
[actor]
fragment_steps = 10
"#;

/// A training run in a directory of its own.
#[derive(Debug)]
pub struct Run {
    directory: tempfile::TempDir,
}

impl Default for Run {
    fn default() -> Self {
        Self::new()
    }
}

impl Run {
    /// A run with the configuration [`SMALL`].
    #[must_use]
    pub fn new() -> Self {
        let run = Self { directory: tempfile::Builder::new().prefix("cross-test-").tempdir().unwrap() };
        run.write_config(SMALL);
        run
    }

    /// Replaces the configuration that [`Run::train`] starts from.
    pub fn write_config(&self, text: &str) {
        std::fs::write(self.config(), text).unwrap();
    }

    /// The configuration file outside the run directory.
    #[must_use]
    pub fn config(&self) -> PathBuf {
        self.directory.path().join("small.toml")
    }

    /// The run directory.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        self.directory.path().join("run")
    }

    /// What marks the processes of this run.
    #[must_use]
    pub fn marker(&self) -> String {
        self.directory.path().display().to_string()
    }

    /// A `cross` command whose processes can be found by [`Run::marker`].
    #[must_use]
    pub fn cross(&self, arguments: &[&str]) -> Command {
        let mut command = binaries::command("cross");
        command.args(arguments).env("CROSS_TEST_RUN", self.marker()).stdin(Stdio::null());
        command
    }

    /// `cross train` of this run with further arguments, not yet started. A new run gets the configuration of
    /// [`Run::config`]; one that is resumed has its own.
    #[must_use]
    pub fn train(&self, arguments: &[&str]) -> Command {
        let mut command = self.cross(&["train", "--json", "--run"]);
        command.arg(self.path()).args(arguments);
        if !arguments.contains(&"--resume") {
            command.arg("--config").arg(self.config());
        }
        command
    }

    /// Starts `cross train` in the background.
    #[must_use]
    pub fn start(&self, arguments: &[&str]) -> Background<'_> {
        self.spawn(self.train(arguments))
    }

    /// Starts any command of this run in the background.
    #[must_use]
    pub fn spawn(&self, mut command: Command) -> Background<'_> {
        // Files, not pipes: nobody reads while the command runs, and a full pipe would stop it.
        let file = |name: &str| std::fs::File::create(self.directory.path().join(name)).unwrap();
        let child = command.stdout(file("stdout")).stderr(file("stderr")).spawn().unwrap();
        Background { run: self, child: Some(child) }
    }

    /// Runs `cross train` to its end.
    #[must_use]
    pub fn finish(&self, arguments: &[&str]) -> Finished {
        self.start(arguments).wait()
    }

    /// Runs any `cross` command to its end.
    #[must_use]
    pub fn call(&self, arguments: &[&str]) -> Finished {
        self.spawn(self.cross(arguments)).wait()
    }

    /// What the last command of this run has said so far.
    fn said(&self, stream: &str) -> String {
        std::fs::read_to_string(self.directory.path().join(stream)).unwrap_or_default()
    }

    /// Lines of `metrics.jsonl`; a line that is being written is not there yet.
    #[must_use]
    pub fn metrics(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.path().join("metrics.jsonl")).unwrap_or_default();
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        whole.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// The newest update in `metrics.jsonl`, 0 before the first.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.metrics().last().map_or(0, |line| line["update"].as_u64().unwrap())
    }

    /// The directory of the newest checkpoint.
    #[must_use]
    pub fn newest_checkpoint(&self) -> PathBuf {
        let checkpoints = self.path().join("checkpoints");
        let id = std::fs::read_to_string(checkpoints.join("latest")).unwrap();
        checkpoints.join(id.trim())
    }

    /// Everything that `logs/` holds, for a failed assertion to show.
    #[must_use]
    pub fn logs(&self) -> String {
        let mut text = String::new();
        for entry in std::fs::read_dir(self.path().join("logs")).into_iter().flatten().flatten() {
            let log = std::fs::read_to_string(entry.path()).unwrap_or_default();
            let tail: Vec<_> = log.lines().rev().take(30).collect();
            text.push_str(&format!("--- {}\n", entry.path().display()));
            text.extend(tail.into_iter().rev().flat_map(|line| [line, "\n"]));
        }
        text
    }
}

/// A command that runs; killed when dropped, so that a failed test leaves nothing behind.
#[derive(Debug)]
pub struct Background<'a> {
    run: &'a Run,
    child: Option<Child>,
}

impl Background<'_> {
    /// Process id of `cross` itself.
    #[must_use]
    pub fn pid(&self) -> i32 {
        i32::try_from(self.child.as_ref().unwrap().id()).unwrap()
    }

    /// Sends `cross` a signal.
    pub fn send(&self, signal: Signal) {
        assert!(processes::send(self.pid(), signal), "cross is not there any more");
    }

    /// Waits until this many updates are in the metrics.
    pub fn wait_for_updates(&mut self, wanted: u64) {
        wait::until(&format!("update {wanted}"), || {
            self.assert_running();
            (self.run.updates() >= wanted).then_some(())
        });
    }

    /// Waits for a process of a program of this run.
    #[must_use]
    pub fn wait_for(&mut self, program: &str) -> Found {
        let marker = self.run.marker();
        wait::until(program, || {
            self.assert_running();
            processes::of_program(&marker, program).into_iter().next()
        })
    }

    /// Kills a process of a program of this run, surely before it ended by itself.
    pub fn kill_one(&mut self, program: &str) {
        let marker = self.run.marker();
        wait::until(&format!("a {program} to kill"), || {
            self.assert_running();
            let victim = processes::of_program(&marker, program).into_iter().next()?;
            // Stopped, it cannot end by itself between the look and the kill.
            let stopped = processes::send(victim.pid, Signal::STOP);
            let there = processes::of_program(&marker, program).contains(&victim);
            (stopped && there && processes::kill(victim.pid)).then_some(())
        });
    }

    fn assert_running(&mut self) {
        let status = self.child.as_mut().unwrap().try_wait().unwrap();
        assert!(status.is_none(), "cross ended early, {status:?}: {}\n{}", self.errors(), self.run.logs());
    }

    fn errors(&self) -> String {
        self.run.said("stderr")
    }

    /// Waits for the end.
    #[must_use]
    pub fn wait(mut self) -> Finished {
        let mut child = self.child.take().unwrap();
        let status = wait::until("the end of cross", || child.try_wait().unwrap());
        Finished {
            code: status.code(),
            stdout: self.run.said("stdout"),
            stderr: self.errors(),
            logs: self.run.logs(),
        }
    }
}

impl Drop for Background<'_> {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// A command that has ended.
#[derive(Debug)]
pub struct Finished {
    /// Exit code; none if it was killed.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
    logs: String,
}

impl Finished {
    /// The one JSON document on standard output of a command that succeeded.
    ///
    /// # Panics
    /// When it did not succeed, or printed anything else.
    #[must_use]
    pub fn json(&self) -> Value {
        assert_eq!(self.code, Some(0), "{}\n{}", self.stderr, self.logs);
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error} in {}", self.stdout))
    }

    /// Asserts a refusal: exit code 2, nothing on standard output, and one sentence at the end of standard error that
    /// holds all of `parts`.
    ///
    /// # Panics
    /// When it was anything else.
    pub fn assert_refused(&self, parts: &[&str]) {
        assert_eq!(self.code, Some(2), "{}\n{}", self.stderr, self.logs);
        self.assert_sentence(parts);
    }

    /// Asserts one sentence at the end of standard error that holds all of `parts`, and no panic.
    ///
    /// # Panics
    /// When it was anything else.
    pub fn assert_sentence(&self, parts: &[&str]) {
        assert_eq!(self.stdout, "", "a failed command prints no result");
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        let sentence = self.stderr.lines().last().unwrap_or_default();
        assert!(sentence.starts_with("cross: "), "no sentence of cross's own: {}", self.stderr);
        for part in parts {
            assert!(sentence.contains(part), "{part:?} is not in {sentence:?}");
        }
    }
}

/// Asserts that two runs did the same, line by line, apart from times.
///
/// # Panics
/// Shows the first line that differs.
pub fn assert_same_metrics(left: &Run, right: &Run) {
    let (left, right) = (without_times(&left.metrics()), without_times(&right.metrics()));
    for (left, right) in left.iter().zip(&right) {
        assert_eq!(left, right);
    }
    assert_eq!(left.len(), right.len(), "one of the runs has more updates");
}

/// Metrics without `time` and `timing`, the only parts that depend on the clock.
#[must_use]
pub fn without_times(metrics: &[Value]) -> Vec<Value> {
    let strip = |line: &Value| {
        let mut line = line.clone();
        for key in ["time", "timing"] {
            assert!(line.as_object_mut().unwrap().remove(key).is_some(), "there is no {key} in {line}");
        }
        line
    };
    metrics.iter().map(strip).collect()
}

/// Whether two files are equal byte for byte.
#[must_use]
pub fn same_bytes(a: &Path, b: &Path) -> bool {
    std::fs::read(a).unwrap() == std::fs::read(b).unwrap()
}
