//! `cross baselines`: the table of rules, beside the paper's figures.

use crate::baselines::plan::Plan;
use crate::baselines::report::Report;
use crate::baselines::run::{End, complete};
use crate::baselines::store::Store;
use crate::baselines::{page, pictures};
use crate::evaluate::default_workers;
use crate::failure::{Failure, OrBadInput, Outcome};
use crate::output;
use crate::output_file::OutputFile;
use crate::policy::PolicySpec;
use crate::sumo::SumoOption;
use crate::train::progress::say;
use anyhow::Context;
use clap::Args;
use cross_config::EnvConfig;
use cross_sim::controller::RuleBased;
use std::path::{Component, Path, PathBuf};
use std::process::ExitCode;

/// Evaluates the rules on the paper's scenarios, beside its figures and an independent measurement
///
/// Finished episodes are kept in a folder, so that the command may be stopped and called again. They count while these are the
/// same: this program's version and generation of figures (raised with every change of simulation, rules or metrics that may
/// alter one), SUMO's version, settings, net and demand. Writes a page of Markdown, the protocol included.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross baselines --markdown docs/baselines.md                  all eight, about an hour of CPU time
  cross baselines --scenario grid4x4 --policy fixed-time --policy max-pressure --seeds 1
  cross baselines --scenario my/own/directory --json

Without --scenario those of the eight that were not imported are named and left out; what --scenario names must be there.
Ctrl-C: the episodes under way are lost, the finished ones kept, exit code 1.")]
pub(crate) struct Baselines {
    /// Rule; repeat it for several [default: all but random]
    #[arg(long = "policy", value_name = "RULE")]
    policies: Vec<RuleBased>,
    /// SUMO seeds 1 to N [default: 3, on grid5x5 10; of unpublished rules on large scenarios 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    seeds: Option<u32>,
    #[command(flatten)]
    table: Table,
}

impl Baselines {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let policies: Vec<_> = self.policies.iter().copied().map(PolicySpec::Rule).collect();
        let mut words = vec!["cross baselines".to_owned()];
        words.extend(self.policies.iter().map(|policy| format!("--policy {policy}")));
        words.extend(self.seeds.map(|seeds| format!("--seeds {seeds}")));
        self.table.make(words, &policies, self.seeds, None, page::render)
    }
}

/// What every table of policies is made with.
#[derive(Debug, Args)]
pub(crate) struct Table {
    /// Scenario, by name or directory; repeat it for several [default: the eight of the paper]
    #[arg(long = "scenario", value_name = "NAME")]
    scenarios: Vec<String>,
    /// Folder of the finished episodes
    #[arg(long, value_name = "DIR", default_value = "runs/baselines")]
    out: PathBuf,
    /// Write the page there instead of to standard output
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Episodes at a time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    workers: Option<u16>,
    #[command(flatten)]
    sumo: SumoOption,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

impl Table {
    /// Simulates what is missing and shows all of it. `words` are the command so far, for whoever makes the table again.
    pub(crate) fn make(
        &self,
        mut words: Vec<String>,
        policies: &[PolicySpec],
        seeds: Option<u32>,
        picture_folder: Option<&Path>,
        render: fn(&Report) -> String,
    ) -> Outcome<ExitCode> {
        // Before an hour of work.
        let markdown = self.markdown.as_deref().map(OutputFile::prepare).transpose()?;
        let home = self.sumo.locate()?;
        let version = home.version().or_bad_input()?;
        let plan = Plan::new(&self.scenarios, policies, seeds, EnvConfig::default(), version)?;
        for missing in &plan.missing {
            say(&format!("without {}: {}", missing.scenario, missing.reason));
        }
        if let Some(folder) = picture_folder {
            pictures::prepare(&plan, folder)?;
        }
        let mut store = Store::open(&self.out)?;
        if picture_folder.is_some() {
            store = store.with_courses();
        }
        let workers = self.workers.map_or_else(default_workers, usize::from);
        if let End::Stopped { left } = complete(&plan, &store, &home, workers)? {
            return Err(Failure::failed(format!(
                "stopped; {} left, and the same command goes on with {}",
                if left == 1 { "one episode is".to_owned() } else { format!("{left} episodes are") },
                if left == 1 { "it" } else { "them" },
            )));
        }
        words.splice(1..1, self.scenarios.iter().map(|scenario| format!("--scenario {}", quoted(scenario))));
        let mut report = Report::read(&plan, &store, words.join(" "))?;
        if let Some(folder) = picture_folder {
            pictures::draw(&plan, &store, &report.scenarios, folder)?;
            report.pictures = Some(from_page(folder, self.markdown.as_deref())?);
        }
        let page = render(&report);
        if let Some(file) = &markdown {
            file.write(page.as_bytes())?;
        }
        match &markdown {
            _ if self.json => output::json(&report)?,
            Some(file) => {
                let count = report.scenarios.len();
                let plural = if count == 1 { "" } else { "s" };
                output::text(&format!("{count} scenario{plural}, page: {}", file.path().display()))?;
            }
            None => output::text(&page)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// A folder, which is there, as a page refers to it: from where the page is. A page that goes to standard output is where it is
/// made.
fn from_page(folder: &Path, page: Option<&Path>) -> Outcome<PathBuf> {
    let parent = match page.and_then(Path::parent) {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let whole = |path: &Path| {
        path.canonicalize().with_context(|| format!("cannot find out where {} is", path.display()))
    };
    let (folder, parent) = (whole(folder)?, whole(parent)?);
    let shared = folder.components().zip(parent.components()).take_while(|(a, b)| a == b).count();
    let up = parent.components().skip(shared).map(|_| Component::ParentDir);
    Ok(up.chain(folder.components().skip(shared)).collect())
}

/// A word as a shell takes it: in quotes where it has to be.
pub(super) fn quoted(word: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_./=:@%+,".contains(letter);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_found_from_the_page() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("docs/images");
        std::fs::create_dir_all(&folder).unwrap();
        let from = |page: &str| from_page(&folder, Some(&root.path().join(page))).unwrap();
        assert_eq!(from("docs/results.md"), Path::new("images"));
        assert_eq!(from("./docs/../docs/results.md"), Path::new("images"));
        assert_eq!(from("results.md"), Path::new("docs/images"));
        assert_eq!(from("docs/images/results.md"), Path::new(""));
        std::fs::create_dir(root.path().join("pages")).unwrap();
        assert_eq!(from("pages/results.md"), Path::new("../docs/images"));
    }

    #[test]
    fn odd_words_are_quoted_for_the_shell() {
        for (word, shown) in [
            ("my/grid-4", "my/grid-4"),
            ("a b", "'a b'"),
            ("", "''"),
            ("$(x)", "'$(x)'"),
            ("it's", r"'it'\''s'"),
        ] {
            assert_eq!(quoted(word), shown);
        }
    }
}
