//! The page that `cross report` writes: tables and drawings of evaluations and runs, in one HTML file.
//!
//! ```text
//!   paths ── input ──> runs, evaluations ── group ──> by scenario ── page ──> HTML
//!                                                       scenario_section: results (tables), protocol (warnings),
//!                                                         dot_plot, line_chart, histogram, heat_map
//!                                                       run_section: run_panels, line_chart
//! ```
//! Drawings are SVG inside the page, coloured by its style sheet, so that they follow a dark theme and print; a plotting
//! library fixes its colours. Everything that comes from a file is escaped by the template macro. The same inputs give the
//! same bytes.

mod dot_plot;
mod figure;
mod group;
mod heat_map;
mod histogram;
mod input;
mod line_chart;
mod number;
mod page;
mod protocol;
mod results;
mod run;
mod run_panels;
mod run_section;
#[cfg(test)]
mod samples;
mod scale;
mod scenario_section;

pub(crate) use page::summary;

use crate::failure::Outcome;
use serde::Serialize;
use std::path::PathBuf;

/// A page, and what is in it.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) html: String,
    pub(crate) content: Content,
}

/// What a page holds, for scripts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Content {
    /// Names of the runs.
    pub(crate) runs: Vec<String>,
    /// Names of the scenarios.
    pub(crate) scenarios: Vec<String>,
    /// Evaluations, each a policy on a scenario.
    pub(crate) evaluations: usize,
    /// What the page warns of: protocols or seeds that differ, gridlock.
    pub(crate) warnings: Vec<String>,
}

/// Reads runs and evaluations and makes the page of them.
///
/// # Errors
/// A path without anything to report, or a broken or foreign file, by name.
pub(crate) fn make(title: &str, paths: &[PathBuf]) -> Outcome<Page> {
    let inputs = input::read(paths)?;
    let groups = group::groups(&inputs.evaluations);
    let grave = |group: &group::Group<'_>| {
        let cautions = protocol::cautions(group).into_iter().filter(|caution| caution.grave);
        cautions.map(|caution| format!("{}: {}", group.scenario, caution.text)).collect::<Vec<_>>()
    };
    let content = Content {
        runs: inputs.runs.iter().map(|run| run.name.clone()).collect(),
        scenarios: groups.iter().map(|group| group.scenario.to_owned()).collect(),
        evaluations: inputs.evaluations.len(),
        warnings: groups.iter().flat_map(grave).collect(),
    };
    Ok(Page { html: page::page(title, &inputs, paths).into_string(), content })
}
