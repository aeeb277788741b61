//! The charts of one run: what `metrics.jsonl` says of each update.

use super::line_chart::{Curve, LineChart, Over};
use super::results::slug;
use super::run::{Line, Run};
use maud::Markup;
use std::collections::BTreeSet;

const SIZE: (f64, f64) = (360.0, 200.0);
/// Points that a curve is drawn with at most; of more, every so many are averaged.
const MOST_POINTS: usize = 400;

/// What a curve shows of an update.
pub(super) type Value<'v> = &'v dyn Fn(&Line) -> Option<f64>;

/// A chart of a run.
pub(super) struct Panel {
    pub(super) key: String,
    pub(super) title: String,
    pub(super) note: &'static str,
    pub(super) zero: bool,
    pub(super) curves: Vec<Curve>,
}

impl Panel {
    pub(super) fn draw(&self, run: &str) -> Markup {
        let id = format!("{}-{}", slug(&self.key), slug(run));
        LineChart {
            id: &id,
            title: &self.title,
            note: self.note,
            over: Over::Updates,
            curves: &self.curves,
            zero: self.zero,
            size: SIZE,
            legend: self.curves.len() > 1,
        }
        .draw()
    }
}

pub(super) fn learning(run: &Run) -> Vec<Panel> {
    let scenarios = run.scenarios();
    let alone = scenarios.len() == 1;
    let title =
        |what: &str, scenario: &str| if alone { what.to_owned() } else { format!("{what}, {scenario}") };
    let panels = scenarios.iter().flat_map(|scenario| {
        [
            Panel {
                key: format!("return-{scenario}"),
                title: title("Return", scenario),
                note: "of an episode, mean over the intersections",
                zero: false,
                curves: one(&run.lines, &|line| line.scenarios.get(scenario)?.episode_return),
            },
            Panel {
                key: format!("queue-{scenario}"),
                title: title("Queue", scenario),
                note: "stopped vehicles per incoming lane",
                zero: true,
                curves: one(&run.lines, &|line| line.scenarios.get(scenario)?.queue_length),
            },
        ]
    });
    panels.filter(has_curves).collect()
}

/// How much each expert and cluster is used; by scenario too where there are several.
pub(super) fn usage(run: &Run) -> Vec<Panel> {
    let scenarios = run.scenarios();
    let several = scenarios.len() > 1;
    let both = ["experts", "clusters"].into_iter().flat_map(|part| {
        let of_scenarios = scenarios.iter().filter(|_| several).map(move |scenario| (part, Some(scenario)));
        std::iter::once((part, None)).chain(of_scenarios)
    });
    let panel = |(part, scenario): (&str, Option<&String>)| {
        let (experts, name) = (part == "experts", words(part));
        let list = |line: &Line| -> Vec<Option<f64>> {
            match scenario.map(|scenario| line.scenarios.get(scenario)) {
                None if experts => line.expert_usage.clone(),
                None => line.cluster_usage.clone(),
                Some(Some(own)) if experts => own.expert_usage.clone(),
                Some(Some(own)) => own.cluster_usage.clone(),
                Some(None) => Vec::new(),
            }
        };
        let lists: Vec<_> = run.lines.iter().map(|line| (line.update, list(line))).collect();
        let number = lists.iter().map(|(_, list)| list.len()).max().unwrap_or(0);
        let of_place = |place: usize| {
            let values = lists
                .iter()
                .filter_map(|(update, list)| Some((*update, list.get(place).copied().flatten()?)));
            thinned(&(place + 1).to_string(), place, values)
        };
        Panel {
            key: scenario.map_or_else(|| part.to_owned(), |scenario| format!("{part}-{scenario}")),
            title: scenario.map_or_else(|| name.clone(), |scenario| format!("{name}, {scenario}")),
            note: if experts { "share of the gating weight" } else { "mean assignment" },
            zero: true,
            curves: (0..number).map(of_place).collect(),
        }
    };
    both.map(panel).filter(has_curves).collect()
}

pub(super) fn losses(run: &Run) -> Vec<Panel> {
    let names: BTreeSet<&String> = run.lines.iter().flat_map(|line| line.losses.keys()).collect();
    let panel = |name: &String| Panel {
        key: format!("loss-{name}"),
        title: words(name),
        note: if name.ends_with("_total") { "weighted sum" } else { "before its weight" },
        zero: false,
        curves: one(&run.lines, &|line| line.losses.get(name).copied().flatten()),
    };
    names.into_iter().map(panel).filter(has_curves).collect()
}

pub(super) fn diagnostics(run: &Run) -> Vec<Panel> {
    let names: BTreeSet<&String> = run.lines.iter().flat_map(|line| line.diagnostics.keys()).collect();
    let panel = |name: &String| Panel {
        key: format!("diagnostic-{name}"),
        title: diagnostic(name),
        note: "",
        zero: false,
        curves: one(&run.lines, &|line| line.diagnostics.get(name).copied().flatten()),
    };
    let together = |key: &str, title: &str, note, curves: [(&str, Value<'_>); 2]| Panel {
        key: key.to_owned(),
        title: title.to_owned(),
        note,
        zero: true,
        curves: curves
            .into_iter()
            .enumerate()
            .map(|(place, (label, value))| curve(label, place, &run.lines, value))
            .collect(),
    };
    names
        .into_iter()
        .map(panel)
        .chain(by_scenario(run))
        .chain([
            together(
                "lag",
                "Policy lag",
                "versions that the data was behind",
                [("mean", &|line: &Line| line.lag.mean), ("most", &|line: &Line| line.lag.max)],
            ),
            together(
                "timing",
                "Time of an update",
                "s",
                [
                    ("collecting", &|line: &Line| line.timing.collect_seconds),
                    ("updating", &|line: &Line| line.timing.update_seconds),
                ],
            ),
        ])
        .filter(has_curves)
        .collect()
}

fn has_curves(panel: &Panel) -> bool {
    panel.curves.iter().any(|curve| !curve.points.is_empty())
}

/// Diagnostics by scenario, a curve for each: with a single one those alone that are not there for all data together.
fn by_scenario(run: &Run) -> Vec<Panel> {
    let scenarios = run.scenarios();
    let all = run.lines.iter().flat_map(|line| &line.scenarios);
    let names: BTreeSet<&String> = all.flat_map(|(_, scenario)| scenario.diagnostics.keys()).collect();
    let together: BTreeSet<&String> = run.lines.iter().flat_map(|line| line.diagnostics.keys()).collect();
    let shown = names.into_iter().filter(|name| scenarios.len() > 1 || !together.contains(name));
    let panel = |name: &String| Panel {
        key: format!("scenarios-{name}"),
        title: diagnostic(name),
        note: if scenarios.len() > 1 { "by scenario" } else { "" },
        zero: false,
        curves: scenarios
            .iter()
            .enumerate()
            .map(|(place, scenario)| {
                curve(scenario, place, &run.lines, &|line| {
                    line.scenarios.get(scenario)?.diagnostics.get(name).copied().flatten()
                })
            })
            .collect(),
    };
    shown.map(panel).collect()
}

/// `approx_kl` as people write it.
fn diagnostic(name: &str) -> String {
    match name {
        "approx_kl" => "KL divergence (approximate)".to_owned(),
        "actor_lr" | "critic_lr" => words(&name.replace("_lr", "_learning_rate")),
        "actor_grad_norm" | "critic_grad_norm" => words(&name.replace("_grad_norm", "_gradient_norm")),
        other => words(other),
    }
}

/// `clip_fraction` as `Clip fraction`.
fn words(name: &str) -> String {
    let mut letters = name.replace('_', " ").chars().collect::<Vec<_>>();
    if let Some(first) = letters.first_mut() {
        *first = first.to_ascii_uppercase();
    }
    letters.into_iter().collect()
}

pub(super) fn one(lines: &[Line], value: Value<'_>) -> Vec<Curve> {
    vec![curve("", 0, lines, value)]
}

/// A value over the updates; updates without it are left out.
pub(super) fn curve(label: &str, place: usize, lines: &[Line], value: Value<'_>) -> Curve {
    thinned(label, place, lines.iter().filter_map(|line| Some((line.update, value(line)?))))
}

/// The finite values; of very many, neighbours are averaged.
fn thinned(label: &str, place: usize, values: impl Iterator<Item = (u64, f64)>) -> Curve {
    let finite = values.filter(|(_, value)| value.is_finite());
    let points: Vec<(f64, f64)> = finite.map(|(update, value)| (update as f64, value)).collect();
    let merged = points.len().div_ceil(MOST_POINTS).max(1);
    let mean = |points: &[(f64, f64)]| {
        let share = 1.0 / points.len() as f64;
        points.iter().fold((0.0, 0.0), |mean, point| (mean.0 + point.0 * share, mean.1 + point.1 * share))
    };
    let points = if merged == 1 { points } else { points.chunks(merged).map(mean).collect() };
    Curve { label: label.to_owned(), place, points, band: Vec::new() }
}
