//! Published figures to hold ours against: the tables of the CROSS paper, read from `data/paper-results.csv`.

use cross_sim::controller::RuleBased;
use std::sync::LazyLock;

const TABLE: &str = include_str!("../data/paper-results.csv");

/// One figure of the paper's result tables.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PaperResult {
    /// Scenario, by our name.
    pub(crate) scenario: &'static str,
    /// `fixed-time`, `max-pressure`, `gesa`, `unicorn` or `cross`.
    pub(crate) method: &'static str,
    /// Metric, by its key: [`cross_sim::metrics::Metric::key`], and in its unit.
    pub(crate) metric: &'static str,
    pub(crate) mean: f64,
    /// What the paper has in brackets: the deviation inside an episode, over its seconds or vehicles.
    pub(crate) std: f64,
}

/// Every figure, in the order of the paper.
pub(crate) fn results() -> &'static [PaperResult] {
    static RESULTS: LazyLock<Vec<PaperResult>> =
        LazyLock::new(|| records(TABLE).filter_map(|fields| result(&fields)).collect());
    &RESULTS
}

/// The paper's figure, if it has one.
pub(crate) fn lookup(scenario: &str, method: &str, metric: &str) -> Option<&'static PaperResult> {
    results()
        .iter()
        .find(|result| (result.scenario, result.method, result.metric) == (scenario, method, metric))
}

/// The variant of Max-Pressure with which the paper's row of a scenario is reproduced; the paper does not say which it ran.
pub(crate) fn max_pressure_variant(scenario: &str) -> Option<RuleBased> {
    match scenario {
        "grid4x4" | "arterial4x4" => Some(RuleBased::MaxPressureAll),
        "grid5x5" => Some(RuleBased::MaxPressureStopped50m),
        "jinan1" | "jinan2" | "jinan3" | "hangzhou1" | "hangzhou2" => Some(RuleBased::MaxPressureStopped),
        _ => None,
    }
}

/// The lines of one of our CSV files below its header; `#` begins a comment line, and no field is quoted.
pub(crate) fn records(table: &str) -> impl Iterator<Item = Vec<&str>> {
    let lines = table.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    lines.skip(1).map(|line| line.split(',').map(str::trim).collect())
}

fn result(fields: &[&'static str]) -> Option<PaperResult> {
    let &[scenario, method, metric, mean, std] = fields else { return None };
    Some(PaperResult { scenario, method, metric, mean: mean.parse().ok()?, std: std.parse().ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cross_sim::metrics::Metric;
    use std::collections::HashSet;

    #[test]
    fn the_table_is_complete() {
        // 8 scenarios, 5 methods, 5 metrics; a line that cannot be read would be missing.
        let results = results();
        assert_eq!(results.len(), 200);
        let keys: HashSet<_> = results.iter().map(|r| (r.scenario, r.method, r.metric)).collect();
        assert_eq!(keys.len(), 200, "no figure twice");
        for result in results {
            assert!(Metric::PAPER.iter().any(|metric| metric.key() == result.metric), "{result:?}");
            assert!(result.mean > 0.0 && result.std > 0.0, "{result:?}");
        }
    }

    #[test]
    fn figures_are_found_by_name() {
        let found = lookup("grid4x4", "cross", "trip_delay").unwrap();
        assert_eq!((found.mean, found.std), (20.88, 19.36));
        assert_eq!(lookup("grid4x4", "cross", "trip_duration"), None);
        assert_eq!(lookup("cologne8", "cross", "trip_delay"), None);
    }
}
