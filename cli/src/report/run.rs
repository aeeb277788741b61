//! A run directory of `cross train`, finished or not, as far as a report shows it.

use super::{input, number};
use crate::failure::{Failure, OrBadInput, Outcome};
use anyhow::Context;
use cross_config::Config;
use cross_learner::checkpoint::{FOLDER, LATEST_FILE, Metadata, reader};
use cross_learner::metrics_log;
use cross_sim::evaluate::EvalReport;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const CONFIG: &str = "config.toml";
const RESULT: &str = "result.json";

/// A run.
#[derive(Debug, Clone)]
pub(super) struct Run {
    /// Name of its directory.
    pub(super) name: String,
    /// Where it is, free of links.
    pub(super) path: PathBuf,
    /// What it was made with; a run directory without it is shown without settings.
    pub(super) config: Option<Config>,
    /// `config.toml` as it is.
    pub(super) settings: String,
    /// One for each update so far.
    pub(super) lines: Vec<Line>,
    /// Of the newest checkpoint.
    pub(super) checkpoint: Option<Metadata>,
    /// How it ended, once it has.
    pub(super) end: Option<End>,
}

/// A line of `metrics.jsonl`. Members that an older version did not write are empty; a number that is none is `None`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub(super) struct Line {
    pub(super) update: u64,
    #[serde(default)]
    pub(super) decisions: u64,
    #[serde(default)]
    pub(super) episodes: u64,
    #[serde(default)]
    pub(super) scenarios: BTreeMap<String, ScenarioLine>,
    #[serde(default)]
    pub(super) losses: BTreeMap<String, Option<f64>>,
    #[serde(default)]
    pub(super) diagnostics: BTreeMap<String, Option<f64>>,
    #[serde(default)]
    pub(super) expert_usage: Vec<Option<f64>>,
    #[serde(default)]
    pub(super) cluster_usage: Vec<Option<f64>>,
    #[serde(default)]
    pub(super) lag: Lag,
    #[serde(default)]
    pub(super) timing: Timing,
}

/// A scenario in a [`Line`].
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub(super) struct ScenarioLine {
    pub(super) episode_return: Option<f64>,
    pub(super) queue_length: Option<f64>,
    #[serde(default)]
    pub(super) diagnostics: BTreeMap<String, Option<f64>>,
    #[serde(default)]
    pub(super) expert_usage: Vec<Option<f64>>,
    #[serde(default)]
    pub(super) cluster_usage: Vec<Option<f64>>,
}

/// Policy versions that the data was behind.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
pub(super) struct Lag {
    pub(super) mean: Option<f64>,
    pub(super) max: Option<f64>,
}

/// Seconds that an update took.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
pub(super) struct Timing {
    pub(super) collect_seconds: Option<f64>,
    pub(super) update_seconds: Option<f64>,
}

/// What `result.json` says of the end.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct End {
    pub(super) interrupted: bool,
    #[serde(default)]
    pub(super) elapsed_seconds: f64,
}

/// Whether a directory is one of `cross train`.
pub(super) fn is_run(path: &Path) -> bool {
    [CONFIG, metrics_log::FILE, FOLDER, "run.json"].iter().any(|part| path.join(part).exists())
}

impl Run {
    /// Reads what there is, and the closing evaluation if there is one. `own` is the path free of links.
    ///
    /// # Errors
    /// A file that is there and cannot be read: by name, as bad input.
    pub(super) fn read(path: &Path, own: PathBuf) -> Outcome<(Self, Vec<EvalReport>)> {
        let settings = text(&path.join(CONFIG))?.unwrap_or_default();
        let config = match settings.as_str() {
            "" => None,
            _ => Some(Config::from_run(&path.join(CONFIG)).or_bad_input()?),
        };
        let metrics = path.join(metrics_log::FILE);
        let lines = text(&metrics)?.map_or(Ok(Vec::new()), |text| lines(&metrics, &text))?;
        // A run that has not come to its first checkpoint has none; a damaged one is the business of `cross checkpoint`.
        let checkpoint = reader::find(path, LATEST_FILE).and_then(|folder| reader::metadata(&folder)).ok();
        let (end, closing) = match text(&path.join(RESULT))? {
            Some(text) => result(&path.join(RESULT), &text)?,
            None => (None, Vec::new()),
        };
        let run = Self { name: input::name(&own), path: own, config, settings, lines, checkpoint, end };
        Ok((run, closing))
    }

    /// The scenarios that were trained on.
    pub(super) fn scenarios(&self) -> Vec<String> {
        match (&self.config, self.lines.last()) {
            (Some(config), _) => config.scenarios.clone(),
            (None, Some(line)) => line.scenarios.keys().cloned().collect(),
            (None, None) => Vec::new(),
        }
    }

    /// How far it came, in words.
    pub(super) fn state(&self) -> String {
        let done = self.lines.last().map_or(0, |line| line.update);
        let done = match &self.config {
            Some(config) => format!("{done} of {}", number::counted(config.updates as usize, "update")),
            None => number::counted(done as usize, "update"),
        };
        match &self.end {
            Some(End { interrupted: false, .. }) => format!("complete, {done}"),
            Some(_) => format!("stopped on request after {done}"),
            None => format!("{done} so far; no result yet: it is going on, or it ended early"),
        }
    }
}

/// A file's text, if it is there.
fn text(path: &Path) -> Outcome<Option<String>> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(String::from_utf8_lossy(&bytes).into_owned())),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => {
            Err(error).with_context(|| format!("cannot read {}", path.display())).map_err(Failure::from)
        }
    }
}

/// The whole lines; one that is being written is not there yet.
fn lines(path: &Path, text: &str) -> Outcome<Vec<Line>> {
    let whole = text.split_inclusive('\n').filter(|line| line.ends_with('\n'));
    let parse = |(number, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|error| {
            Failure::input(format!(
                "line {} of {} is not one that `cross train` wrote ({error}); take that line out, or leave out this run",
                number + 1,
                path.display()
            ))
        })
    };
    whole.enumerate().map(parse).collect()
}

fn result(path: &Path, text: &str) -> Outcome<(Option<End>, Vec<EvalReport>)> {
    let wrong = |error: serde_json::Error| {
        Failure::input(format!(
            "{} is not a result that this version of CROSS reads ({error}); remove it to report the run without its closing comparison",
            path.display()
        ))
    };
    let document: Value = serde_json::from_str(text).map_err(wrong)?;
    let end = End::deserialize(&document).map_err(wrong)?;
    let closing = match document.get("evaluation") {
        None => Vec::new(),
        Some(list) => Vec::<EvalReport>::deserialize(list).map_err(wrong)?,
    };
    Ok((Some(end), closing))
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use super::*;

    const LINES: &str = "{\"update\":1,\"scenarios\":{\"grid4x4\":{\"episode_return\":-8.5,\"queue_length\":null}},\"losses\":{\"a\":null}}\n{\"update\":2,\"lag\":{\"min\":0,\"mean\":0.5,\"max\":1}}\n{\"upd";

    fn read(files: &[(&str, &str)]) -> Outcome<(Run, Vec<EvalReport>)> {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        Run::read(folder.path(), folder.path().to_owned())
    }

    #[test]
    fn a_run_that_goes_on_shows_its_whole_lines() {
        let (run, closing) = read(&[("metrics.jsonl", LINES), ("config.toml", "updates = 9\n")]).unwrap();
        assert_eq!(run.lines.len(), 2);
        assert_eq!(run.lines[0].scenarios["grid4x4"].episode_return, Some(-8.5));
        assert_eq!(run.lines[1].lag.mean, Some(0.5));
        assert!(closing.is_empty());
        assert!(run.state().starts_with("2 of 9 updates so far"), "{}", run.state());
    }

    #[test]
    fn a_finished_run_has_its_closing_evaluation() {
        let report = samples::report("grid4x4", "cross", &[1]);
        let result =
            serde_json::json!({ "interrupted": false, "evaluation": [report], "elapsed_seconds": 3.5 });
        let (run, closing) = read(&[("result.json", &result.to_string()), ("metrics.jsonl", LINES)]).unwrap();
        assert_eq!(closing, [report]);
        assert_eq!(run.state(), "complete, 2 updates");
        let (run, _) = read(&[("result.json", "{\"interrupted\": true}")]).unwrap();
        assert_eq!(run.state(), "stopped on request after 0 updates");
    }

    #[test]
    fn damaged_files_are_named() {
        for (file, text, words) in [
            ("metrics.jsonl", "{\"update\":1}\nrubbish\n", "line 2 of"),
            ("result.json", "{", "result.json is not a result"),
            ("result.json", "{\"interrupted\":false,\"evaluation\":[{}]}", "result.json is not a result"),
            ("config.toml", "sed = 1\n", "config.toml"),
        ] {
            let failure = read(&[(file, text)]).unwrap_err();
            assert!(failure.to_string().contains(words), "{failure}");
            assert_eq!(failure.code(), crate::failure::BAD_INPUT);
        }
    }
}
