//! Several policies side by side, for people.

use super::report::{EvalReport, Protocol};
use crate::metrics::{Better, Metric};
use cross_config::Detection;
use std::fmt::Write;

/// Metrics that a table shows, papers' six first.
const SHOWN: [Metric; 11] = [
    Metric::QueueLength,
    Metric::Speed,
    Metric::TripCompletionRate,
    Metric::TripTime,
    Metric::TripDelay,
    Metric::TripDuration,
    Metric::WaitingTime,
    Metric::TimeLoss,
    Metric::Stops,
    Metric::Co2,
    Metric::Fuel,
];

/// A table for each scenario: one column for each of its reports, one row for each metric; the best value of a row bears
/// a star. A cell is the mean over seeds and, after ±, the deviation within an episode.
#[must_use]
pub fn table(reports: &[EvalReport]) -> String {
    let mut scenarios: Vec<&str> = Vec::new();
    for report in reports {
        if !scenarios.contains(&report.scenario.as_str()) {
            scenarios.push(&report.scenario);
        }
    }
    let tables = scenarios.into_iter().map(|scenario| {
        let of_scenario: Vec<_> = reports.iter().filter(|report| report.scenario == scenario).collect();
        scenario_table(scenario, &of_scenario)
    });
    tables.collect::<Vec<_>>().join("\n")
}

fn scenario_table(scenario: &str, reports: &[&EvalReport]) -> String {
    let mut rows = vec![header(reports)];
    rows.extend(SHOWN.map(|metric| metric_row(metric, reports)));
    rows.extend(vehicle_rows(reports));
    if reports.iter().any(|report| !report.gridlocked_seeds.is_empty()) {
        let cells = reports.iter().map(|report| {
            let seeds: Vec<_> = report.gridlocked_seeds.iter().map(u32::to_string).collect();
            if seeds.is_empty() { "-".to_owned() } else { seeds.join(",") }
        });
        rows.push(row("gridlock in seed", cells));
    }
    format!("{}\n{}", title(scenario, reports), aligned(&rows))
}

fn row(name: &str, cells: impl Iterator<Item = String>) -> Vec<String> {
    std::iter::once(name.to_owned()).chain(cells).collect()
}

fn header(reports: &[&EvalReport]) -> Vec<String> {
    row("", reports.iter().map(|report| report.policy.clone()))
}

fn metric_row(metric: Metric, reports: &[&EvalReport]) -> Vec<String> {
    let (arrow, sign) = match metric.better() {
        Better::Lower => ('↓', 1.0),
        Better::Higher => ('↑', -1.0),
    };
    let digits = metric.digits();
    // Compared as printed: of two equal figures neither is the better one.
    let figures: Vec<_> =
        reports.iter().map(|report| format!("{:.digits$}", report.get(metric).mean)).collect();
    let value = |figure: &String| figure.parse::<f64>().map_or(f64::INFINITY, |value| sign * value);
    let best = figures.iter().map(value).fold(f64::INFINITY, f64::min);
    let cells = reports.iter().zip(&figures).map(|(report, figure)| {
        let star = if reports.len() > 1 && value(figure) <= best { '*' } else { ' ' };
        format!("{figure}{star} ±{:.digits$}", report.get(metric).std)
    });
    let unit = match metric.unit() {
        "1" => String::new(),
        unit => format!(" ({unit})"),
    };
    row(&format!("{}{unit} {arrow}", metric.name()), cells)
}

fn vehicle_rows(reports: &[&EvalReport]) -> [Vec<String>; 4] {
    let counts = |name: &str, count: fn(&EvalReport) -> f64| {
        row(name, reports.iter().map(|report| format!("{:.1}", count(report))))
    };
    [
        counts("finished", |report| report.vehicles.finished),
        counts("unfinished", |report| report.vehicles.unfinished),
        counts("never inserted", |report| report.vehicles.never_inserted),
        counts("teleports", |report| report.vehicles.teleports),
    ]
}

/// Scenario, and in lines of their own the protocol that all columns have in common; what they do not is said to differ
/// rather than left out.
fn title(scenario: &str, reports: &[&EvalReport]) -> String {
    let Some((first, others)) = reports.split_first() else { return scenario.to_owned() };
    let common = |name: &str, text: &dyn Fn(&EvalReport) -> String| {
        let common = text(first);
        if others.iter().all(|other| text(other) == common) {
            common
        } else {
            format!("{name} differ between columns")
        }
    };
    let of = |name: &str, text: &dyn Fn(&Protocol) -> String| common(name, &|report| text(&report.protocol));
    let rules = [
        of("protocols", &|own| format!("protocol {}", own.preset)),
        common("intervals", &|report| {
            let Protocol { interval_seconds, yellow_seconds, episode_seconds, .. } = &report.protocol;
            if report.signals_by_sumo() {
                return format!("{episode_seconds} s, signals by SUMO, read every {interval_seconds} s");
            }
            format!(
                "{episode_seconds} s, decision every {interval_seconds} s with {yellow_seconds} s of yellow"
            )
        }),
        of("teleport times", &|own| match own.time_to_teleport_seconds {
            never if never < 0.0 => "no teleports".to_owned(),
            seconds => format!("teleport after {seconds} s"),
        }),
        of("detectors", &|own| {
            let detection = match own.detection {
                Detection::Paper => "within 50 m",
                Detection::Default | Detection::Fine => "whole lanes",
            };
            let beyond = match own.reward_beyond {
                0.0 => String::new(),
                weight => format!(" and {weight} of what is beyond"),
            };
            format!("detection {detection}, reward within {} m{beyond}", own.reward_range_metres)
        }),
    ];
    let files = [
        of("SUMO versions", &|own| format!("SUMO {}", own.sumo_version)),
        of("departure options", &|own| {
            format!("departure speed {}, lane {}", own.depart_speed, own.depart_lane)
        }),
        of("nets", &|own| format!("net {}", abbreviated(&own.net_hash))),
        of("demands", &|own| format!("demand {}", abbreviated(&own.demand_hash))),
    ];
    format!(
        "{scenario}, {}\n  {}\n  {}",
        common("seeds", &|report| seeds(&report.seeds)),
        rules.join(", "),
        files.join(", ")
    )
}

/// The beginning of a hash, enough to tell two apart at a glance; JSON has all of it.
fn abbreviated(hash: &str) -> &str {
    hash.get(..8).unwrap_or(hash)
}

fn seeds(seeds: &[u32]) -> String {
    match seeds {
        [] => "no seeds".to_owned(),
        [seed] => format!("seed {seed}"),
        [first, .., last] if (last - first) as usize + 1 == seeds.len() => format!("seeds {first} to {last}"),
        _ => format!("seeds {}", seeds.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// Names to the left, figures to the right, two spaces between columns.
fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.first().map_or(0, Vec::len);
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (column, (cell, &width)) in row.iter().zip(&widths).enumerate() {
            // Writing to a string cannot fail.
            let _ = match column {
                0 => write!(line, "  {cell:<width$}"),
                _ => write!(line, "  {cell:>width$}"),
            };
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::report;
    use super::*;

    fn line<'t>(text: &'t str, name: &str) -> &'t str {
        text.lines().find(|line| line.trim_start().starts_with(name)).unwrap()
    }

    #[test]
    fn columns_are_aligned_and_the_best_is_marked() {
        let text = table(&[
            report("grid4x4", "cross", &[10.0, 12.0]),
            report("grid4x4", "fixed-time", &[50.0, 52.0]),
            report("grid4x4", "max-pressure-stopped", &[23.0, 24.0]),
        ]);
        let title: Vec<_> = text.lines().take(3).collect();
        assert_eq!(
            title,
            [
                "grid4x4, seeds 1 to 2",
                "  protocol paper, 3600 s, decision every 10 s with 3 s of yellow, no teleports, detection whole lanes, \
                 reward within 50 m",
                "  SUMO 1.28.0, departure speed 0, lane first, net aa, demand bb",
            ]
        );
        let delay = line(&text, "trip delay (s) ↓");
        assert!(delay.contains("11.0* ±0.0"), "{delay}");
        assert!(delay.contains("51.0  ±0.0") && delay.contains("23.5  ±0.0"), "{delay}");
        // All three columns end where the header's do, in the same place in every row.
        let ends: Vec<usize> = ["trip delay", "speed", "trip time", "stops"]
            .iter()
            .map(|name| line(&text, name).chars().count())
            .collect();
        assert!(ends.iter().all(|&end| end == text.lines().nth(3).unwrap().chars().count()), "{text}");
    }

    #[test]
    fn the_rewards_weight_beyond_its_range_is_told_where_there_is_one() {
        let mut own = report("grid4x4", "cross", &[1.0]);
        own.protocol.reward_beyond = 0.25;
        let text = table(&[own]);
        assert!(text.contains("reward within 50 m and 0.25 of what is beyond\n"), "{text}");
    }

    #[test]
    fn a_program_of_sumos_is_not_said_to_decide() {
        let mut own = report("grid4x4", "actuated", &[1.0]);
        own.controller = "actuated".to_owned();
        let text = table(&[own]);
        assert!(text.contains("3600 s, signals by SUMO, read every 10 s"), "{text}");
        assert!(!text.contains("decision every"), "{text}");
    }

    #[test]
    fn equal_figures_share_the_star_and_a_single_column_has_none() {
        let two = table(&[report("s", "a", &[10.0]), report("s", "b", &[10.0])]);
        assert_eq!(line(&two, "trip delay").matches('*').count(), 2);
        let one = table(&[report("s", "a", &[10.0])]);
        assert_eq!(one.matches('*').count(), 0);
    }

    #[test]
    fn each_scenario_has_its_own_table() {
        let text = table(&[
            report("grid4x4", "a", &[1.0]),
            report("arterial4x4", "a", &[2.0]),
            report("grid4x4", "b", &[3.0]),
        ]);
        assert_eq!(text.matches("trip delay").count(), 2);
        let second = text.find("arterial4x4").unwrap();
        assert!(text[..second].contains("3.0"), "both reports of grid4x4 stand together:\n{text}");
        assert_eq!(table(&[]), "");
    }

    #[test]
    fn what_differs_between_columns_is_said() {
        let mut other = report("s", "b", &[1.0]);
        other.protocol.yellow_seconds = 5;
        other.protocol.demand_hash = "dd".to_owned();
        let text = table(&[report("s", "a", &[1.0, 2.0]), other]);
        for same in ["protocol paper", "no teleports", "net aa"] {
            assert!(text.contains(same), "{text}");
        }
        for difference in ["seeds differ", "intervals differ", "demands differ"] {
            assert!(text.contains(difference), "{text}");
        }
    }

    #[test]
    fn seeds_are_named_briefly() {
        assert_eq!(seeds(&[1, 2, 3]), "seeds 1 to 3");
        assert_eq!(seeds(&[1, 3]), "seeds 1, 3");
        assert_eq!(seeds(&[7]), "seed 7");
        assert_eq!(seeds(&[]), "no seeds");
    }

    #[test]
    fn a_gridlock_is_named_by_its_seed() {
        let mut locked = report("s", "b", &[1.0, 2.0]);
        locked.gridlocked_seeds = vec![2];
        let text = table(&[report("s", "a", &[1.0]), locked]);
        assert!(line(&text, "gridlock in seed").ends_with('2'), "{text}");
        assert!(!table(&[report("s", "a", &[1.0])]).contains("gridlock"));
    }
}
