//! Curves: over the seconds of an episode, or over the updates of a run.

use super::figure::{Figure, Key, legend, points, series};
use super::number::pixel;
use super::scale::Scale;
use maud::{Markup, html};

/// What is on the horizontal axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Over {
    /// Seconds of an episode, shown as minutes.
    Time,
    /// Updates of a run.
    Updates,
}

/// A named curve.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Curve {
    pub(super) label: String,
    /// Place among the series of the page, for its colour.
    pub(super) place: usize,
    pub(super) points: Vec<(f64, f64)>,
    /// Least and greatest value around it: (x, low, high). Empty for a curve without a band.
    pub(super) band: Vec<(f64, f64, f64)>,
}

/// Curves on common axes.
pub(super) struct LineChart<'a> {
    pub(super) id: &'a str,
    pub(super) title: &'a str,
    pub(super) note: &'a str,
    pub(super) over: Over,
    pub(super) curves: &'a [Curve],
    /// Whether the vertical axis begins at zero whatever the values.
    pub(super) zero: bool,
    pub(super) size: (f64, f64),
    /// Whether it tells its own colours; charts side by side share a legend instead.
    pub(super) legend: bool,
}

const LEFT: f64 = 46.0;
const RIGHT: f64 = 10.0;
const TOP: f64 = 8.0;
const BOTTOM: f64 = 34.0;

impl LineChart<'_> {
    pub(super) fn draw(&self) -> Markup {
        let (width, height) = self.size;
        let xs = self.curves.iter().flat_map(|curve| curve.points.iter().map(|point| point.0));
        // An episode begins half an interval before the first point and ends as much after the last.
        let end = |curve: &Curve| Some(curve.points.last()?.0 + curve.points.first()?.0);
        let episode = std::iter::once(0.0).chain(self.curves.iter().filter_map(end));
        let episode = episode.filter(|_| self.over == Over::Time);
        let across =
            Scale::exact(xs.chain(episode), (LEFT, width - RIGHT), if width > 400.0 { 8 } else { 5 });
        let (across, axis) = match self.over {
            Over::Time => (across.in_minutes(), "time, min"),
            Over::Updates => (across.whole(), "update"),
        };
        let of_points = self.curves.iter().flat_map(|curve| curve.points.iter().map(|point| point.1));
        let of_bands =
            self.curves.iter().flat_map(|curve| curve.band.iter().flat_map(|&(_, low, high)| [low, high]));
        let values = of_points.chain(of_bands).chain(self.zero.then_some(0.0));
        let up = Scale::around(values, (height - BOTTOM, TOP), if height > 200.0 { 5 } else { 4 });
        let content = html! {
            (grid(&across, &up, self.over, (LEFT, width - RIGHT)))
            text .axis-name x=(pixel(width - RIGHT)) y=(pixel(height - 4.0)) text-anchor="end" { (axis) }
            @for curve in self.curves {
                @if !curve.band.is_empty() { polygon .band .(series(curve.place)) points=(band(curve, &across, &up)) {} }
            }
            @for curve in self.curves {
                g .curve .(series(curve.place)) data-label=(curve.label) { (line(curve, &across, &up)) }
            }
        };
        // What the script that shows values needs to turn pixels back into them.
        let axes = format!(
            "{} {} {} {} {} {} {} {}",
            across.low(),
            across.high(),
            LEFT,
            width - RIGHT,
            up.low(),
            up.high(),
            height - BOTTOM,
            TOP
        );
        let over = match self.over {
            Over::Time => "time",
            Over::Updates => "updates",
        };
        let content = html! { g .chart data-axes=(axes) data-over=(over) { (content) } };
        let keys = self.curves.iter().map(|curve| Key { label: &curve.label, place: curve.place });
        Figure {
            id: self.id,
            title: self.title,
            note: self.note,
            description: &self.description(axis),
            size: self.size,
            class: "",
            legend: if self.legend { legend(keys) } else { Markup::default() },
        }
        .draw(&content)
    }

    fn description(&self, axis: &str) -> String {
        let first_and_last = |curve: &Curve| {
            let (first, last) = (curve.points.first()?, curve.points.last()?);
            let short = super::number::short;
            Some(format!("{}: from {} to {}", curve.label, short(first.1), short(last.1)))
        };
        let curves: Vec<_> = self.curves.iter().filter_map(first_and_last).collect();
        format!("Line chart over {axis}. {}.", curves.join("; "))
    }
}

/// Lines across at the ticks, and the numbers at both axes.
fn grid(across: &Scale, up: &Scale, over: Over, (left, right): (f64, f64)) -> Markup {
    let bottom = up.at(up.low());
    html! {
        g .grid {
            @for tick in up.ticks() {
                line x1=(pixel(left)) x2=(pixel(right)) y1=(pixel(up.at(tick))) y2=(pixel(up.at(tick))) {}
                text x=(pixel(left - 6.0)) y=(pixel(up.at(tick) + 3.5)) text-anchor="end" { (up.label(tick)) }
            }
            line .base x1=(pixel(left)) x2=(pixel(right)) y1=(pixel(bottom)) y2=(pixel(bottom)) {}
            @for tick in across.ticks() {
                line .base x1=(pixel(across.at(tick))) x2=(pixel(across.at(tick))) y1=(pixel(bottom)) y2=(pixel(bottom + 4.0)) {}
                text x=(pixel(across.at(tick))) y=(pixel(bottom + 16.0)) text-anchor="middle" {
                    @match over {
                        Over::Time => (minutes(tick)),
                        Over::Updates => (across.label(tick)),
                    }
                }
            }
        }
    }
}

fn minutes(seconds: f64) -> String {
    let minutes = seconds / 60.0;
    if minutes.fract() == 0.0 { format!("{minutes:.0}") } else { format!("{minutes:.1}") }
}

fn band(curve: &Curve, across: &Scale, up: &Scale) -> String {
    let upper = curve.band.iter().map(|&(x, _, high)| (across.at(x), up.at(high)));
    let lower = curve.band.iter().rev().map(|&(x, low, _)| (across.at(x), up.at(low)));
    points(upper.chain(lower))
}

fn line(curve: &Curve, across: &Scale, up: &Scale) -> Markup {
    let place = |&(x, y): &(f64, f64)| (across.at(x), up.at(y));
    match curve.points.as_slice() {
        // A line needs two points to be seen.
        [only] => {
            let (x, y) = place(only);
            html! { circle .dot cx=(pixel(x)) cy=(pixel(y)) r="3" {} polyline .line points=(points([(x, y)])) {} }
        }
        all => html! { polyline .line points=(points(all.iter().map(place))) {} },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(label: &str, points: &[(f64, f64)]) -> Curve {
        let band = points.iter().map(|&(x, y)| (x, y - 1.0, y + 1.0)).collect();
        Curve { label: label.to_owned(), place: 1, points: points.to_vec(), band }
    }

    fn chart(curves: &[Curve], over: Over) -> String {
        let size = (380.0, 220.0);
        LineChart { id: "queue", title: "Queue", note: "veh", over, curves, zero: true, size, legend: true }
            .draw()
            .into_string()
    }

    #[test]
    fn every_curve_has_its_line_and_band_inside_the_frame() {
        let text = chart(
            &[curve("a", &[(0.0, 2.0), (1800.0, 9.0)]), curve("b", &[(0.0, 3.0), (3600.0, 4.0)])],
            Over::Time,
        );
        assert_eq!(text.matches("<polyline").count(), 2);
        assert_eq!(text.matches("<polygon").count(), 2);
        assert!(text.contains("a: from 2.00 to 9.00"), "{text}");
        assert!(text.contains(">60</text>"), "an hour is shown in minutes: {text}");
        for list in text.split("points=\"").skip(1) {
            let list = list.split('"').next().unwrap();
            for place in list.split(' ') {
                let (x, y) = place.split_once(',').unwrap();
                let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
                assert!((LEFT..=370.0).contains(&x) && (TOP..=186.0).contains(&y), "{place}");
            }
        }
    }

    #[test]
    fn a_single_point_is_a_dot_and_nothing_at_all_an_empty_frame() {
        assert!(chart(&[curve("a", &[(1.0, 2.0)])], Over::Updates).contains("<circle"));
        let empty = chart(&[], Over::Updates);
        assert!(empty.contains("<svg") && !empty.contains("NaN"), "{empty}");
    }
}
