//! The page around it all: one file that needs nothing else.

use super::group::Group;
use super::input::Inputs;
use super::number::counted;
use super::results::{self, anchor};
use super::{group, protocol, run_section, scenario_section};
use cross_sim::metrics::{Metric, definitions};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::path::PathBuf;

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("values.js");
/// The page may show itself and nothing else: whatever a name in it says, a browser loads nothing.
const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:";
/// Metrics of the tables over all scenarios: the first is seen at once.
const OVERVIEW: [Metric; 6] = [
    Metric::TripDelay,
    Metric::TripTime,
    Metric::QueueLength,
    Metric::Speed,
    Metric::TripCompletionRate,
    Metric::TripDuration,
];

/// The whole page.
pub(super) fn page(title: &str, inputs: &Inputs, paths: &[PathBuf]) -> Markup {
    let groups = group::groups(&inputs.evaluations);
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="generator" content=(concat!("cross ", env!("CARGO_PKG_VERSION")));
                title { (title) }
                link rel="icon" href="data:,";
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    h1 { (title) }
                    p .lead { (summary(inputs.evaluations.len(), groups.len(), inputs.runs.len())) }
                    (contents(inputs, &groups))
                }
                main {
                    @if groups.len() > 1 { (overview(&groups)) }
                    @for group in &groups { (scenario_section::section(group)) }
                    (run_section::comparison(&inputs.runs))
                    @for run in &inputs.runs { (run_section::section(run)) }
                    @if !groups.is_empty() { (glossary()) }
                }
                footer {
                    p {
                        "Made by " code { "cross report" } " " (env!("CARGO_PKG_VERSION")) " from "
                        @for (number, path) in paths.iter().enumerate() {
                            @if number > 0 { ", " }
                            code { (path.display().to_string()) }
                        }
                        "."
                    }
                }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    }
}

/// How much of each there is.
pub(crate) fn summary(evaluations: usize, scenarios: usize, runs: usize) -> String {
    let mut parts = Vec::new();
    if scenarios > 0 {
        parts.push(counted(evaluations, "evaluation"));
        parts.push(counted(scenarios, "scenario"));
    }
    if runs > 0 {
        parts.push(counted(runs, "training run"));
    }
    parts.join(", ")
}

fn contents(inputs: &Inputs, groups: &[Group<'_>]) -> Markup {
    html! {
        nav aria-label="Contents" {
            ul {
                @if groups.len() > 1 { li { a href="#overview" { "Overview" } } }
                @for group in groups { li { a href=(format!("#{}", anchor(group.scenario))) { (group.scenario) } } }
                @if inputs.runs.iter().filter(|run| !run.lines.is_empty()).count() > 1 { li { a href="#runs" { "Runs side by side" } } }
                @for run in &inputs.runs { li { a href=(format!("#{}", run_section::anchor(run))) { "Run " (run.name) } } }
                @if !groups.is_empty() { li { a href="#metrics" { "What the metrics mean" } } }
            }
        }
    }
}

fn overview(groups: &[Group<'_>]) -> Markup {
    let grave = |group: &&Group<'_>| protocol::cautions(group).iter().any(|caution| caution.grave);
    let warned: Vec<&str> = groups.iter().filter(grave).map(|group| group.scenario).collect();
    html! {
        section id="overview" {
            h2 { "Overview" }
            @if !warned.is_empty() {
                p .caution.grave role="note" {
                    strong { "Warning: " } "not everything in these columns compares: read the warnings of "
                    @for (number, scenario) in warned.iter().enumerate() {
                        @if number > 0 { ", " }
                        a href=(format!("#{}", anchor(scenario))) { (scenario) }
                    }
                    "."
                }
            }
            @for verdict in groups.iter().flat_map(|group| group.verdicts().into_iter().map(move |verdict| (group.scenario, verdict))) {
                p .verdict { strong { (verdict.0) } " · " (verdict.1) }
            }
            (results::overview(groups, OVERVIEW[0]))
            details {
                summary { "The other metrics" }
                @for metric in OVERVIEW.into_iter().skip(1) { (results::overview(groups, metric)) }
            }
        }
    }
}

fn glossary() -> Markup {
    html! {
        section id="metrics" {
            h2 { "What the metrics mean" }
            p .lead {
                "A vehicle is stopped below 0.1 m/s. Vehicles are finished (arrived), unfinished (in the network at the end) or never inserted (no room to enter until the end). "
                "Figures compare only under one protocol."
            }
            details {
                summary { "Definitions" }
                div .scroll {
                    table .definitions {
                        caption { "Every figure, with its formula and what of SUMO's it is computed from" }
                        thead { tr { th scope="col" { "figure" } th scope="col" { "unit" } th scope="col" { "mean" } th scope="col" { "SUMO source" } } }
                        tbody {
                            @for definition in definitions() {
                                tr {
                                    th scope="row" { (definition.name) }
                                    td { (definition.unit) }
                                    td { (definition.formula) }
                                    td { (definition.source) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{input::Evaluation, samples};
    use super::*;

    #[test]
    fn the_page_is_whole_and_names_nothing_outside_itself() {
        let name = "\"><script>alert(1)</script>";
        let inputs = Inputs {
            runs: Vec::new(),
            evaluations: vec![
                Evaluation::sample(samples::report("grid4x4", name, &[1, 2]), "x"),
                Evaluation::sample(samples::report(name, "greedy", &[1, 2]), "x"),
            ],
        };
        let text = page(name, &inputs, &[PathBuf::from(name)]).into_string();
        assert!(text.starts_with("<!DOCTYPE html>") && text.ends_with("</html>"));
        assert!(!text.contains("<script>alert"), "a name became markup");
        assert_eq!(text.matches("<script>").count(), 1);
        assert!(!text.contains("http://") && !text.contains("https://"), "the page names an address");
        for link in text.split("href=\"#").skip(1) {
            let target = link.split('"').next().unwrap();
            assert!(text.contains(&format!("id=\"{target}\"")), "#{target} leads nowhere");
        }
    }
}
