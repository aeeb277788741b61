//! Everything about one scenario: warnings, table, drawings.

use super::dot_plot::{Cell, Column, DotPlot, Row};
use super::figure::{Key, legend};
use super::group::{Entry, Group};
use super::heat_map::{HeatMap, Queues, Shades};
use super::histogram::{Distribution, Histogram};
use super::line_chart::{Curve, LineChart, Over};
use super::number;
use super::protocol::{self, Caution};
use super::results::{self, anchor, arrow, slug};
use cross_sim::evaluate::{Details, Series};
use cross_sim::metrics::Metric;
use maud::{Markup, html};

/// Points that a curve over an episode is drawn with at most: of an hour a point a minute, which is longer than the cycle of
/// most signals, so that a curve shows the traffic and not the signals.
const MOST_POINTS: usize = 60;
/// A queue to enter that is never longer than this is not worth a chart.
const WAITING: f64 = 1.0;

pub(super) fn section(group: &Group<'_>) -> Markup {
    html! {
        section .scenario id=(anchor(group.scenario)) {
            h2 { (group.scenario) }
            @if let (Some(first), true) = (group.entries.first(), group.protocols.len() == 1 && group.comparable()) {
                p .chips { (protocol::line(first.report)) }
            } @else {
                @for entry in &group.entries {
                    p .chips { span .chip.who { (entry.label) @if group.protocols.len() > 1 { ": " (protocol::letter(entry.protocol)) } } (protocol::line(entry.report)) }
                }
            }
            @for caution in protocol::cautions(group) { (note(&caution)) }
            @for verdict in group.verdicts() { p .verdict { (verdict) } }
            (results::main_table(group))
            (dots(group))
            (details(group))
            details { summary { "Further figures: trip and waiting times, stops, emissions, returns, teleports" } (results::further_table(group)) }
            details { summary { "Each seed" } (results::seeds_table(group)) }
            details { summary { "Protocol in full, with hashes" } (protocol::table(group)) }
        }
    }
}

fn note(caution: &Caution) -> Markup {
    html! {
        p .caution.grave[caution.grave] role="note" {
            strong { @if caution.grave { "Warning: " } @else { "Note: " } }
            (caution.text)
        }
    }
}

fn dots(group: &Group<'_>) -> Markup {
    let rows: Vec<_> =
        group.entries.iter().map(|entry| Row { label: entry.label.clone(), place: entry.place }).collect();
    let cell = |entry: &Entry<'_>, metric: Metric| Cell {
        mean: entry.report.get(metric).mean,
        seeds: entry.report.per_seed.iter().map(|episode| episode.get(metric).mean).collect(),
        published: entry.published(metric).map(|published| published.mean),
    };
    let column = |metric: Metric| Column {
        title: metric.name().to_owned(),
        note: format!("{} {}", metric.unit(), arrow(metric)),
        digits: metric.digits(),
        cells: group.entries.iter().map(|entry| cell(entry, metric)).collect(),
    };
    let columns = Metric::PAPER.map(column);
    let published = columns.iter().flat_map(|column| &column.cells).any(|cell| cell.published.is_some());
    let note = if published {
        "dot: mean; ticks: the seeds; diamond: the published figure of the same policy"
    } else {
        "dot: mean; ticks: the seeds"
    };
    let id = format!("metrics-{}", slug(group.scenario));
    DotPlot { id: &id, title: "Metrics", note, rows: &rows, columns: &columns }.draw()
}

/// An entry that has details.
struct Detailed<'g> {
    entry: &'g Entry<'g>,
    details: &'g Details,
}

/// What only evaluations with details can show.
fn details(group: &Group<'_>) -> Markup {
    let detailed: Vec<Detailed<'_>> = group
        .entries
        .iter()
        .filter_map(|entry| Some(Detailed { entry, details: entry.report.details.as_ref()? }))
        .collect();
    let without: Vec<&str> = group
        .entries
        .iter()
        .filter(|entry| entry.report.details.is_none())
        .map(|entry| entry.label.as_str())
        .collect();
    html! {
        @if !detailed.is_empty() {
            (over_time(group, &detailed))
            (distributions(group, &detailed))
            (maps(group, &detailed))
        }
        @if !without.is_empty() {
            p .caution role="note" {
                strong { "Note: " } "no curves over time, distributions and maps of " (without.join(", "))
                ": that evaluation was kept without details. " code { "cross eval --out FILE.json" } " keeps them."
            }
        }
    }
}

fn over_time(group: &Group<'_>, detailed: &[Detailed<'_>]) -> Markup {
    let curves = |values: &dyn Fn(&Series) -> Vec<f64>| -> Vec<Curve> {
        let of_entry = |Detailed { entry, details }: &Detailed<'_>| {
            let seeds: Vec<_> = details.seeds.iter().map(|seed| values(&seed.series)).collect();
            let interval = details.seeds.first().map_or(0, |seed| seed.series.interval_seconds);
            curve(&entry.label, entry.place, interval, &seeds)
        };
        detailed.iter().map(of_entry).collect()
    };
    let chart = |key: &str, title: &str, note: &str, curves: &[Curve]| {
        let id = format!("{key}-{}", slug(group.scenario));
        let (over, size) = (Over::Time, (550.0, 250.0));
        LineChart { id: &id, title, note, over, curves, zero: true, size, legend: false }.draw()
    };
    let queue = curves(&|series| series.queue_length.clone());
    let waiting = curves(&|series| series.waiting_to_enter.clone());
    let crowded = waiting.iter().flat_map(|curve| &curve.points).any(|&(_, vehicles)| vehicles > WAITING);
    let first = detailed.first().and_then(|detailed| detailed.details.seeds.first());
    let seconds =
        first.map(|seed| seed.series.interval_seconds as usize * merged(seed.series.queue_length.len()));
    html! {
        h3 { "Over time" }
        p .lead {
            "Mean over the seeds"
            @if let Some(seconds) = seconds { ", a point every " (seconds) " s" }
            "; the band reaches from the lowest to the highest seed."
        }
        (legend(detailed.iter().map(|Detailed { entry, .. }| Key { label: &entry.label, place: entry.place })))
        div .two {
            (chart("queue", "Queue length", "stopped vehicles per signalised incoming lane", &queue))
            (chart("speed", "Speed", "m/s, mean over the vehicles in the network", &curves(&|series| series.speed.clone())))
            (chart("running", "Vehicles in the network", "", &curves(&|series| series.running.clone())))
            (chart("arrivals", "Arrivals", "vehicles a minute", &curves(&arrivals)))
            @if crowded { (chart("waiting", "Vehicles waiting to enter", "due, and without room", &waiting)) }
        }
    }
}

/// Vehicles that arrive a minute, in each interval.
fn arrivals(series: &Series) -> Vec<f64> {
    let minutes = f64::from(series.interval_seconds.max(1)) / 60.0;
    series.arrived.iter().map(|&vehicles| f64::from(vehicles) / minutes).collect()
}

/// How many entries of a series of this length make a point.
fn merged(length: usize) -> usize {
    length.div_ceil(MOST_POINTS).max(1)
}

/// The mean of the seeds' curves, and a band from the lowest to the highest where there are several.
fn curve(label: &str, place: usize, interval: u32, seeds: &[Vec<f64>]) -> Curve {
    let mut drawn = Curve { label: label.to_owned(), place, points: Vec::new(), band: Vec::new() };
    // All seeds of an evaluation are equally long; were they not, the mean of what is common is the honest one.
    let length = seeds.iter().map(Vec::len).min().unwrap_or(0);
    let merged = merged(length);
    for start in (0..length).step_by(merged) {
        let end = (start + merged).min(length);
        let of_seed = |values: &[f64]| values[start..end].iter().sum::<f64>() / (end - start) as f64;
        let values: Vec<f64> = seeds.iter().map(|values| of_seed(values)).collect();
        let x = f64::from(interval) * (start + end) as f64 / 2.0;
        drawn.points.push((x, values.iter().sum::<f64>() / values.len() as f64));
        if values.len() > 1 {
            let low = values.iter().copied().fold(f64::INFINITY, f64::min);
            let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            drawn.band.push((x, low, high));
        }
    }
    drawn
}

fn distributions(group: &Group<'_>, detailed: &[Detailed<'_>]) -> Markup {
    let rows: Vec<_> = detailed
        .iter()
        .map(|Detailed { entry, details }| {
            let trips = || details.seeds.iter().map(|seed| &seed.trips);
            Distribution {
                label: entry.label.clone(),
                place: entry.place,
                finished: trips().flat_map(|trips| trips.finished.trip_time.iter().copied()).collect(),
                unfinished: trips().flat_map(|trips| trips.unfinished.trip_time.iter().copied()).collect(),
            }
        })
        .collect();
    let id = format!("trips-{}", slug(group.scenario));
    let note = "share of the vehicles, all seeds together; line: median; pale: not finished at the end";
    Histogram { id: &id, title: "How long trips took", note, rows: &rows }.draw()
}

fn maps(group: &Group<'_>, detailed: &[Detailed<'_>]) -> Markup {
    let queues: Vec<Queues> = detailed.iter().map(|Detailed { details, .. }| Queues::of(details)).collect();
    let shades = Shades::over(&queues);
    html! {
        h3 { "Where vehicles stand" }
        (shades.legend())
        div .maps {
            @for (number, (Detailed { entry, details }, queues)) in detailed.iter().zip(&queues).enumerate() {
                @let id = format!("map-{}-{}", slug(group.scenario), number + 1);
                (HeatMap { id: &id, title: &entry.label, network: &details.network, queues, shades: &shades }.draw())
            }
        }
        @if let Some(details) = detailed.first() {
            p .lead {
                (number::counted(details.details.network.signals.len(), "intersection")) ", north up, right-hand traffic. A disc is an intersection, mean over its incoming lanes; a line is a road that leads to one."
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{group, input::Evaluation, samples};
    use super::*;
    use cross_sim::evaluate::EvalReport;

    fn drawn(reports: Vec<EvalReport>) -> String {
        let all: Vec<_> = reports.into_iter().map(|report| Evaluation::sample(report, "x")).collect();
        section(&group::groups(&all)[0]).into_string()
    }

    #[test]
    fn with_details_there_is_every_drawing() {
        let text = drawn(vec![
            samples::report("grid4x4", "greedy", &[1, 3]),
            samples::report("grid4x4", "cross", &[1, 3]),
        ]);
        for id in [
            "results-grid4x4",
            "metrics-grid4x4",
            "queue-grid4x4",
            "speed-grid4x4",
            "running-grid4x4",
            "arrivals-grid4x4",
            "trips-grid4x4",
            "map-grid4x4-1",
            "map-grid4x4-2",
        ] {
            assert_eq!(text.matches(&format!("id=\"{id}\"")).count(), 1, "{id}");
        }
        assert!(
            !text.contains("kept without details")
                && !text.contains("NaN")
                && !text.contains("waiting-grid4x4"),
            "{text}"
        );
    }

    #[test]
    fn without_details_there_is_the_table_and_a_word_why() {
        let mut report = samples::report("grid4x4", "greedy", &[1]);
        report.details = None;
        let text = drawn(vec![report]);
        assert!(text.contains("results-grid4x4") && !text.contains("queue-grid4x4"));
        assert!(text.contains("kept without details") && text.contains("of greedy:"), "{text}");
    }

    #[test]
    fn curves_are_means_with_a_band_of_all_seeds() {
        let long: Vec<f64> = (0..360).map(f64::from).collect();
        let curve = curve("a", 0, 10, &[long, vec![0.0; 360]]);
        assert_eq!(curve.points.len(), 60);
        assert_eq!(curve.points[0], (30.0, 1.25));
        assert_eq!(curve.band[0], (30.0, 0.0, 2.5));
        assert!(super::curve("a", 0, 10, &[]).points.is_empty());
        assert!(super::curve("a", 0, 10, &[vec![1.0]]).band.is_empty(), "one seed has no band");
    }
}
