//! `cross scenario list`.

use crate::failure::Outcome;
use crate::output;
use clap::Args;
use cross_sim::scenario::{self, Scenario};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Every scenario that has a name here
#[derive(Debug, Args)]
pub(crate) struct List {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Listed {
    name: String,
    directory: PathBuf,
    /// Why it cannot be used as it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    #[serde(skip_serializing_if = "String::is_empty")]
    description: String,
}

impl List {
    pub(super) fn run(&self) -> Outcome<()> {
        let listed: Vec<_> = scenario::catalogue()
            .into_iter()
            .map(|entry| {
                let (description, problem) = match Scenario::from_directory(&entry.directory) {
                    Ok(loaded) => (loaded.description, None),
                    Err(error) => (String::new(), Some(error.to_string())),
                };
                Listed { name: entry.name, directory: entry.directory, problem, description }
            })
            .collect();
        if self.json {
            return output::json(&serde_json::json!({ "scenarios": listed }));
        }
        output::text(&render(&listed))
    }
}

fn render(listed: &[Listed]) -> String {
    if listed.is_empty() {
        return "no scenario was found; run this from the project, or set CROSS_SCENARIOS".to_owned();
    }
    let width = listed.iter().map(|entry| entry.name.len()).max().unwrap_or(0);
    let mut text = String::new();
    for entry in listed {
        let problem = entry.problem.as_ref().map(|problem| format!("not usable: {problem}"));
        let _ = writeln!(text, "{:width$}  {}", entry.name, problem.as_ref().unwrap_or(&entry.description));
    }
    text
}
