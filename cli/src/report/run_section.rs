//! Everything about one run, and several runs side by side.

use super::figure::{Key, legend};
use super::line_chart::{LineChart, Over};
use super::number;
use super::results::slug;
use super::run::Run;
use super::run_panels::{Panel, Value, curve, diagnostics, learning, losses, usage};
use maud::{Markup, html};
use std::collections::BTreeSet;

/// A run's place in the page.
pub(super) fn anchor(run: &Run) -> String {
    format!("run-{}", slug(&run.name))
}

pub(super) fn section(run: &Run) -> Markup {
    html! {
        section .run id=(anchor(run)) {
            h2 { "Run " (run.name) }
            p .lead { (run.state()) }
            (facts(run))
            @if run.lines.is_empty() {
                p .caution role="note" { strong { "Note: " } "no update is done yet, so there is nothing to draw." }
            } @else {
                h3 { "Learning curves" }
                p .lead { "Of the policy as it trains, which samples its actions; the closing evaluation takes the most probable one." }
                div .three { @for panel in learning(run).iter().chain(&usage(run)) { (panel.draw(&run.name)) } }
                h3 { "Losses" }
                div .three { @for panel in losses(run) { (panel.draw(&run.name)) } }
                h3 { "Diagnostics" }
                div .three { @for panel in diagnostics(run) { (panel.draw(&run.name)) } }
            }
            @if !run.settings.is_empty() {
                details { summary { "Configuration (config.toml)" } pre tabindex="0" { (run.settings) } }
            }
        }
    }
}

/// The runs' returns and queues over each other; nothing for a single run.
pub(super) fn comparison(runs: &[Run]) -> Markup {
    let drawn: Vec<(usize, &Run)> =
        runs.iter().enumerate().filter(|(_, run)| !run.lines.is_empty()).collect();
    if drawn.len() < 2 {
        return Markup::default();
    }
    let scenarios: BTreeSet<String> = drawn.iter().flat_map(|(_, run)| run.scenarios()).collect();
    let panel = |key: &str, title: &str, note, zero, scenario: &str, value: Value<'_>| Panel {
        key: format!("{key}-{scenario}"),
        title: format!("{title}, {scenario}"),
        note,
        zero,
        curves: drawn
            .iter()
            .map(|(place, run)| curve(&run.name, *place, &run.lines, value))
            .filter(|curve| !curve.points.is_empty())
            .collect(),
    };
    let panels: Vec<Panel> = scenarios
        .iter()
        .flat_map(|scenario| {
            [
                panel(
                    "return",
                    "Return",
                    "of an episode, mean over the intersections",
                    false,
                    scenario,
                    &|line| line.scenarios.get(scenario)?.episode_return,
                ),
                panel("queue", "Queue", "stopped vehicles per incoming lane", true, scenario, &|line| {
                    line.scenarios.get(scenario)?.queue_length
                }),
            ]
        })
        .collect();
    html! {
        section id="runs" {
            h2 { "Runs side by side" }
            (legend(drawn.iter().map(|(place, run)| Key { label: &run.name, place: *place })))
            div .two {
                @for panel in &panels {
                    (LineChart { id: &slug(&panel.key), title: &panel.title, note: panel.note, over: Over::Updates, curves: &panel.curves, zero: panel.zero, size: (550.0, 240.0), legend: false }.draw())
                }
            }
        }
    }
}

fn facts(run: &Run) -> Markup {
    let last = run.lines.last();
    let config = run.config.as_ref();
    let versions = run.checkpoint.as_ref().map(|checkpoint| &checkpoint.versions);
    let known = |text: &String| !text.is_empty();
    let facts: Vec<(&str, Option<String>)> = vec![
        ("trained on", Some(run.scenarios().join(", ")).filter(known)),
        ("seed", config.map(|config| config.seed.to_string())),
        ("agent-decisions", last.map(|line| number::count(line.decisions))),
        ("episodes", last.map(|line| number::count(line.episodes))),
        ("time", run.end.as_ref().map(|end| number::duration(end.elapsed_seconds))),
        ("checkpoint", run.checkpoint.as_ref().map(|checkpoint| checkpoint.id.clone())),
        ("decision every", config.map(|config| format!("{} s", config.env.decision_seconds))),
        ("yellow", config.map(|config| format!("{} s", config.env.yellow_seconds))),
        ("episode", config.map(|config| format!("{} s", config.env.episode_seconds))),
        (
            "detection",
            config.and_then(|config| {
                Some(serde_json::to_value(config.env.detection).ok()?.as_str()?.to_owned())
            }),
        ),
        ("SUMO", versions.map(|versions| versions.sumo.clone()).filter(known)),
        ("CROSS", versions.map(|versions| versions.cross.clone()).filter(known)),
        ("libtorch", versions.map(|versions| versions.libtorch.clone()).filter(known)),
        ("configuration", config.map(|config| config.hash().chars().take(10).collect())),
    ];
    html! {
        dl .facts {
            @for (name, value) in facts {
                @if let Some(value) = value { div { dt { (name) } dd { (value) } } }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::run_panels::one;
    use super::*;
    use std::path::PathBuf;

    fn run(name: &str, updates: u64) -> Run {
        let line = |update: u64| {
            serde_json::from_value(serde_json::json!({
                "update": update, "decisions": update * 1000, "episodes": update,
                "scenarios": { "grid4x4": { "episode_return": -50.0 + update as f64, "queue_length": null } },
                "losses": { "actor_total": 0.5, "actor_entropy": null }, "diagnostics": { "approx_kl": 0.01 },
                "expert_usage": [0.25, 0.75], "cluster_usage": [], "lag": { "min": 0, "mean": 0.5, "max": 1 },
                "timing": { "collect_seconds": 1.0, "update_seconds": 2.0, "uptime_seconds": 3.0 },
            }))
            .unwrap()
        };
        Run {
            name: name.to_owned(),
            path: PathBuf::from(name),
            config: None,
            settings: "seed = 1 # <b>".to_owned(),
            lines: (1..=updates).map(line).collect(),
            checkpoint: None,
            end: None,
        }
    }

    #[test]
    fn everything_that_was_logged_is_drawn_and_nothing_else() {
        let text = section(&run("r.1", 3)).into_string();
        for id in [
            "return-grid4x4-r-1",
            "experts-r-1",
            "loss-actor-total-r-1",
            "diagnostic-approx-kl-r-1",
            "lag-r-1",
            "timing-r-1",
        ] {
            assert_eq!(text.matches(&format!("id=\"{id}\"")).count(), 1, "{id}");
        }
        for absent in ["queue-grid4x4-r-1", "clusters-r-1", "loss-actor-entropy-r-1", "NaN", "<b>"] {
            assert!(!text.contains(absent), "{absent}");
        }
        assert!(text.contains("3 updates so far") && text.contains("3000"), "{text}");
    }

    #[test]
    fn a_run_before_its_first_update_says_so() {
        let text = section(&run("r", 0)).into_string();
        assert!(text.contains("no update is done yet") && !text.contains("<svg"), "{text}");
    }

    #[test]
    fn runs_are_compared_where_there_are_several() {
        assert!(comparison(&[run("a", 3), run("b", 0)]).into_string().is_empty());
        let text = comparison(&[run("a", 3), run("b", 2)]).into_string();
        assert_eq!(text.matches("data-label=\"b\"").count(), 1, "{text}");
    }

    #[test]
    fn very_long_runs_are_thinned_by_averaging() {
        let curve = one(&run("a", 1000).lines, &|line| Some(line.update as f64)).remove(0);
        assert_eq!(curve.points.len(), 334);
        assert_eq!(curve.points[0], (2.0, 2.0));
    }
}
