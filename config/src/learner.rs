//! The processes: learner and actors.

use crate::env::EnvConfig;
use crate::error::{ConfigError, in_range};
use serde::{Deserialize, Serialize};

/// Where the learner computes its updates. Actors always act on the CPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ComputeDevice {
    /// CUDA if libtorch has it and a device is there, else the CPU. The CPU in serial mode, which must repeat exactly.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// The first CUDA device; refused where there is none.
    Cuda,
}

/// What the large matrix products of an update are computed in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// bfloat16 in the linear layers; weights, gradients of weights and Adam's moments stay in single precision.
    Bf16,
}

impl std::str::FromStr for ComputeDevice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "cuda" => Ok(Self::Cuda),
            _ => Err("it must be auto, cpu or cuda".to_owned()),
        }
    }
}

/// The learner process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearnerConfig {
    /// Where updates are computed: `auto`, `cpu` or `cuda`.
    pub device: ComputeDevice,
    /// Precision of the large matrix products: `f32` or `bf16`.
    pub precision: Precision,
    /// Lock-step mode: one actor, no collection during an update, repeats bit for bit.
    pub serial: bool,
    /// Most policy versions that a fragment may be behind; older ones are dropped and counted.
    pub max_policy_lag: u64,
    /// Rounds that may wait in the buffer per scenario before back-pressure stops the streams.
    pub buffered_rounds: u32,
    /// Updates between two checkpoints; the last update always writes one.
    pub checkpoint_updates: u64,
    /// Newest checkpoints that are kept.
    pub keep_checkpoints: usize,
    /// Where checkpoints are copied besides the run directory: `s3://BUCKET/PATH`, `gs://`, `az://` or `file:///FOLDER`; empty
    /// for nowhere. Credentials come from the environment.
    pub checkpoint_url: String,
    /// Most actors at a time.
    pub max_actors: usize,
    /// Most connections of any client at a time; more are closed at once.
    pub max_connections: usize,
    /// Most calls open at a time, streams included: an actor has two.
    pub max_streams: usize,
    /// Calls that one address may begin a second, on average; ten seconds' worth at once.
    pub requests_per_second: u32,
    /// Largest gRPC message, bytes.
    pub max_message_bytes: usize,
    /// Seconds without a message of an actor (it sends heartbeats) after which its lease ends.
    pub lease_seconds: u64,
    /// Seconds a drain may take after SIGTERM, the update in progress included, before the process exits regardless.
    pub drain_seconds: u64,
}

impl Default for LearnerConfig {
    fn default() -> Self {
        Self {
            device: ComputeDevice::Auto,
            precision: Precision::F32,
            serial: false,
            max_policy_lag: 4,
            buffered_rounds: 1,
            checkpoint_updates: 10,
            keep_checkpoints: 5,
            checkpoint_url: String::new(),
            max_actors: 1024,
            max_connections: 4096,
            max_streams: 8192,
            requests_per_second: 200,
            max_message_bytes: 16 * 1024 * 1024,
            lease_seconds: 30,
            drain_seconds: 60,
        }
    }
}

impl LearnerConfig {
    pub(crate) fn validate(&self, _env: &EnvConfig) -> Result<(), ConfigError> {
        in_range("learner.max_policy_lag", self.max_policy_lag, 0, 1_000_000)?;
        in_range("learner.buffered_rounds", self.buffered_rounds, 1, 1000)?;
        in_range("learner.checkpoint_updates", self.checkpoint_updates, 1, 1_000_000)?;
        in_range("learner.keep_checkpoints", self.keep_checkpoints, 1, 1_000_000)?;
        if !self.checkpoint_url.is_empty() {
            checkpoint_url(&self.checkpoint_url)
                .map_err(|problem| ConfigError::invalid("learner.checkpoint_url", problem))?;
        }
        in_range("learner.max_actors", self.max_actors, 1, 1_000_000)?;
        in_range("learner.max_connections", self.max_connections, 1, 1_000_000)?;
        in_range("learner.max_streams", self.max_streams, 1, 1_000_000)?;
        in_range("learner.requests_per_second", self.requests_per_second, 1, 1_000_000)?;
        in_range("learner.max_message_bytes", self.max_message_bytes, 64 * 1024, 1 << 30)?;
        in_range("learner.lease_seconds", self.lease_seconds, 1, 3600)?;
        in_range("learner.drain_seconds", self.drain_seconds, 1, 3600)
    }
}

/// Whether a text has the form of a URL for checkpoints. What it names is not looked at.
///
/// # Errors
/// What is wrong, as the end of a sentence. Nothing of the URL is repeated: it may hold what it must not, a password.
pub fn checkpoint_url(url: &str) -> Result<(), String> {
    const FORM: &str = "must be s3://BUCKET/PATH, gs://BUCKET/PATH, az://CONTAINER/PATH or file:///FOLDER";
    let Some((scheme, place)) = url.split_once("://") else { return Err(FORM.to_owned()) };
    if url.chars().any(|c| c.is_whitespace() || c.is_control() || matches!(c, '?' | '#')) {
        return Err(format!("{FORM}, without spaces, `?` and `#`"));
    }
    let (bucket, path) = place.split_once('/').unwrap_or((place, ""));
    if bucket.contains('@') || bucket.contains(':') {
        return Err("holds a user or a password; credentials go into the environment".to_owned());
    }
    if path.split('/').any(|part| matches!(part, "." | "..")) {
        return Err(format!("{FORM}, without `.` and `..`"));
    }
    match scheme {
        "s3" | "gs" | "az" if !bucket.is_empty() => Ok(()),
        "file" if bucket.is_empty() && !path.trim_matches('/').is_empty() => Ok(()),
        _ => Err(FORM.to_owned()),
    }
}

/// The actor processes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActorConfig {
    /// Most steps in a fragment. Weights are swapped between fragments.
    pub fragment_steps: u32,
    /// Fragments that may be sent and not yet acknowledged.
    pub unacked_fragments: usize,
    /// Seconds a call to SUMO may take.
    pub sumo_timeout_seconds: u64,
    /// Seconds without a learner after which an actor gives up.
    pub give_up_seconds: u64,
    /// SUMO starts that may fail in a row before an actor gives up.
    pub max_sumo_failures: u32,
}

impl Default for ActorConfig {
    fn default() -> Self {
        Self {
            fragment_steps: 120,
            unacked_fragments: 2,
            sumo_timeout_seconds: 60,
            give_up_seconds: 600,
            max_sumo_failures: 5,
        }
    }
}

impl ActorConfig {
    pub(crate) fn validate(&self, env: &EnvConfig) -> Result<(), ConfigError> {
        in_range("actor.fragment_steps", self.fragment_steps, 1, env.steps_per_episode())?;
        in_range("actor.unacked_fragments", self.unacked_fragments, 1, 1024)?;
        in_range("actor.sumo_timeout_seconds", self.sumo_timeout_seconds, 1, 3600)?;
        in_range("actor.give_up_seconds", self.give_up_seconds, 1, 30 * 24 * 3600)?;
        in_range("actor.max_sumo_failures", self.max_sumo_failures, 1, 1000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_for_checkpoints_has_a_form_and_no_password() {
        for good in ["s3://b", "s3://b/runs/a", "gs://b/x", "az://c/x", "file:///var/cross"] {
            assert_eq!(checkpoint_url(good), Ok(()), "{good}");
        }
        for bad in
            ["", "b/x", "/b", "s3:///x", "file://b/x", "file:///", "http://b/x", "s3://b/../x", "s3://b/x y"]
        {
            assert!(checkpoint_url(bad).unwrap_err().contains("s3://BUCKET"), "{bad}");
        }
        for secret in ["s3://KEY:hidden@b/x", "s3://hidden@b"] {
            let error = checkpoint_url(secret).unwrap_err();
            assert!(error.contains("environment") && !error.contains("hidden"), "{error}");
        }
    }

    #[test]
    fn a_device_is_spelled_alike_on_the_command_line_and_in_the_file() {
        for device in [ComputeDevice::Auto, ComputeDevice::Cpu, ComputeDevice::Cuda] {
            let written = serde_json::to_string(&device).unwrap();
            assert_eq!(written.trim_matches('"').parse(), Ok(device));
        }
        assert!("gpu".parse::<ComputeDevice>().unwrap_err().contains("cuda"));
    }
}
