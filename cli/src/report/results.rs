//! Tables of results: policies in rows, metrics in columns, the published figures below.

use super::group::{Entry, Group};
use super::number;
use super::protocol;
use crate::paper;
use cross_sim::metrics::{Better, Metric};
use maud::{Markup, html};

/// The paper's policies as its tables call them.
fn published_name(method: &str) -> &str {
    match method {
        "fixed-time" => "Fixed-Time",
        "max-pressure" => "Max-Pressure",
        "gesa" => "GESA",
        "unicorn" => "Unicorn",
        "cross" => "CROSS",
        other => other,
    }
}

/// The paper's methods on a scenario, in its order.
fn published_methods(scenario: &str) -> Vec<&'static str> {
    let mut methods: Vec<&'static str> = Vec::new();
    for result in paper::results().iter().filter(|result| result.scenario == scenario) {
        if !methods.contains(&result.method) {
            methods.push(result.method);
        }
    }
    methods
}

/// The name of a metric's column.
pub(super) fn title(metric: Metric) -> Markup {
    html! { (metric.name()) " " span .unit { (metric.unit()) " " (arrow(metric)) } }
}

/// Which way it improves.
pub(super) fn arrow(metric: Metric) -> &'static str {
    match metric.better() {
        Better::Lower => "↓",
        Better::Higher => "↑",
    }
}

/// The six metrics of papers, what became of the vehicles, and the published rows.
pub(super) fn main_table(group: &Group<'_>) -> Markup {
    let several = group.protocols.len() > 1;
    let columns = Metric::PAPER.len() + 2 + usize::from(several);
    let methods = published_methods(group.scenario);
    html! {
        div .scroll {
            table .results id=(format!("results-{}", slug(group.scenario))) {
                caption {
                    "Results on " (group.scenario) ": mean over the seeds, ± the deviation inside an episode, over its seconds or vehicles"
                    @if group.comparable() && group.entries.len() > 1 { "; the best mean in bold" }
                }
                thead {
                    tr {
                        th scope="col" { "policy" }
                        @for metric in Metric::PAPER { th scope="col" .figure { (title(metric)) } }
                        th scope="col" .figure { "vehicles " span .unit.loose { "finished / unfinished / never in" } }
                        @if several { th scope="col" { "protocol" } }
                    }
                }
                tbody {
                    @if !methods.is_empty() { tr .part { th scope="rowgroup" colspan=(columns) { "measured here" } } }
                    @for entry in &group.entries {
                        tr {
                            th scope="row" { (policy(entry)) }
                            @for metric in Metric::PAPER { (cell(group, entry, metric)) }
                            td .figure { (vehicles(entry)) }
                            @if several { td { (protocol::letter(entry.protocol)) } }
                        }
                    }
                }
                @if !methods.is_empty() {
                    tbody .published-rows {
                        tr .part {
                            th scope="rowgroup" colspan=(columns) { "published in the CROSS paper" @if group.entries.iter().any(|entry| Metric::PAPER.iter().any(|&metric| entry.published(metric).is_some())) { "; below, how far the row of the same policy here lies from it" } }
                        }
                        @for method in methods { (published_row(group, method, several)) }
                    }
                }
            }
        }
    }
}

fn policy(entry: &Entry<'_>) -> Markup {
    html! {
        span .(super::figure::series(entry.place)) { span .key {} }
        (entry.label)
        @if entry.report.controller != entry.report.policy { span .controller { (entry.report.controller) } }
        @if entry.strongest { " " span .tag title="lowest mean trip delay of the Max-Pressure variants" { "strongest" } }
        @if !entry.report.gridlocked_seeds.is_empty() { " " span .tag.grave { "gridlock, " (protocol::seeds_in_words(&entry.report.gridlocked_seeds)) } }
    }
}

fn cell(group: &Group<'_>, entry: &Entry<'_>, metric: Metric) -> Markup {
    let value = entry.report.get(metric);
    let digits = metric.digits();
    let figure = html! { (number::fixed(value.mean, digits)) " " span .deviation { "±" (number::fixed(value.std, digits)) } };
    html! { td .figure.best[is_best(group, entry, metric)] { (figure) } }
}

/// Compared as printed: of two equal figures neither is the better one. Nothing is best where there is no comparison.
fn is_best(group: &Group<'_>, entry: &Entry<'_>, metric: Metric) -> bool {
    let sign = if metric.better() == Better::Lower { 1.0 } else { -1.0 };
    let shown = |entry: &Entry<'_>| {
        let digits = metric.digits();
        let text = format!("{:.digits$}", entry.report.get(metric).mean);
        text.parse::<f64>().map_or(f64::INFINITY, |value| sign * value)
    };
    let own = shown(entry);
    group.entries.len() > 1
        && group.comparable()
        && own.is_finite()
        && group.entries.iter().all(|other| own <= shown(other))
}

fn vehicles(entry: &Entry<'_>) -> String {
    let vehicles = &entry.report.vehicles;
    let shown = [vehicles.finished, vehicles.unfinished, vehicles.never_inserted]
        .map(|count| number::fixed(count, 0));
    shown.join(" / ")
}

fn published_row(group: &Group<'_>, method: &str, several: bool) -> Markup {
    // The difference is told where one row alone can be meant.
    let mut same = group
        .entries
        .iter()
        .filter(|entry| entry.published_method() == method && protocol::as_published(entry.report));
    let ours = match (same.next(), same.next()) {
        (Some(only), None) => Some(only),
        _ => None,
    };
    html! {
        tr {
            th scope="row" { (published_name(method)) }
            @for metric in Metric::PAPER {
                td .figure {
                    @match paper::lookup(group.scenario, method, metric.key()) {
                        Some(published) => {
                            (number::fixed(published.mean, 2)) " " span .deviation { "±" (number::fixed(published.std, 2)) }
                            @if let Some(difference) = ours.and_then(|entry| difference(entry.report.get(metric).mean, published.mean)) {
                                span .difference { "here " (difference) }
                            }
                        },
                        None => span .deviation { (number::NONE) },
                    }
                }
            }
            td .figure { span .deviation { (number::NONE) } }
            @if several { td {} }
        }
    }
}

/// How far our figure lies from another's, in per cent of that.
fn difference(ours: f64, other: f64) -> Option<String> {
    let share = 100.0 * (ours - other) / other;
    if !share.is_finite() {
        return None;
    }
    let digits = usize::from(share.abs() < 9.95);
    let text = number::fixed(share, digits);
    let sign = if share > 0.0 && text.bytes().any(|digit| (b'1'..=b'9').contains(&digit)) { "+" } else { "" };
    Some(format!("{sign}{text} %"))
}

/// The metrics that papers do not report.
pub(super) fn further_table(group: &Group<'_>) -> Markup {
    let metrics: Vec<Metric> =
        Metric::ALL.into_iter().filter(|metric| !Metric::PAPER.contains(metric)).collect();
    html! {
        div .scroll {
            table {
                caption { "Further figures on " (group.scenario) }
                thead {
                    tr {
                        th scope="col" { "policy" }
                        @for &metric in &metrics { th scope="col" .figure { (title(metric)) } }
                        th scope="col" .figure { "episode return " span .unit { "veh ↑" } }
                        th scope="col" .figure { "teleports " span .unit { "1 ↓" } }
                    }
                }
                tbody {
                    @for entry in &group.entries {
                        tr {
                            th scope="row" { (policy(entry)) }
                            @for &metric in &metrics { (cell(group, entry, metric)) }
                            td .figure { (number::fixed(entry.report.episode_return, 1)) }
                            td .figure { (number::fixed(entry.report.vehicles.teleports, 1)) }
                        }
                    }
                }
            }
        }
    }
}

/// The mean of each seed, and how far the seeds lie apart.
pub(super) fn seeds_table(group: &Group<'_>) -> Markup {
    html! {
        div .scroll {
            table {
                caption { "Each SUMO seed on " (group.scenario) ", and the deviation of the seeds' means from each other (n−1)" }
                thead {
                    tr {
                        th scope="col" { "policy" }
                        th scope="col" .figure { "seed" }
                        @for metric in Metric::PAPER { th scope="col" .figure { (title(metric)) } }
                        th scope="col" { "gridlock" }
                    }
                }
                @for entry in &group.entries {
                    tbody {
                        @for (number, episode) in entry.report.per_seed.iter().enumerate() {
                            tr {
                                @if number == 0 { th scope="rowgroup" rowspan=(entry.report.per_seed.len() + 1) { (policy(entry)) } }
                                td .figure { (episode.seed) }
                                @for metric in Metric::PAPER { td .figure { (number::fixed(episode.get(metric).mean, metric.digits())) } }
                                td { @if episode.gridlock { span .tag.grave { "gridlock" } } }
                            }
                        }
                        tr .spread {
                            td .figure { "spread" }
                            @for metric in Metric::PAPER {
                                td .figure { "±" (number::fixed(entry.report.get(metric).std_between_seeds, metric.digits())) }
                            }
                            td {}
                        }
                    }
                }
            }
        }
    }
}

/// One metric of every policy on every scenario.
pub(super) fn overview(groups: &[Group<'_>], metric: Metric) -> Markup {
    let mut labels: Vec<(usize, &str)> = groups
        .iter()
        .flat_map(|group| &group.entries)
        .map(|entry| (entry.place, entry.label.as_str()))
        .collect();
    labels.sort_unstable();
    labels.dedup();
    let methods: Vec<&str> = ["fixed-time", "max-pressure", "gesa", "unicorn", "cross"]
        .into_iter()
        .filter(|method| {
            groups.iter().any(|group| paper::lookup(group.scenario, method, metric.key()).is_some())
        })
        .collect();
    html! {
        div .scroll {
            table .overview {
                caption { "Mean " (metric.name()) " on each scenario, " (metric.unit()) " " (arrow(metric)) }
                thead {
                    tr {
                        th scope="col" { "policy" }
                        @for group in groups { th scope="col" .figure { a href=(format!("#{}", anchor(group.scenario))) { (group.scenario) } } }
                    }
                }
                tbody {
                    @for (place, label) in &labels {
                        tr {
                            th scope="row" { span .(super::figure::series(*place)) { span .key {} } (label) }
                            @for group in groups {
                                @match group.entries.iter().find(|entry| entry.label == *label) {
                                    Some(entry) => td .figure.best[is_best(group, entry, metric)] {
                                        (number::fixed(entry.report.get(metric).mean, metric.digits()))
                                        @if !entry.report.gridlocked_seeds.is_empty() { " " span .tag.grave { "gridlock" } }
                                    },
                                    None => td .figure { span .deviation { (number::NONE) } },
                                }
                            }
                        }
                    }
                }
                @if !methods.is_empty() {
                    tbody .published-rows {
                        tr .part { th scope="rowgroup" colspan=(groups.len() + 1) { "published in the CROSS paper" } }
                        @for method in methods {
                            tr {
                                th scope="row" { (published_name(method)) }
                                @for group in groups {
                                    td .figure {
                                        (paper::lookup(group.scenario, method, metric.key()).map_or(number::NONE.to_owned(), |result| number::fixed(result.mean, 2)))
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// A scenario's place in the page.
pub(super) fn anchor(scenario: &str) -> String {
    format!("scenario-{}", slug(scenario))
}

/// A name as part of an id: letters, digits and dashes.
pub(super) fn slug(name: &str) -> String {
    name.chars().map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '-' }).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{group, input::Evaluation, samples};
    use super::*;
    use cross_sim::evaluate::EvalReport;

    fn with_group(reports: Vec<EvalReport>, check: impl Fn(&Group<'_>)) {
        let all: Vec<_> = reports.into_iter().map(|report| Evaluation::sample(report, "x")).collect();
        check(&group::groups(&all)[0]);
    }

    #[test]
    fn policies_stand_above_the_published_figures() {
        with_group(
            vec![
                samples::report("grid4x4", "fixed-time", &[50, 60]),
                samples::scaled("grid4x4", "greedy", &[50, 60], 0.5),
            ],
            |group| {
                let text = main_table(group).into_string();
                let (here, paper) = text.split_once("published in the CROSS paper").unwrap();
                assert!(
                    here.contains("fixed-time") && here.contains("55.0 <span class=\"deviation\">±0.5"),
                    "{text}"
                );
                for part in ["Fixed-Time", "54.96", "±39.15", "Unicorn", "here +0.1 %"] {
                    assert!(paper.contains(part), "{part} is missing in {paper}");
                }
                assert_eq!(
                    text.matches("class=\"figure best\"").count(),
                    Metric::PAPER.len(),
                    "one policy has each best mean"
                );
            },
        );
    }

    #[test]
    fn nothing_is_best_under_different_protocols_and_gridlock_is_flagged() {
        let other = samples::with_protocol("s", "b", "yellow_seconds", serde_json::json!(5));
        let mut locked = samples::report("s", "a", &[1]);
        locked.gridlocked_seeds = vec![1];
        with_group(vec![locked, other], |group| {
            let text = main_table(group).into_string();
            assert!(!text.contains("best") && text.contains("gridlock, seed 1"), "{text}");
            assert!(text.contains("<td>A</td>") && text.contains("<td>B</td>"), "{text}");
            assert!(!text.contains("published"), "the paper has no such scenario");
        });
    }

    #[test]
    fn differences_are_signed_and_brief() {
        let told: Vec<_> = [(101.0, 100.0), (99.5, 100.0), (150.0, 100.0), (100.0, 100.0), (1.0, 0.0)]
            .into_iter()
            .map(|(ours, other)| difference(ours, other))
            .collect();
        let expected = ["+1.0 %", "−0.5 %", "+50 %", "0.0 %"].map(|text| Some(text.to_owned()));
        assert_eq!(told[..4], expected);
        assert_eq!(told[4], None);
    }

    #[test]
    fn every_table_has_a_caption_and_headed_rows() {
        with_group(vec![samples::report("s", "<a>", &[1, 2])], |group| {
            let groups = std::slice::from_ref(group);
            for table in [
                main_table(group),
                further_table(group),
                seeds_table(group),
                overview(groups, Metric::TripDelay),
            ] {
                let text = table.into_string();
                assert!(text.contains("<caption>") && text.contains("scope=\"row"), "{text}");
                assert!(text.contains("&lt;a&gt;") && !text.contains("<a>"), "{text}");
            }
        });
    }
}
