//! The report as a page of Markdown: `docs/baselines.md`.

use super::agreement::Comparison;
use super::markdown::{code, heading, line, one_line, row, short};
use super::report::{Figure, PolicyReport, Report, ScenarioReport};
use crate::paper;
use cross_sim::controller::RuleBased;
use cross_sim::metrics::{Better, Metric};
use std::fmt::Write as _;

const INTRODUCTION: &str = include_str!("../../data/baselines-introduction.md");
/// The metrics of which agreement is claimed, in the order of the tables.
const JUDGED: [Metric; 4] = [Metric::QueueLength, Metric::Speed, Metric::TripTime, Metric::TripDelay];

/// The whole page.
pub(crate) fn render(report: &Report) -> String {
    let mut page = format!("{}\n", INTRODUCTION.trim_end());
    protocol(&mut page, report);
    agreement(&mut page, report);
    for scenario in &report.scenarios {
        results(&mut page, scenario);
    }
    page
}

pub(super) fn protocol(page: &mut String, report: &Report) {
    let env = &report.env;
    line(page, "\n## Protocol\n");
    line(
        page,
        &format!(
            "Made with {}, cross {}, SUMO {}. A decision every {} s, the first {} s of yellow where the phase changes, {} s in all.\n",
            code(&report.command),
            report.cross_version,
            report.sumo_version,
            env.decision_seconds,
            env.yellow_seconds,
            env.episode_seconds
        ),
    );
    row(
        page,
        &["scenario", "vehicles", "SUMO seeds", "teleport", "departure", "net", "demand"].map(str::to_owned),
    );
    row(page, &["---"; 7].map(str::to_owned));
    for scenario in &report.scenarios {
        let teleport = match scenario.sumo.time_to_teleport {
            never if never < 0.0 => "never".to_owned(),
            seconds => format!("after {seconds} s"),
        };
        let departure = format!("speed {}, lane {}", scenario.sumo.depart_speed, scenario.sumo.depart_lane);
        row(
            page,
            &[
                code(&scenario.scenario),
                scenario.vehicles.to_string(),
                all_seeds(scenario),
                teleport,
                departure,
                code(&short(&scenario.net_hash)),
                code(&short(&scenario.demand_hash)),
            ],
        );
    }
    line(
        page,
        "\nNet and demand are the first digits of their SHA-256, as `cross scenario info` shows them in full.",
    );
    if !report.missing.is_empty() {
        line(page, "\n**Missing here**, because this machine does not have them:\n");
        for missing in &report.missing {
            line(page, &format!("- {}: {}", code(&missing.scenario), one_line(&missing.reason)));
        }
    }
}

/// Differences in per cent, all scenarios together.
fn agreement(page: &mut String, report: &Report) {
    for (heading, of, whom) in [
        (
            "Beside the reference",
            (|policy| &policy.reference) as fn(&PolicyReport) -> &Vec<Comparison>,
            "reference",
        ),
        ("Beside the paper", |policy| &policy.paper, "paper"),
    ] {
        let judged = report.scenarios.iter().flat_map(|scenario| &scenario.policies).flat_map(of);
        let verdicts: Vec<bool> = judged.filter_map(|comparison| comparison.agrees).collect();
        if verdicts.is_empty() {
            continue;
        }
        let agreeing = verdicts.iter().filter(|&&agrees| agrees).count();
        line(page, &format!("\n## {heading}\n"));
        line(
            page,
            &format!(
                "Our mean less that of the {whom}, in per cent of the latter. {agreeing} of {} figures agree. **Bold** is the variant with which the paper's Max-Pressure row is compared.\n",
                verdicts.len()
            ),
        );
        let titles = JUDGED.map(|metric| metric.name().to_owned());
        row(page, &[vec!["scenario".to_owned(), "rule".to_owned()], titles.to_vec()].concat());
        row(page, &vec!["---".to_owned(); 2 + JUDGED.len()]);
        for scenario in &report.scenarios {
            for policy in &scenario.policies {
                let comparisons = of(policy);
                if comparisons.iter().all(|comparison| comparison.agrees.is_none()) {
                    continue;
                }
                let cells = JUDGED.map(|metric| {
                    let found = comparisons.iter().find(|comparison| comparison.metric == metric.key());
                    found.map_or_else(String::new, difference)
                });
                row(page, &[vec![code(&scenario.scenario), name(policy)], cells.to_vec()].concat());
            }
        }
    }
}

fn results(page: &mut String, scenario: &ScenarioReport) {
    line(page, &format!("\n## {}\n", heading(&scenario.scenario)));
    row(page, &header("rule", &Metric::PAPER));
    row(page, &vec!["---".to_owned(); 1 + Metric::PAPER.len()]);
    for policy in &scenario.policies {
        let ours = Metric::PAPER
            .map(|metric| policy.metrics.get(metric.key()).map_or_else(String::new, |f| figure(f, metric)));
        row(page, &[vec![marked(policy)], ours.to_vec()].concat());
        if let Some(method) = policy.paper_method {
            published(page, scenario, &format!("— paper, {}", paper_name(method)), method);
        }
        if !policy.reference.is_empty() {
            let theirs = Metric::PAPER.map(|metric| {
                let found = policy.reference.iter().find(|comparison| comparison.metric == metric.key());
                found.map_or_else(String::new, |comparison| {
                    format!("{:.*}{}", metric.digits(), comparison.theirs, verdict(comparison))
                })
            });
            row(page, &[vec!["— reference".to_owned()], theirs.to_vec()].concat());
        }
    }
    for method in ["gesa", "unicorn", "cross"] {
        published(page, scenario, &format!("paper, {}", paper_name(method)), method);
    }
    others(page, scenario);
}

/// A row of the paper, where it has one.
pub(super) fn published(page: &mut String, scenario: &ScenarioReport, label: &str, method: &str) {
    let found = Metric::PAPER.map(|metric| paper::lookup(&scenario.scenario, method, metric.key()));
    if found.iter().all(Option::is_none) {
        return;
    }
    // Two digits are what the paper prints.
    let cells =
        found.map(|found| found.map_or_else(String::new, |f| format!("{:.2} ({:.2})", f.mean, f.std)));
    row(page, &[vec![label.to_owned()], cells.to_vec()].concat());
}

/// What the paper does not report, and what became of the vehicles.
pub(super) fn others(page: &mut String, scenario: &ScenarioReport) {
    let further: Vec<_> = Metric::ALL.into_iter().filter(|metric| !Metric::PAPER.contains(metric)).collect();
    let fates = ["finished", "unfinished", "never_inserted", "teleports"];
    let mut titles = header("policy", &further);
    titles.extend(fates.map(|fate| fate.replace('_', " ")));
    titles.push("gridlock in seeds".to_owned());
    line(page, "");
    row(page, &titles);
    row(page, &vec!["---".to_owned(); titles.len()]);
    for policy in &scenario.policies {
        let mut cells = vec![name(policy)];
        cells.extend(further.iter().map(|metric| {
            let found = policy.metrics.get(metric.key());
            found.map_or_else(String::new, |figure| format!("{:.*}", metric.digits(), figure.mean))
        }));
        cells.extend(
            fates.map(|fate| policy.vehicles.get(fate).map_or_else(String::new, |n| format!("{n:.1}"))),
        );
        cells.push(if policy.gridlocked_seeds.is_empty() {
            "none".to_owned()
        } else {
            seeds(&policy.gridlocked_seeds)
        });
        row(page, &cells);
    }
}

pub(super) fn header(first: &str, metrics: &[Metric]) -> Vec<String> {
    let titles = metrics.iter().map(|metric| {
        let arrow = if metric.better() == Better::Lower { '↓' } else { '↑' };
        match metric.unit() {
            "1" => format!("{} {arrow}", metric.name()),
            unit => format!("{}, {unit} {arrow}", metric.name()),
        }
    });
    std::iter::once(first.to_owned()).chain(titles).collect()
}

pub(super) fn figure(figure: &Figure, metric: Metric) -> String {
    let digits = metric.digits();
    format!("{:.digits$} ({:.digits$})", figure.mean, figure.std)
}

fn difference(comparison: &Comparison) -> String {
    let text = format!("{:+.1}", 100.0 * comparison.difference);
    // What rounds to nothing has no direction.
    let text = if text.ends_with("0.0") && text.len() == 4 { "0.0" } else { &text };
    format!("{text} %{}", verdict(comparison))
}

fn verdict(comparison: &Comparison) -> &'static str {
    match comparison.agrees {
        Some(true) => " ✓",
        Some(false) => " ✗",
        None => "",
    }
}

/// The rule, bold where it is the paper's variant of Max-Pressure.
fn name(policy: &PolicyReport) -> String {
    let code = code(&policy.policy);
    if policy.paper_method.is_some() && policy.policy != RuleBased::FixedTime.name() {
        format!("**{code}**")
    } else {
        code
    }
}

/// The rule with what it is.
pub(super) fn marked(policy: &PolicyReport) -> String {
    let mut text = code(&policy.policy);
    let mut marks = Vec::new();
    if policy.paper_method.is_some() && policy.policy != RuleBased::FixedTime.name() {
        marks.push("as published");
    }
    if policy.strongest_max_pressure {
        marks.push("**strongest Max-Pressure**");
    }
    if !marks.is_empty() {
        let _ = write!(text, " ({})", marks.join(", "));
    }
    text
}

fn paper_name(method: &str) -> &str {
    match method {
        "fixed-time" => "Fixed-Time",
        "max-pressure" => "Max-Pressure",
        "gesa" => "GESA",
        "unicorn" => "Unicorn",
        "cross" => "CROSS",
        other => other,
    }
}

fn seeds(seeds: &[u32]) -> String {
    match seeds {
        [first, _, .., last] if (last - first) as usize + 1 == seeds.len() => format!("{first} to {last}"),
        _ => seeds.iter().map(u32::to_string).collect::<Vec<_>>().join(", "),
    }
}

/// The seeds of a scenario's rules: of most, and of those that have others.
fn all_seeds(scenario: &ScenarioReport) -> String {
    let mut groups: Vec<(&[u32], Vec<&str>)> = Vec::new();
    for policy in &scenario.policies {
        match groups.iter_mut().find(|(seeds, _)| *seeds == policy.seeds) {
            Some((_, policies)) => policies.push(&policy.policy),
            None => groups.push((&policy.seeds, vec![&policy.policy])),
        }
    }
    let text = groups.iter().enumerate().map(|(number, (of, policies))| match number {
        0 => seeds(of),
        _ => format!("{} ({})", seeds(of), policies.join(", ")),
    });
    text.collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::report;
    use super::*;

    fn page() -> String {
        render(&report(
            &["grid4x4", "mine"],
            &[
                RuleBased::FixedTime,
                RuleBased::MaxPressureStopped,
                RuleBased::MaxPressureAll,
                RuleBased::Greedy,
            ],
        ))
    }

    fn section<'p>(page: &'p str, heading: &str) -> &'p str {
        let start =
            page.find(&format!("\n## {heading}\n")).unwrap_or_else(|| panic!("{heading} is not in {page}"));
        let rest = &page[start + 1..];
        rest.find("\n## ").map_or(rest, |end| &rest[..end])
    }

    #[test]
    fn every_table_is_whole() {
        let page = page();
        let mut columns = None;
        for text in page.lines() {
            let cells = text.starts_with('|').then(|| text.matches(" | ").count());
            if let (Some(cells), Some(columns)) = (cells, columns) {
                assert_eq!(cells, columns, "{text}");
            }
            columns = cells;
        }
        assert!(!page.contains("NaN") && !page.contains("inf "), "{page}");
    }

    #[test]
    fn protocol_and_what_is_missing_are_told() {
        let page = page();
        let protocol = section(&page, "Protocol");
        for part in
            ["`cross baselines`", "SUMO 1.28.0", "every 10 s", "`0123456789ab`", "1, 2", "`jinan1`: get it"]
        {
            assert!(protocol.contains(part), "{part} is not in {protocol}");
        }
    }

    #[test]
    fn our_figures_the_paper_s_and_the_reference_s_stand_together() {
        let page = page();
        let lines: Vec<_> = section(&page, "grid4x4").lines().collect();
        let at = |text: &str| {
            lines.iter().position(|line| line.starts_with(text)).unwrap_or_else(|| panic!("{text}"))
        };
        let fixed = at("| `fixed-time` | 3.000 (1.500)");
        assert!(
            lines[fixed + 1].starts_with("| — paper, Fixed-Time | 0.12 (0.09) | 7.88 (1.28)"),
            "{}",
            lines[fixed + 1]
        );
        assert!(lines[fixed + 2].starts_with("| — reference | 0.118 ✗ |"), "{}", lines[fixed + 2]);
        let published = at("| `max-pressure-all` (as published)");
        assert!(lines[published + 1].starts_with("| — paper, Max-Pressure | 0.07 (0.06)"));
        at("| `max-pressure-stopped` (**strongest Max-Pressure**)");
        assert!(lines[at("| paper, CROSS")].contains("20.88 (19.36)"));
        // Nobody else has measured a scenario of one's own.
        let mine = section(&page, "mine");
        assert!(!mine.contains("paper") && !mine.contains("reference"), "{mine}");
    }

    #[test]
    fn disagreement_is_counted_and_shown() {
        let page = page();
        let reference = section(&page, "Beside the reference");
        // Three rules have a reference, four figures each, and made-up ones agree with none.
        assert!(reference.contains("0 of 12 figures agree"), "{reference}");
        assert_eq!(reference.matches('✗').count(), 12);
        assert!(reference.contains("| `grid4x4` | **`max-pressure-all`** |"), "{reference}");
        assert!(section(&page, "Beside the paper").contains("0 of 8 figures agree"));
    }

    #[test]
    fn odd_names_break_neither_table_nor_page() {
        let page = render(&report(&["a|b`c\nd # e"], &[RuleBased::Greedy]));
        assert!(page.contains("\n## a\\|b\\`c d \\# e\n"), "{page}");
        assert!(page.contains("| `` a\\|b`c d # e `` | 1473 |"), "{page}");
    }

    #[test]
    fn rules_with_other_seeds_are_named() {
        let mut report =
            report(&["grid5x5"], &[RuleBased::FixedTime, RuleBased::MaxPressureAll, RuleBased::Greedy]);
        report.scenarios[0].policies[2].seeds = vec![1, 2, 3];
        assert_eq!(all_seeds(&report.scenarios[0]), "1, 2; 1 to 3 (greedy)");
    }

    #[test]
    fn seeds_are_named_briefly() {
        assert_eq!(
            (seeds(&[1, 2, 3]), seeds(&[2, 5]), seeds(&[4])),
            ("1 to 3".into(), "2, 5".into(), "4".into())
        );
    }
}
