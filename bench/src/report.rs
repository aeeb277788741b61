//! What every benchmark gives: rows of a figure of ours beside a baseline's, on the same machine in the same run.

use serde::Serialize;

/// Which direction of a figure is the good one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// Times, costs, sizes.
    Lower,
    /// Rates.
    Higher,
}

/// One comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// What was measured, on which data.
    pub case: String,
    /// Unit of both figures.
    pub unit: String,
    /// Our figure.
    pub ours: f64,
    /// The baseline's.
    pub baseline: f64,
    /// What the baseline is.
    pub baseline_name: String,
    /// How many times better ours is: above 1 is better than the baseline, whichever direction is good.
    pub speedup: f64,
}

impl Row {
    /// A comparison of two figures of one unit.
    #[must_use]
    pub fn new(
        case: impl Into<String>,
        unit: impl Into<String>,
        better: Better,
        ours: f64,
        (baseline_name, baseline): (impl Into<String>, f64),
    ) -> Self {
        let speedup = match better {
            Better::Lower => baseline / ours,
            Better::Higher => ours / baseline,
        };
        Self {
            case: case.into(),
            unit: unit.into(),
            ours,
            baseline,
            baseline_name: baseline_name.into(),
            speedup,
        }
    }
}

/// A benchmark's result; its JSON form is fixed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Name of the benchmark, as in `cross bench NAME`.
    pub bench: String,
    /// Its comparisons.
    pub rows: Vec<Row>,
}

impl Report {
    /// A report on these rows.
    #[must_use]
    pub fn new(bench: impl Into<String>, rows: Vec<Row>) -> Self {
        Self { bench: bench.into(), rows }
    }

    /// A table for people.
    #[must_use]
    pub fn table(&self) -> String {
        let header = ["", "unit", "ours", "baseline", "times better", "the baseline is"].map(str::to_owned);
        let mut cells = vec![header];
        cells.extend(self.rows.iter().map(|row| {
            [
                row.case.clone(),
                row.unit.clone(),
                figure(row.ours),
                figure(row.baseline),
                format!("{:.2}", row.speedup),
                row.baseline_name.clone(),
            ]
        }));
        let widths: Vec<usize> = (0..cells[0].len())
            .map(|column| cells.iter().map(|row| row[column].chars().count()).max().unwrap_or(0))
            .collect();
        let mut text = format!("cross bench {}\n", self.bench);
        for row in &cells {
            let mut line = String::new();
            for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
                // Names to the left, figures to the right.
                let padded = if (2..=4).contains(&column) {
                    format!("{cell:>width$}")
                } else {
                    format!("{cell:<width$}")
                };
                line.push_str("  ");
                line.push_str(&padded);
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
        text
    }
}

/// Four significant digits, thousands whole.
fn figure(value: f64) -> String {
    let digits = match value.abs() {
        v if v >= 1000.0 => 0,
        v if v >= 100.0 => 1,
        v if v >= 10.0 => 2,
        v if v >= 1.0 => 3,
        _ => 4,
    };
    format!("{value:.digits$}")
}

/// What a share of the values does not exceed: 0.5 the middle one, 0.99 all but the highest hundredth. Not a number where
/// there is none.
#[must_use]
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    // A share below 1 of a length is an index, whatever is cut off.
    let at = (sorted.len() as f64 * share) as usize;
    sorted.get(at.min(sorted.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}

/// The middle value; of an even number, the mean of the middle two. Not a number where there is none.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => f64::midpoint(sorted[n / 2 - 1], sorted[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speedup_above_one_is_better_in_both_directions() {
        let time = Row::new("a", "s", Better::Lower, 2.0, ("plain", 10.0));
        let rate = Row::new("b", "1/s", Better::Higher, 10.0, ("plain", 2.0));
        assert_eq!((time.speedup, rate.speedup), (5.0, 5.0));
        assert!(Row::new("c", "s", Better::Lower, 10.0, ("bare", 2.0)).speedup < 1.0);
    }

    #[test]
    fn json_has_the_fixed_keys_and_no_others() {
        let row = Row::new("a", "s", Better::Lower, 2.0, ("plain", 10.0));
        let json = serde_json::to_value(Report::new("update", vec![row])).unwrap();
        let expected = serde_json::json!({
            "bench": "update",
            "rows": [{
                "case": "a", "unit": "s", "ours": 2.0, "baseline": 10.0, "baseline_name": "plain", "speedup": 5.0
            }],
        });
        assert_eq!(json, expected);
    }

    #[test]
    fn the_table_lines_figures_up() {
        let rows = vec![
            Row::new("short", "s", Better::Lower, 2.0, ("plain", 10.0)),
            Row::new("a longer case", "s", Better::Lower, 1234.5, ("plain", 10.0)),
        ];
        let table = Report::new("update", rows).table();
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(lines.len(), 4);
        let end = |line: &str, cell: &str| line.find(cell).map(|at| at + cell.len());
        assert_eq!(end(lines[2], "2.000"), end(lines[3], " 1234"), "{table}");
        assert_eq!(end(lines[1], "ours"), end(lines[2], "2.000"), "{table}");
    }

    #[test]
    fn the_median_is_the_middle() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
        assert!(median(&[]).is_nan());
    }

    #[test]
    fn quantiles_of_a_thousand() {
        let values: Vec<f64> = (0..1000).map(f64::from).collect();
        assert_eq!(
            (quantile(&values, 0.5), quantile(&values, 0.99), quantile(&values, 1.0)),
            (500.0, 990.0, 999.0)
        );
        assert!(quantile(&[], 0.5).is_nan());
    }
}
