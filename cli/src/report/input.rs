//! What the command was given: run directories, folders of evaluations, single files, in any mixture.

use super::run::{self, Run};
use crate::failure::{Failure, Outcome};
use anyhow::Context;
use cross_sim::evaluate::EvalReport;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Folders deeper than this inside a folder are not looked into.
const MAX_DEPTH: usize = 4;
/// Where a run keeps its closing evaluations, with their details.
const EVALUATIONS: &str = "evaluation";

/// Everything a report is about.
#[derive(Debug, Default)]
pub(super) struct Inputs {
    pub(super) runs: Vec<Run>,
    pub(super) evaluations: Vec<Evaluation>,
}

/// An evaluation and where it was found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evaluation {
    pub(super) report: EvalReport,
    /// What tells it from another evaluation of the same policy: a run's name, or a file's.
    pub(super) origin: String,
    /// The folder it lies in, or the run: single seeds are joined only inside one.
    folder: PathBuf,
}

/// Reads all of it.
///
/// # Errors
/// A path that does not exist, holds nothing to report, or a file that is broken or foreign: by name, as bad input.
pub(super) fn read(paths: &[PathBuf]) -> Outcome<Inputs> {
    let mut inputs = Inputs::default();
    for path in paths {
        let found = (inputs.runs.len(), inputs.evaluations.len());
        if path.is_dir() {
            inputs.folder(path, path, 0)?;
        } else {
            inputs.file(path, path)?;
        }
        if found == (inputs.runs.len(), inputs.evaluations.len()) {
            return Err(Failure::input(format!(
                "{} holds neither a run nor an evaluation; name a run directory of `cross train`, or a file that `cross eval --out FILE.json` wrote",
                path.display()
            )));
        }
    }
    inputs.settle();
    Ok(inputs)
}

impl Inputs {
    fn folder(&mut self, given: &Path, path: &Path, depth: usize) -> Outcome<()> {
        if run::is_run(path) {
            return self.run(path);
        }
        for entry in sorted(path)? {
            if entry.is_dir() {
                if depth < MAX_DEPTH {
                    self.folder(given, &entry, depth + 1)?;
                }
            } else if entry.extension().is_some_and(|extension| extension == "json") {
                self.file(given, &entry)?;
            }
        }
        Ok(())
    }

    fn run(&mut self, path: &Path) -> Outcome<()> {
        // The same run by another path, a link or a trailing slash, is the same run.
        let own = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if self.runs.iter().any(|run| run.path == own) {
            return Ok(());
        }
        let (run, closing) = Run::read(path, own)?;
        let origin = run.name.clone();
        let folder = run.path.clone();
        self.runs.push(run);
        let evaluations = path.join(EVALUATIONS);
        if evaluations.is_dir() {
            for file in sorted(&evaluations)? {
                if file.extension().is_some_and(|extension| extension == "json") {
                    let reports = reports(&file)?;
                    self.add(reports, &origin, &folder);
                }
            }
        }
        self.add(closing, &origin, &folder);
        Ok(())
    }

    /// A file that was given, or lies in a folder that was; its origin is its path from there on.
    fn file(&mut self, given: &Path, path: &Path) -> Outcome<()> {
        let reports = reports(path)?;
        let origin = origin(given, &path.with_extension(""));
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        self.add(reports, &origin, &folder);
        Ok(())
    }

    fn add(&mut self, reports: Vec<EvalReport>, origin: &str, folder: &Path) {
        self.evaluations.extend(reports.into_iter().map(|report| Evaluation {
            report,
            origin: origin.to_owned(),
            folder: folder.to_owned(),
        }));
    }

    /// Runs in directories of one name get their parent's with it.
    fn tell_runs_apart(&mut self) {
        let names: Vec<String> = self.runs.iter().map(|run| run.name.clone()).collect();
        for (place, run) in self.runs.iter_mut().enumerate() {
            if names.iter().filter(|name| **name == run.name).count() == 1 {
                continue;
            }
            let parent = run.path.parent().map(name).unwrap_or_default();
            let longer = format!("{parent}/{}", run.name);
            for evaluation in self.evaluations.iter_mut().filter(|evaluation| evaluation.folder == run.path) {
                evaluation.origin.clone_from(&longer);
            }
            run.name = if names.contains(&longer) { format!("{longer} #{}", place + 1) } else { longer };
        }
    }

    /// Shows nothing twice and joins seeds that were kept one by one.
    fn settle(&mut self) {
        self.tell_runs_apart();
        let mut settled: Vec<Evaluation> = Vec::new();
        for evaluation in std::mem::take(&mut self.evaluations) {
            match settled.iter_mut().find(|other| other.shows(&evaluation)) {
                Some(other) if other.report.details.is_none() => other.report = evaluation.report,
                Some(_) => {}
                None => settled.push(evaluation),
            }
        }
        for evaluation in settled {
            let fits = |other: &&mut Evaluation| other.continues(&evaluation);
            match self.evaluations.iter_mut().find(fits) {
                Some(other) => {
                    // A file's name says a seed; the folder's says what they have in common.
                    if let (1, Some((folder, _))) = (other.report.seeds.len(), other.origin.rsplit_once('/'))
                    {
                        other.origin = folder.to_owned();
                    }
                    if let Some(joined) = EvalReport::join([other.report.clone(), evaluation.report.clone()])
                    {
                        other.report = joined;
                    }
                }
                None => self.evaluations.push(evaluation),
            }
        }
    }
}

impl Evaluation {
    /// One for a test.
    #[cfg(test)]
    pub(super) fn sample(report: EvalReport, origin: &str) -> Self {
        Self { report, origin: origin.to_owned(), folder: PathBuf::new() }
    }

    /// Whether the same episodes are in both, details or not.
    fn shows(&self, other: &Self) -> bool {
        let (own, other) = (&self.report, &other.report);
        self.same_kind(other) && own.seeds == other.seeds && own.per_seed == other.per_seed
    }

    /// Whether both are single seeds of one evaluation, kept in files side by side.
    fn continues(&self, other: &Self) -> bool {
        let seeds = &self.report.seeds;
        self.folder == other.folder
            && self.same_kind(&other.report)
            && other.report.seeds.len() == 1
            && !seeds.iter().any(|seed| other.report.seeds.contains(seed))
    }

    fn same_kind(&self, other: &EvalReport) -> bool {
        let own = &self.report;
        (&own.scenario, &own.policy, &own.controller, &own.protocol)
            == (&other.scenario, &other.policy, &other.controller, &other.protocol)
    }
}

/// What a folder holds, by name.
fn sorted(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let entries =
        std::fs::read_dir(folder).and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
    let mut entries: Vec<PathBuf> =
        entries.with_context(|| format!("cannot read the folder {}", folder.display()))?;
    entries.sort();
    Ok(entries)
}

/// The path of a file as people find it: from the folder that was given on, its name included.
fn origin(given: &Path, file: &Path) -> String {
    let inside = file.strip_prefix(given).ok().filter(|inside| !inside.as_os_str().is_empty());
    match inside {
        Some(inside) => format!("{}/{}", name(given), inside.display()),
        None => name(file),
    }
}

/// The last part of a path, which is what people call it.
pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// The evaluations in a JSON file: one, a list of them, or a document that has such a list.
pub(super) fn reports(path: &Path) -> Outcome<Vec<EvalReport>> {
    let text = std::fs::read(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Failure::input(format!(
            "{} does not exist; name a run directory, a folder of evaluations, or a file that `cross eval --out FILE.json` wrote",
            path.display()
        )),
        _ => Failure::from(anyhow::Error::new(error).context(format!("cannot read {}", path.display()))),
    })?;
    let document: Value = serde_json::from_slice(&text).map_err(|error| {
        Failure::input(format!(
            "{} is not JSON or is cut off ({error}); take it out, or write it again with `cross eval --out`",
            path.display()
        ))
    })?;
    from_document(path, document)
}

/// The evaluations in a document that was read from a path.
pub(super) fn from_document(path: &Path, document: Value) -> Outcome<Vec<EvalReport>> {
    let list = match document {
        Value::Array(list) => list,
        Value::Object(mut members) => {
            match [EVALUATIONS, "reports"].into_iter().find_map(|list| members.remove(list)) {
                Some(Value::Array(list)) => list,
                Some(one) => vec![one],
                None if members.contains_key("scenario") && members.contains_key("metrics") => {
                    vec![Value::Object(members)]
                }
                None => return Err(foreign(path)),
            }
        }
        _ => return Err(foreign(path)),
    };
    let parse = |value| {
        serde_json::from_value::<EvalReport>(value).map_err(|error| {
            Failure::input(format!(
                "{} is not an evaluation that this version of CROSS reads ({error}); take it out, or evaluate again with `cross eval --out`",
                path.display()
            ))
        })
    };
    list.into_iter().map(parse).collect()
}

fn foreign(path: &Path) -> Failure {
    Failure::input(format!(
        "{} is JSON, but no evaluation of CROSS; take it out, or name the files that `cross eval --out` wrote one by one",
        path.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use super::*;

    fn write(path: &Path, text: &str) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn labels(inputs: &Inputs) -> Vec<(String, Vec<u32>)> {
        let label =
            |evaluation: &Evaluation| (evaluation.report.policy.clone(), evaluation.report.seeds.clone());
        inputs.evaluations.iter().map(label).collect()
    }

    #[test]
    fn files_lists_and_folders_are_read_and_nothing_is_shown_twice() {
        let folder = tempfile::tempdir().unwrap();
        let (a, b) = (samples::report("grid4x4", "a", &[1, 2]), samples::report("grid4x4", "b", &[1, 2]));
        let list = serde_json::json!({ "evaluation": [a, b], "other": 1 }).to_string();
        write(&folder.path().join("deep/list.json"), &list);
        write(&folder.path().join("a.json"), &a.to_json());
        write(&folder.path().join("notes.txt"), "not looked at");
        let inputs = read(&[folder.path().to_owned(), folder.path().join("a.json")]).unwrap();
        assert_eq!(labels(&inputs), [("a".to_owned(), vec![1, 2]), ("b".to_owned(), vec![1, 2])]);
    }

    #[test]
    fn single_seeds_side_by_side_are_one_evaluation() {
        let folder = tempfile::tempdir().unwrap();
        for seed in [1, 2, 3] {
            let path = folder.path().join(format!("store/seed-{seed}.json"));
            write(&path, &samples::report("grid4x4", "a", &[seed]).to_json());
        }
        write(&folder.path().join("elsewhere/seed-4.json"), &samples::report("grid4x4", "a", &[4]).to_json());
        let inputs = read(&[folder.path().to_owned()]).unwrap();
        assert_eq!(labels(&inputs), [("a".to_owned(), vec![4]), ("a".to_owned(), vec![1, 2, 3])]);
        assert!(
            inputs.evaluations[0].origin.ends_with("/elsewhere/seed-4"),
            "{:?}",
            inputs.evaluations[0].origin
        );
        assert!(inputs.evaluations[1].origin.ends_with("/store"), "{:?}", inputs.evaluations[1].origin);
    }

    #[test]
    fn details_are_kept_whichever_copy_has_them() {
        let folder = tempfile::tempdir().unwrap();
        let full = samples::report("grid4x4", "a", &[1]);
        let mut bare = full.clone();
        bare.details = None;
        write(&folder.path().join("1.json"), &bare.to_json());
        write(&folder.path().join("2.json"), &full.to_json());
        let inputs = read(&[folder.path().to_owned()]).unwrap();
        assert_eq!(inputs.evaluations.len(), 1);
        assert!(inputs.evaluations[0].report.details.is_some());
    }

    #[test]
    fn what_is_missing_broken_or_foreign_is_named_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        std::fs::create_dir(place("empty")).unwrap();
        write(&place("broken/b.json"), "{\"scenario\": \"gri");
        write(&place("foreign.json"), "{\"answer\": 42}");
        write(&place("number.json"), "7");
        write(&place("half.json"), "{\"scenario\": \"grid4x4\", \"metrics\": {}}");
        write(&place("list.json"), "[]");
        let newer = samples::report("s", "p", &[1]).to_json().replacen("\"format\": 1", "\"format\": 99", 1);
        write(&place("newer.json"), &newer);
        for (name, words) in [
            ("nowhere", "does not exist"),
            ("empty", "neither a run nor an evaluation"),
            ("list.json", "neither a run nor an evaluation"),
            ("broken", "b.json is not JSON or is cut off"),
            ("foreign.json", "no evaluation of CROSS"),
            ("number.json", "no evaluation of CROSS"),
            ("half.json", "missing"),
            ("newer.json", "99"),
        ] {
            let failure = read(&[place(name)]).unwrap_err();
            let text = failure.to_string();
            assert!(text.contains(words) && text.contains(name), "{name}: {text}");
            assert_eq!(failure.code(), crate::failure::BAD_INPUT, "{name}");
        }
    }
}
