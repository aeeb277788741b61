//! The description of a checkpoint.

use super::error::CheckpointError;
use crate::admission::Progress;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// What the description calls itself.
pub const FORMAT: &str = "cross-checkpoint";
/// Version of the directory's form; grows when an old reader would misread a new checkpoint.
pub const FORMAT_VERSION: u32 = 1;

/// `metadata.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    /// [`FORMAT`].
    pub format: String,
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// Name of the checkpoint's directory.
    pub id: String,
    /// Run that wrote it.
    pub run_id: String,
    /// When, UTC.
    pub created: String,
    /// The same, milliseconds since 1970.
    pub created_unix_ms: u64,
    /// Updates done.
    pub updates: u64,
    /// Version of the weights.
    pub policy_version: u64,
    /// Agent-decisions trained on.
    pub decisions: u64,
    /// Episodes finished.
    pub episodes: u64,
    /// Seed of the run.
    pub seed: u64,
    /// Mean episode return of each scenario at the time, raw.
    pub episode_return: BTreeMap<String, f64>,
    /// Hash of the whole configuration.
    pub config_hash: String,
    /// Hash of what must be the same to use the weights.
    pub compatibility_hash: String,
    /// Layout hash of each scenario.
    pub layouts: BTreeMap<String, String>,
    /// What was installed.
    pub versions: Versions,
    /// Where its updates were last computed; any other device can go on from here.
    #[serde(default)]
    pub device: String,
    /// Ids of the checkpoints whose mean the weights are, oldest first; empty where they are one checkpoint's own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub averaged: Vec<String>,
    /// Size and hash of each file beside this one.
    pub files: BTreeMap<String, FileInfo>,
    /// Counters from which admission goes on.
    pub progress: Progress,
    /// The configuration, as `cross_config::Config` reads it.
    pub config: serde_json::Value,
}

/// What was installed where a checkpoint was written.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Versions {
    /// CROSS.
    pub cross: String,
    /// SUMO at the actors; empty if none had joined.
    pub sumo: String,
    /// libtorch.
    pub libtorch: String,
}

/// Size and hash of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileInfo {
    /// Size.
    pub bytes: u64,
    /// SHA-256, 64 hex digits.
    pub sha256: String,
}

impl FileInfo {
    /// Of these bytes.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, sha256: hex::encode(Sha256::digest(bytes)) }
    }
}

impl Metadata {
    /// Reads a description. Format and version are looked at first, so that a newer form is named as such and not as a list
    /// of missing fields.
    ///
    /// # Errors
    /// [`CheckpointError::Foreign`] or [`CheckpointError::FormatVersion`], with the file's name.
    pub fn parse(text: &str, path: &Path) -> Result<Self, CheckpointError> {
        let foreign = |reason: String| CheckpointError::Foreign { path: path.to_owned(), reason };
        let value: serde_json::Value =
            serde_json::from_str(text).map_err(|error| foreign(format!("it is not valid JSON ({error})")))?;
        match value.get("format").and_then(serde_json::Value::as_str) {
            Some(FORMAT) => {}
            Some(other) => return Err(foreign(format!("its format is {other:?} instead of {FORMAT:?}"))),
            None => return Err(foreign(format!("it lacks \"format\": {FORMAT:?}"))),
        }
        match value.get("format_version").and_then(serde_json::Value::as_u64) {
            Some(version) if version == u64::from(FORMAT_VERSION) => {}
            Some(got) => {
                return Err(CheckpointError::FormatVersion {
                    path: path.to_owned(),
                    got,
                    expected: FORMAT_VERSION,
                });
            }
            None => return Err(foreign("it lacks \"format_version\"".to_owned())),
        }
        serde_json::from_value(value).map_err(|error| foreign(error.to_string()))
    }

    /// When it was written.
    #[must_use]
    pub fn created_at(&self) -> SystemTime {
        UNIX_EPOCH + Duration::from_millis(self.created_unix_ms)
    }
}

/// A point in time as RFC 3339 in UTC, to the second.
#[must_use]
pub fn rfc3339(time: SystemTime) -> String {
    let seconds = time.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Days since 1 March of year 0, in eras of 400 years: the leap day is then a year's last.
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}
