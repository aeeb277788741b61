//! A learned policy beside the rules and the paper's methods as a page of Markdown: `docs/results.md`.

use super::markdown::{code, heading, line, row};
use super::page::{figure, header, marked, others, protocol, published};
use super::pictures;
use super::report::{PolicyReport, Report, ScenarioReport};
use crate::paper;
use cross_sim::controller::RuleBased;
use cross_sim::metrics::{Better, Metric};

const INTRODUCTION: &str = include_str!("../../data/results-introduction.md");
/// The metrics by which the page says at once who is ahead.
const JUDGED: [Metric; 2] = [Metric::TripDelay, Metric::QueueLength];

/// The whole page.
pub(crate) fn render(report: &Report) -> String {
    let mut page = format!("{}\n", INTRODUCTION.trim_end());
    for metric in JUDGED {
        summary(&mut page, report, metric);
    }
    verdicts(&mut page, report);
    protocol(&mut page, report);
    for scenario in &report.scenarios {
        table(&mut page, scenario);
        picture(&mut page, report, scenario);
    }
    page
}

/// One metric, all scenarios.
fn summary(page: &mut String, report: &Report, metric: Metric) {
    line(page, &format!("\n## {}\n", heading(&format!("{}, {}", metric.name(), metric.unit()))));
    let titles = [
        "scenario",
        "policy",
        "its training",
        "here",
        "Fixed-Time",
        "strongest Max-Pressure",
        "beside it",
        "never let in",
        "the paper's CROSS",
        "beside it",
    ];
    row(page, &titles.map(str::to_owned));
    row(page, &["---"; 10].map(str::to_owned));
    for scenario in &report.scenarios {
        for (policy, training) in learned(scenario) {
            let Some(ours) = mean(policy, metric) else { continue };
            let shown = |value: Option<f64>| {
                value.map_or_else(String::new, |value| format!("{value:.*}", metric.digits()))
            };
            let beside = |other: Option<f64>| other.map_or_else(String::new, |other| difference(ours, other));
            let strongest = strongest(scenario).and_then(|policy| mean(policy, metric));
            let published = paper::lookup(&scenario.scenario, "cross", metric.key()).map(|found| found.mean);
            row(
                page,
                &[
                    code(&scenario.scenario),
                    code(&policy.policy),
                    training.to_owned(),
                    format!("**{}**", shown(Some(ours))),
                    shown(fixed_time(scenario).and_then(|policy| mean(policy, metric))),
                    shown(strongest),
                    beside(strongest),
                    outside(scenario, policy),
                    // Two digits are what the paper prints.
                    published.map_or_else(String::new, |value| format!("{value:.2}")),
                    beside(published),
                ],
            );
        }
    }
}

/// In how many figures a policy is ahead of whom.
fn verdicts(page: &mut String, report: &Report) {
    line(page, "\n## Who is ahead\n");
    line(page, "Means over the seeds, in all metrics that both have; a tie is nobody's.\n");
    row(page, &["policy", "of whom", "ahead in", "behind in"].map(str::to_owned));
    row(page, &["---"; 4].map(str::to_owned));
    let mut names: Vec<&str> = Vec::new();
    for (policy, _) in report.scenarios.iter().flat_map(learned) {
        if !names.contains(&policy.policy.as_str()) {
            names.push(&policy.policy);
        }
    }
    for name in names {
        for (whom, other) in OTHERS {
            let figures = shared(report, name, other);
            let behind: Vec<_> = figures
                .iter()
                .filter(|figure| better(figure.metric, figure.theirs, figure.ours))
                .map(|figure| format!("{} ({})", code(&figure.scenario.scenario), figure.metric.name()))
                .collect();
            let ahead =
                figures.iter().filter(|figure| better(figure.metric, figure.ours, figure.theirs)).count();
            if !figures.is_empty() {
                let behind = if behind.is_empty() { "none".to_owned() } else { behind.join(", ") };
                row(page, &[code(name), whom.to_owned(), format!("{ahead} of {}", figures.len()), behind]);
            }
        }
    }
}

/// A metric on a scenario that both a policy and somebody else have.
struct Shared<'r> {
    scenario: &'r ScenarioReport,
    metric: Metric,
    ours: f64,
    theirs: f64,
}

fn shared<'r>(report: &'r Report, name: &str, other: Other) -> Vec<Shared<'r>> {
    let mut figures = Vec::new();
    for scenario in &report.scenarios {
        let Some((policy, _)) = learned(scenario).find(|(policy, _)| policy.policy == name) else { continue };
        figures.extend(Metric::PAPER.into_iter().filter_map(|metric| {
            let (ours, theirs) = (mean(policy, metric)?, other(scenario, metric)?);
            Some(Shared { scenario, metric, ours, theirs })
        }));
    }
    figures
}

/// Somebody's figure on a scenario.
type Other = fn(&ScenarioReport, Metric) -> Option<f64>;

/// Those that a policy is held against.
const OTHERS: [(&str, Other); 3] = [
    ("Fixed-Time", |scenario, metric| mean(fixed_time(scenario)?, metric)),
    ("the strongest Max-Pressure", |scenario, metric| mean(strongest(scenario)?, metric)),
    ("the paper's CROSS", |scenario, metric| {
        paper::lookup(&scenario.scenario, "cross", metric.key()).map(|found| found.mean)
    }),
];

fn table(page: &mut String, scenario: &ScenarioReport) {
    line(page, &format!("\n## {}\n", heading(&scenario.scenario)));
    row(page, &header("policy", &Metric::PAPER));
    row(page, &vec!["---".to_owned(); 1 + Metric::PAPER.len()]);
    for policy in &scenario.policies {
        let cells = Metric::PAPER
            .map(|metric| policy.metrics.get(metric.key()).map_or_else(String::new, |f| figure(f, metric)));
        let name = match &policy.learned {
            Some(learned) => format!("**{}**, weights {}", code(&policy.policy), code(&learned.weights)),
            None => marked(policy),
        };
        row(page, &[vec![name], cells.to_vec()].concat());
    }
    for (method, name) in [("cross", "CROSS"), ("gesa", "GESA"), ("unicorn", "Unicorn")] {
        published(page, scenario, &format!("paper, {name}"), method);
    }
    others(page, scenario);
}

/// The scenario's picture, if there are pictures.
fn picture(page: &mut String, report: &Report, scenario: &ScenarioReport) {
    if let Some(folder) = &report.pictures {
        let file = folder.join(pictures::file_name(&scenario.scenario)).display().to_string();
        let name = heading(&scenario.scenario);
        // In angle brackets a path may hold blanks.
        line(page, &format!("\n![{name}: queue and speed over time, experts and clusters](<{file}>)"));
    }
}

/// Vehicles that found no room to enter, here and under the strongest Max-Pressure: trip time and delay leave them out.
fn outside(scenario: &ScenarioReport, policy: &PolicyReport) -> String {
    let count = |policy: &PolicyReport| {
        policy.vehicles.get("never_inserted").map_or_else(String::new, |count| format!("{count:.0}"))
    };
    match strongest(scenario) {
        Some(other) => format!("{}; {}", count(policy), count(other)),
        None => count(policy),
    }
}

/// The learned policies, and what each had to do with the scenario before.
fn learned(scenario: &ScenarioReport) -> impl Iterator<Item = (&PolicyReport, &'static str)> {
    scenario.policies.iter().filter_map(|policy| {
        let training = match policy.learned.as_ref()?.trained_here {
            Some(true) => "trained on it",
            Some(false) => "zero-shot",
            None => "not told",
        };
        Some((policy, training))
    })
}

fn fixed_time(scenario: &ScenarioReport) -> Option<&PolicyReport> {
    scenario.policies.iter().find(|policy| policy.policy == RuleBased::FixedTime.name())
}

fn strongest(scenario: &ScenarioReport) -> Option<&PolicyReport> {
    scenario.policies.iter().find(|policy| policy.strongest_max_pressure)
}

fn mean(policy: &PolicyReport, metric: Metric) -> Option<f64> {
    policy.metrics.get(metric.key()).map(|figure| figure.mean)
}

/// How far a figure is from another, in per cent of that.
fn difference(ours: f64, other: f64) -> String {
    let percent = (100.0 * (ours - other) / other).round();
    match percent {
        // Nothing is no measure.
        odd if !odd.is_finite() => String::new(),
        // What rounds to nothing has no direction.
        0.0 => "0 %".to_owned(),
        percent => format!("{percent:+.0} %"),
    }
}

fn better(metric: Metric, ours: f64, theirs: f64) -> bool {
    if metric.better() == Better::Lower { ours < theirs } else { ours > theirs }
}

#[cfg(test)]
mod tests {
    use super::super::report::LearnedReport;
    use super::super::report::tests::report;
    use super::*;

    /// Fixed-Time has 3 in every metric, the variants of Max-Pressure 6 and 9; `greedy`, 12, plays the learned policy.
    fn page(ours: f64) -> String {
        let mut report = report(
            &["grid4x4", "mine"],
            &[
                RuleBased::FixedTime,
                RuleBased::MaxPressureStopped,
                RuleBased::MaxPressureAll,
                RuleBased::Greedy,
            ],
        );
        for scenario in &mut report.scenarios {
            let trained_here = Some(scenario.scenario == "grid4x4");
            let policy = &mut scenario.policies[3];
            policy.policy = "pretrained/one".to_owned();
            policy.learned = Some(LearnedReport { weights: "0123456789ab".to_owned(), trained_here });
            policy.metrics.values_mut().for_each(|figure| figure.mean = ours);
        }
        render(&report)
    }

    fn lines<'p>(page: &'p str, of: &str) -> Vec<&'p str> {
        page.lines().filter(|line| line.contains(of)).collect()
    }

    #[test]
    fn a_policy_stands_beside_the_rules_and_the_paper() {
        let page = page(2.0);
        let delay = lines(
            &page,
            "| `grid4x4` | `pretrained/one` | trained on it | **2.0** | 3.0 | 6.0 | -67 % | ;  | 20.88 | -90 % |",
        );
        assert_eq!(delay.len(), 1, "{page}");
        // A scenario of one's own is in no paper, and one that was not trained on is told.
        let own = lines(
            &page,
            "| `mine` | `pretrained/one` | zero-shot | **2.0** | 3.0 | 6.0 | -67 % | ;  |  |  |",
        );
        assert_eq!(own.len(), 1, "{page}");
        assert_eq!(lines(&page, "| **`pretrained/one`**, weights `0123456789ab` | 2.000").len(), 2, "{page}");
    }

    #[test]
    fn pictures_are_shown_where_there_are_some() {
        let mut report = report(&["grid4x4", "my/own"], &[RuleBased::FixedTime]);
        assert!(!render(&report).contains("!["));
        report.pictures = Some("images/results".into());
        let page = render(&report);
        assert_eq!(lines(&page, "](<images/results/grid4x4.svg>)").len(), 1, "{page}");
        assert_eq!(lines(&page, "](<images/results/my_own.svg>)").len(), 1, "{page}");
    }

    #[test]
    fn who_is_behind_is_told_where() {
        // Lower is better in four of the six metrics.
        let page = page(2.0);
        let of = |whom: &str| lines(&page, &format!("| `pretrained/one` | {whom} |"))[0].to_owned();
        let fixed = of("Fixed-Time");
        assert!(fixed.contains("| 8 of 12 |") && fixed.contains("`grid4x4` (speed)"), "{fixed}");
        assert!(of("the paper's CROSS").contains("of 5 |"), "{page}");
        // Equal is not ahead.
        let equal = super::tests::page(3.0);
        assert_eq!(lines(&equal, "| `pretrained/one` | Fixed-Time | 0 of 12 | none |").len(), 1, "{equal}");
    }

    #[test]
    fn differences_are_figures() {
        let shown = [(3.0, 2.0), (1.0, 2.0), (20.0, 20.05), (1.0, 0.0), (0.0, 0.0)];
        assert_eq!(shown.map(|(ours, other)| difference(ours, other)), ["+50 %", "-50 %", "0 %", "", ""]);
    }

    #[test]
    fn every_table_is_whole() {
        let mut columns = None;
        for text in page(2.0).lines() {
            let cells = text.starts_with('|').then(|| text.matches(" | ").count());
            if let (Some(cells), Some(columns)) = (cells, columns) {
                assert_eq!(cells, columns, "{text}");
            }
            columns = cells;
        }
    }
}
