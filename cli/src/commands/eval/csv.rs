//! A report as a table for other programs: one row for each figure of each seed, then one for each figure over all seeds.

use crate::failure::Outcome;
use cross_sim::evaluate::EvalReport;
use cross_sim::metrics::{Definition, EpisodeMetrics, Metric, definitions};

/// The columns, in their order.
pub(super) const COLUMNS: [&str; 10] = [
    "scenario",
    "policy",
    "controller",
    "protocol",
    "seed",
    "metric",
    "unit",
    "mean",
    "std",
    "std_between_seeds",
];
/// What the column `seed` says of the figures over all seeds.
pub(super) const ALL_SEEDS: &str = "all";

/// Figures of one row: mean, deviation inside an episode, deviation between seeds.
type Figures = (f64, Option<f64>, Option<f64>);

/// The table with its header. Figures have all their digits: read back, they are the numbers of the report.
pub(super) fn table(report: &EvalReport) -> Outcome<Vec<u8>> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(COLUMNS)?;
    let mut row = |seed: &str, definition: &Definition, (mean, std, between): Figures| {
        let blank = |figure: Option<f64>| figure.map(|figure| figure.to_string()).unwrap_or_default();
        table.write_record([
            &report.scenario,
            &report.policy,
            &report.controller,
            &report.protocol.preset,
            seed,
            definition.key,
            definition.unit,
            &mean.to_string(),
            &blank(std),
            &blank(between),
        ])
    };
    for episode in &report.per_seed {
        for definition in definitions() {
            row(&episode.seed.to_string(), definition, of_seed(episode, definition.key))?;
        }
    }
    for definition in definitions() {
        row(ALL_SEEDS, definition, of_all(report, definition.key))?;
    }
    Ok(table.into_inner()?)
}

fn of_seed(episode: &EpisodeMetrics, key: &str) -> Figures {
    match Metric::from_key(key) {
        Some(metric) => {
            let figures = episode.get(metric);
            (figures.mean, Some(figures.std), None)
        }
        None => (count(episode, key), None, None),
    }
}

fn of_all(report: &EvalReport, key: &str) -> Figures {
    match Metric::from_key(key) {
        Some(metric) => {
            let figures = report.get(metric);
            (figures.mean, Some(figures.std), Some(figures.std_between_seeds))
        }
        None => {
            let counts: f64 = report.per_seed.iter().map(|episode| count(episode, key)).sum();
            (counts / report.per_seed.len().max(1) as f64, None, None)
        }
    }
}

/// One of the counts that an episode has beside its metrics.
fn count(episode: &EpisodeMetrics, key: &str) -> f64 {
    let vehicles = &episode.vehicles;
    match key {
        "finished" => vehicles.finished as f64,
        "unfinished" => vehicles.unfinished as f64,
        "never_inserted" => vehicles.never_inserted as f64,
        "teleports" => vehicles.teleports as f64,
        "episode_return" => episode.episode_return,
        "gridlock" => f64::from(u8::from(episode.gridlock)),
        // The test below holds this list against that of the definitions.
        _ => f64::NAN,
    }
}
