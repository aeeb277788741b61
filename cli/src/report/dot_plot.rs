//! Several policies under several metrics at a glance: a row for each policy, a column with an axis of its own for each metric.

use super::figure::{Figure, brief, points, series};
use super::number::{self, pixel};
use super::scale::Scale;
use maud::{Markup, html};

/// A metric.
pub(super) struct Column {
    pub(super) title: String,
    /// The unit, and which way is better.
    pub(super) note: String,
    pub(super) digits: usize,
    /// One for each row.
    pub(super) cells: Vec<Cell>,
}

/// A policy under a metric.
#[derive(Default)]
pub(super) struct Cell {
    /// Mean over the seeds.
    pub(super) mean: f64,
    /// Of each seed.
    pub(super) seeds: Vec<f64>,
    /// The published figure, where there is one.
    pub(super) published: Option<f64>,
}

/// A policy.
pub(super) struct Row {
    pub(super) label: String,
    pub(super) place: usize,
}

pub(super) struct DotPlot<'a> {
    pub(super) id: &'a str,
    pub(super) title: &'a str,
    pub(super) note: &'a str,
    pub(super) rows: &'a [Row],
    pub(super) columns: &'a [Column],
}

const WIDTH: f64 = 1120.0;
const NAMES: f64 = 182.0;
const GAP: f64 = 34.0;
const HEAD: f64 = 38.0;
const ROW: f64 = 26.0;
const FOOT: f64 = 24.0;

impl DotPlot<'_> {
    pub(super) fn draw(&self) -> Markup {
        let bottom = HEAD + ROW * self.rows.len() as f64;
        let pitch = (WIDTH - NAMES) / self.columns.len().max(1) as f64;
        let content = html! {
            @for (number, row) in self.rows.iter().enumerate() {
                text .name x="0" y=(pixel(middle(number) + 4.0)) { title { (row.label) } (brief(&row.label, 26)) }
            }
            @for (number, column) in self.columns.iter().enumerate() {
                (self.column(column, NAMES + pitch * number as f64, NAMES + pitch * (number + 1) as f64 - GAP, bottom))
            }
        };
        Figure {
            id: self.id,
            title: self.title,
            note: self.note,
            description: "Dot plot: a row for each policy, a column for each metric. The table above holds the same figures.",
            size: (WIDTH, bottom + FOOT),
            class: "wide",
            legend: Markup::default(),
        }
        .draw(&content)
    }

    fn column(&self, column: &Column, left: f64, right: f64, bottom: f64) -> Markup {
        let cells = column.cells.iter();
        let values =
            cells.flat_map(|cell| cell.seeds.iter().copied().chain(cell.published).chain([cell.mean, 0.0]));
        let scale = Scale::around(values, (left, right), 3);
        html! {
            text .column-name x=(pixel(left)) y="12" { (column.title) }
            text .column-note x=(pixel(left)) y="26" { (column.note) }
            g .grid {
                @for tick in scale.ticks() {
                    line x1=(pixel(scale.at(tick))) x2=(pixel(scale.at(tick))) y1=(pixel(HEAD)) y2=(pixel(bottom)) {}
                    text x=(pixel(scale.at(tick))) y=(pixel(bottom + 15.0)) text-anchor="middle" { (scale.label(tick)) }
                }
            }
            @for (number, (row, cell)) in self.rows.iter().zip(&column.cells).enumerate() {
                g .(series(row.place)) {
                    title { (told(row, column, cell)) }
                    // A target that a pointer finds.
                    rect .target x=(pixel(left)) width=(pixel(right - left)) y=(pixel(middle(number) - ROW / 2.0)) height=(pixel(ROW)) {}
                    line .stem x1=(pixel(scale.at(scale.low().max(0.0)))) x2=(pixel(scale.at(cell.mean))) y1=(pixel(middle(number))) y2=(pixel(middle(number))) {}
                    @for &seed in &cell.seeds {
                        line .seed x1=(pixel(scale.at(seed))) x2=(pixel(scale.at(seed))) y1=(pixel(middle(number) - 6.0)) y2=(pixel(middle(number) + 6.0)) {}
                    }
                    circle .dot cx=(pixel(scale.at(cell.mean))) cy=(pixel(middle(number))) r="4.5" {}
                    @if let Some(published) = cell.published {
                        polygon .published points=(diamond(scale.at(published), middle(number))) {}
                    }
                }
            }
        }
    }
}

fn middle(row: usize) -> f64 {
    HEAD + ROW * (row as f64 + 0.5)
}

fn diamond(x: f64, y: f64) -> String {
    points([(x - 5.5, y), (x, y - 5.5), (x + 5.5, y), (x, y + 5.5)])
}

fn told(row: &Row, column: &Column, cell: &Cell) -> String {
    let shown = |value: f64| number::fixed(value, column.digits);
    let seeds: Vec<_> = cell.seeds.iter().copied().map(shown).collect();
    let published = cell.published.map_or_else(String::new, |value| format!("; published {}", shown(value)));
    format!("{}, {}: {} (seeds: {}){published}", row.label, column.title, shown(cell.mean), seeds.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_policy_has_a_dot_its_seeds_and_its_published_figure() {
        let rows = ["cross", "fixed-time"].map(|label| Row { label: label.to_owned(), place: 0 });
        let cell = |published| Cell { mean: 2.0, seeds: vec![1.0, 2.0, 3.0], published };
        let columns = [Column {
            title: "queue length".to_owned(),
            note: "veh ↓".to_owned(),
            digits: 1,
            cells: vec![cell(None), cell(Some(2.5))],
        }];
        let text =
            DotPlot { id: "d", title: "t", note: "", rows: &rows, columns: &columns }.draw().into_string();
        assert_eq!(text.matches("class=\"dot\"").count(), 2);
        assert_eq!(text.matches("class=\"seed\"").count(), 6);
        assert_eq!(text.matches("class=\"published\"").count(), 1);
        assert!(
            text.contains("fixed-time, queue length: 2.0 (seeds: 1.0, 2.0, 3.0); published 2.5"),
            "{text}"
        );
    }
}
