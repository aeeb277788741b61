//! Distributions one below the other on a common axis: how long trips took under each policy.

use super::figure::{Figure, brief, points, series};
use super::number::{self, pixel};
use super::scale::Scale;
use maud::{Markup, html};

/// The vehicles of one policy, all seeds together.
pub(super) struct Distribution {
    pub(super) label: String,
    pub(super) place: usize,
    /// Trip times of those that arrived, seconds.
    pub(super) finished: Vec<f64>,
    /// Times until the end of those that did not.
    pub(super) unfinished: Vec<f64>,
}

pub(super) struct Histogram<'a> {
    pub(super) id: &'a str,
    pub(super) title: &'a str,
    pub(super) note: &'a str,
    pub(super) rows: &'a [Distribution],
}

const WIDTH: f64 = 1120.0;
const LEFT: f64 = 190.0;
const RIGHT: f64 = 220.0;
const TOP: f64 = 6.0;
const ROW: f64 = 58.0;
const FOOT: f64 = 36.0;
/// Bins that an axis is cut into, about.
const BINS: f64 = 70.0;
/// Share of the vehicles that the axis shows; the few beyond it are counted in its last bin.
const SHOWN: f64 = 0.99;

impl Histogram<'_> {
    pub(super) fn draw(&self) -> Markup {
        let bottom = TOP + ROW * self.rows.len() as f64;
        let longest = self.rows.iter().map(|row| quantile(&row.sorted(), SHOWN)).fold(1.0, f64::max);
        let across = Scale::around([0.0, longest], (LEFT, WIDTH - RIGHT), 8);
        let width = bin_width(across.high());
        let bins = ((across.high() / width).ceil() as usize).max(1);
        let shares: Vec<_> = self.rows.iter().map(|row| row.shares(width, bins)).collect();
        let tallest = shares.iter().flatten().map(|(finished, all)| finished.max(*all)).fold(1e-9, f64::max);
        let content = html! {
            g .grid {
                @for tick in across.ticks() {
                    line x1=(pixel(across.at(tick))) x2=(pixel(across.at(tick))) y1=(pixel(TOP)) y2=(pixel(bottom)) {}
                    text x=(pixel(across.at(tick))) y=(pixel(bottom + 16.0)) text-anchor="middle" { (across.label(tick)) }
                }
            }
            text .axis-name x=(pixel(WIDTH - RIGHT)) y=(pixel(bottom + 31.0)) text-anchor="end" { "trip time, s" }
            @for (number, (row, shares)) in self.rows.iter().zip(&shares).enumerate() {
                @let base = TOP + ROW * (number + 1) as f64;
                @let up = |share: f64| base - share / tallest * (ROW - 8.0);
                (ridge(row, shares, width, &across, &up, base))
            }
        };
        Figure {
            id: self.id,
            title: self.title,
            note: self.note,
            description: &self.description(width),
            size: (WIDTH, bottom + FOOT),
            class: "wide",
            legend: Markup::default(),
        }
        .draw(&content)
    }

    fn description(&self, width: f64) -> String {
        let told = self.rows.iter().map(|row| format!("{}: {}", row.label, row.summary()));
        format!("Histograms in bins of {width} s. {}.", told.collect::<Vec<_>>().join("; "))
    }
}

impl Distribution {
    fn sorted(&self) -> Vec<f64> {
        let mut all: Vec<f64> = self.finished.iter().chain(&self.unfinished).copied().collect();
        all.sort_by(f64::total_cmp);
        all
    }

    /// For each bin the share of the vehicles in it: the finished ones, and all.
    fn shares(&self, width: f64, bins: usize) -> Vec<(f64, f64)> {
        let mut counts = vec![(0_u32, 0_u32); bins];
        let times =
            self.finished.iter().map(|time| (time, 1)).chain(self.unfinished.iter().map(|time| (time, 0)));
        for (time, finished) in times {
            // What is negative or not a number counts in the first bin: the conversion saturates.
            let bin = ((time / width) as usize).min(bins - 1);
            counts[bin].0 += finished;
            counts[bin].1 += 1;
        }
        let all = (self.finished.len() + self.unfinished.len()).max(1) as f64;
        counts.into_iter().map(|(finished, of)| (f64::from(finished) / all, f64::from(of) / all)).collect()
    }

    fn summary(&self) -> String {
        let sorted = self.sorted();
        let (median, late) = (quantile(&sorted, 0.5), quantile(&sorted, 0.9));
        format!("median {} s, 90 % within {} s", number::fixed(median, 0), number::fixed(late, 0))
    }
}

fn ridge(
    row: &Distribution,
    shares: &[(f64, f64)],
    width: f64,
    across: &Scale,
    up: &dyn Fn(f64) -> f64,
    base: f64,
) -> Markup {
    let steps = |height: &dyn Fn(&(f64, f64)) -> f64| {
        let corners = shares.iter().enumerate().flat_map(|(bin, share)| {
            let (left, right) = (bin as f64 * width, ((bin + 1) as f64 * width).min(across.high()));
            [(across.at(left), up(height(share))), (across.at(right), up(height(share)))]
        });
        let ends = [(across.at(across.high()), base), (across.at(0.0), base)];
        points(corners.chain(ends))
    };
    let sorted = row.sorted();
    let median = across.at(quantile(&sorted, 0.5).min(across.high()));
    let unfinished = row.unfinished.len();
    html! {
        g .ridge .(series(row.place)) {
            title { (row.label) ": " (row.summary()) }
            @if unfinished > 0 { polygon .unfinished points=(steps(&|share| share.1)) {} }
            polygon .finished points=(steps(&|share| share.0)) {}
            line .median x1=(pixel(median)) x2=(pixel(median)) y1=(pixel(base - ROW + 10.0)) y2=(pixel(base)) {}
        }
        line .base x1=(pixel(LEFT)) x2=(pixel(WIDTH - RIGHT)) y1=(pixel(base)) y2=(pixel(base)) {}
        text .name x="0" y=(pixel(base - ROW / 2.0 + 12.0)) { title { (row.label) } (brief(&row.label, 26)) }
        text .aside x=(pixel(WIDTH - RIGHT + 14.0)) y=(pixel(base - ROW / 2.0 + 4.0)) { (row.summary()) }
        text .aside x=(pixel(WIDTH - RIGHT + 14.0)) y=(pixel(base - ROW / 2.0 + 19.0)) {
            (number::count(sorted.len() as u64)) " vehicles"
            @if unfinished > 0 { ", " (number::count(unfinished as u64)) " unfinished" }
        }
    }
}

/// A round width that cuts the axis into about [`BINS`].
fn bin_width(end: f64) -> f64 {
    let widths = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0, 60.0, 100.0, 200.0, 500.0];
    widths.into_iter().find(|width| end / width <= BINS).unwrap_or(end / BINS)
}

/// The value below which this share of the sorted values lies; 0 of none.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(place.saturating_sub(1)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(finished: &[f64], unfinished: &[f64]) -> Distribution {
        Distribution {
            label: "greedy".to_owned(),
            place: 0,
            finished: finished.to_vec(),
            unfinished: unfinished.to_vec(),
        }
    }

    #[test]
    fn shares_add_up_and_the_last_bin_holds_what_is_beyond() {
        let shares = row(&[5.0, 15.0, 15.0, 999.0], &[35.0]).shares(10.0, 4);
        let of: Vec<_> = shares.iter().map(|share| (share.0 * 5.0).round() as u32).collect();
        assert_eq!(of, [1, 2, 0, 1]);
        assert!((shares.iter().map(|share| share.1).sum::<f64>() - 1.0).abs() < 1e-9);
        assert!((shares[3].1 - 0.4).abs() < 1e-9, "the unfinished one is there too");
    }

    #[test]
    fn quantiles_are_values_that_occur() {
        let sorted = [1.0, 2.0, 3.0, 4.0];
        assert_eq!([0.0, 0.5, 0.9, 1.0].map(|share| quantile(&sorted, share)), [1.0, 2.0, 4.0, 4.0]);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }

    #[test]
    fn a_row_without_vehicles_is_drawn_empty() {
        let rows = [row(&[], &[]), row(&[100.0], &[3600.0])];
        let text = Histogram { id: "h", title: "t", note: "", rows: &rows }.draw().into_string();
        assert!(!text.contains("NaN") && text.contains("median 100 s, 90 % within 3600 s"), "{text}");
        assert_eq!(text.matches("class=\"finished\"").count(), 2);
        assert_eq!(text.matches("class=\"unfinished\"").count(), 1);
    }
}
