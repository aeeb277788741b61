//! `cross report`: runs and evaluations as one HTML page.

use crate::failure::{Failure, Outcome};
use crate::output;
use crate::output_file::OutputFile;
use crate::report::{Content, make, summary};
use crate::train::progress::say;
use clap::Args;
use serde::Serialize;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Makes one HTML page of runs and evaluations: tables beside the paper's, and plots
///
/// The page is a single file that any browser shows without a network: send it, print it, put it on a slide. For every scenario
/// it has the table of results beside the published figures, the metrics with their seeds, queue and speed over time, the
/// distribution of trip times, and a map of where vehicles stand; for every training run its learning curves. The protocol and
/// the seeds stand beside each result, and results that may not be compared are marked.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross report runs/20260131-235959                        a run: its curves and its closing comparison
  cross report runs/* --out runs.html                      several runs over each other
  mkdir results
  cross eval --scenario grid4x4 --policy max-pressure --out results/max-pressure.json
  cross eval --scenario grid4x4 --policy fixed-time --out results/fixed-time.json
  cross report results --out grid4x4.html                  all evaluations of a folder
  cross report results runs/paper-3 --title \"Seed 3 against the rules\"

A folder is searched for evaluations (*.json) and run directories. A run that is still going on is shown as far as it is.
Curves over time, distributions and maps need evaluations with details, which `cross eval --out FILE.json` writes.
A file that is broken or of another kind is named, with exit code 2, and no page is written.")]
pub(crate) struct Report {
    /// Run directories of `cross train`, folders of evaluations, or files that `cross eval --out` wrote
    #[arg(value_name = "DIR", required = true)]
    paths: Vec<PathBuf>,
    /// The page to write; an older page there is replaced
    #[arg(long, value_name = "FILE.html", default_value = "report.html")]
    out: PathBuf,
    /// Heading of the page
    #[arg(long, value_name = "TEXT", default_value = "CROSS report")]
    title: String,
    /// Print what the page holds as one JSON document
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    page: &'a Path,
    bytes: usize,
    #[serde(flatten)]
    content: &'a Content,
}

impl Report {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        refuse_other_files(&self.out)?;
        let out = OutputFile::prepare(&self.out)?;
        let page = make(&self.title, &self.paths)?;
        out.write(page.html.as_bytes())?;
        let Content { runs, scenarios, evaluations, warnings } = &page.content;
        for warning in warnings {
            say(&format!("warning: {warning}"));
        }
        if self.json {
            output::json(&Summary { page: &self.out, bytes: page.html.len(), content: &page.content })?;
        } else {
            output::text(&format!(
                "{}: {}",
                self.out.display(),
                summary(*evaluations, scenarios.len(), runs.len())
            ))?;
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// A slip of the hand must not cost a result: only a page is replaced.
fn refuse_other_files(out: &Path) -> Outcome<()> {
    // Devices and pipes hold nothing that could be lost, and opening a pipe would wait for its writer.
    if !out.is_file() {
        return Ok(());
    }
    let mut start = Vec::new();
    let opened = std::fs::File::open(out).and_then(|file| file.take(9).read_to_end(&mut start));
    // What cannot be read cannot be told to be a page.
    if opened.is_ok() && (start.is_empty() || start.eq_ignore_ascii_case(b"<!doctype")) {
        return Ok(());
    }
    Err(Failure::input(format!("{} exists and is no HTML page; name another file with --out", out.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pages_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        std::fs::write(place("old.html"), "<!DOCTYPE html><html>").unwrap();
        std::fs::write(place("result.json"), "{}").unwrap();
        refuse_other_files(&place("old.html")).unwrap();
        refuse_other_files(&place("new.html")).unwrap();
        let failure = refuse_other_files(&place("result.json")).unwrap_err();
        assert!(
            failure.to_string().contains("--out") && failure.code() == crate::failure::BAD_INPUT,
            "{failure}"
        );
    }
}
