//! The picture of a run: return and queue of each scenario and the losses, over the updates.

use anyhow::{Context, anyhow};
use plotters::prelude::*;
use serde_json::Value;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

const WIDTH: u32 = 900;
const PANEL_HEIGHT: u32 = 300;
/// Colours that stay apart for colour-blind readers (Okabe and Ito), most used first.
pub(crate) const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

/// Named curves of one panel: points (update, value).
type Curves = BTreeMap<String, Vec<(f64, f64)>>;

/// Title, place of the legend, curves.
type Panel = (&'static str, SeriesLabelPosition, Curves);

/// Draws `metrics` (a run's `metrics.jsonl`) into the SVG file `picture`.
///
/// # Errors
/// When the metrics cannot be read, hold no update, or the picture cannot be written.
pub(crate) fn draw(metrics: &Path, picture: &Path) -> anyhow::Result<()> {
    let text =
        std::fs::read_to_string(metrics).with_context(|| format!("cannot read {}", metrics.display()))?;
    let [returns, queues, losses] = read(&text);
    // Legends stand where a run that learns draws nothing: returns rise, queues and losses fall.
    let panels = [
        ("Return of an episode, mean over the agents", SeriesLabelPosition::LowerRight, returns),
        ("Stopped vehicles per incoming lane", SeriesLabelPosition::UpperRight, queues),
        ("Losses", SeriesLabelPosition::UpperRight, losses),
    ];
    let panels: Vec<Panel> = panels.into_iter().filter(|(_, _, curves)| !curves.is_empty()).collect();
    if panels.is_empty() {
        return Err(anyhow!("{} holds no update to draw", metrics.display()));
    }
    let svg = render(&panels).map_err(|error| anyhow!("cannot draw the learning curves: {error}"))?;
    std::fs::write(picture, svg).with_context(|| format!("cannot write {}", picture.display()))
}

/// Return per scenario, queue per scenario, loss per term. Lines that do not parse (a torn last one) are left out.
fn read(text: &str) -> [Curves; 3] {
    let mut panels = [Curves::new(), Curves::new(), Curves::new()];
    for line in text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok()) {
        let Some(update) = line["update"].as_f64() else { continue };
        let mut add = |panel: usize, name: &str, value: &Value| {
            if let Some(value) = value.as_f64().filter(|value| value.is_finite()) {
                panels[panel].entry(name.to_owned()).or_default().push((update, value));
            }
        };
        for (name, scenario) in line["scenarios"].as_object().into_iter().flatten() {
            add(0, name, &scenario["episode_return"]);
            add(1, name, &scenario["queue_length"]);
        }
        for (name, loss) in line["losses"].as_object().into_iter().flatten() {
            add(2, name, loss);
        }
    }
    let [_, _, losses] = &mut panels;
    *losses = totals(std::mem::take(losses));
    panels
}

/// The total of each network where there are totals: a dozen terms of different size would hide each other.
fn totals(losses: Curves) -> Curves {
    let total =
        |(name, line): (&String, &Vec<_>)| Some((name.strip_suffix("_total")?.to_owned(), line.clone()));
    let totals: Curves = losses.iter().filter_map(total).collect();
    if totals.is_empty() { losses } else { totals }
}

fn render(panels: &[Panel]) -> Result<String, Box<dyn std::error::Error>> {
    let mut svg = String::new();
    {
        // There are at most three panels.
        let height = PANEL_HEIGHT * u32::try_from(panels.len())?;
        let root = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        root.fill(&WHITE)?;
        for (area, (title, legend, curves)) in root.split_evenly((panels.len(), 1)).iter().zip(panels) {
            panel(area, title, legend.clone(), curves)?;
        }
        root.present()?;
    }
    Ok(svg)
}

fn panel(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    title: &str,
    legend: SeriesLabelPosition,
    curves: &Curves,
) -> Result<(), Box<dyn std::error::Error>> {
    let points = || curves.values().flatten();
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 18))
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(64)
        .build_cartesian_2d(span(points().map(|p| p.0)), span(points().map(|p| p.1)))?;
    chart
        .configure_mesh()
        .x_desc("update")
        .y_labels(6)
        // There is nothing between two updates to label.
        .x_label_formatter(&|x| if (x - x.round()).abs() < 1e-6 { format!("{x:.0}") } else { String::new() })
        .label_style(("sans-serif", 12))
        .light_line_style(WHITE)
        .draw()?;
    for ((name, line), colour) in curves.iter().zip(COLOURS.iter().cycle()) {
        chart
            .draw_series(LineSeries::new(line.iter().copied(), colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
        // A line needs two points to be seen.
        if line.len() == 1 {
            chart.draw_series(line.iter().map(|&point| Circle::new(point, 3, colour.filled())))?;
        }
    }
    chart
        .configure_series_labels()
        .position(legend)
        .label_font(("sans-serif", 12))
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .draw()?;
    Ok(())
}

/// From the least to the greatest value with a little room; never empty.
fn span(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    let room = ((high - low) * 0.05).max(high.abs().max(1.0) * 1e-3);
    low - room..high + room
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: &str = r#"{"update":1,"scenarios":{"grid4x4":{"episode_return":-80.5,"queue_length":1.5}},"losses":{"actor_total":0.5,"actor_entropy":1}}
{"update":2,"scenarios":{"grid4x4":{"episode_return":-40.0,"queue_length":null}},"losses":{"actor_total":0.25}}
{"update":3,"scen"#;

    #[test]
    fn a_torn_last_line_and_missing_values_are_left_out() {
        let [returns, queues, losses] = read(LINES);
        assert_eq!(returns["grid4x4"], [(1.0, -80.5), (2.0, -40.0)]);
        assert_eq!(queues["grid4x4"], [(1.0, 1.5)]);
        assert_eq!(losses["actor"], [(1.0, 0.5), (2.0, 0.25)]);
        assert_eq!(losses.len(), 1);
    }

    #[test]
    fn the_picture_holds_titles_legends_and_lines() {
        let directory = tempfile::tempdir().unwrap();
        let (metrics, picture) = (directory.path().join("m.jsonl"), directory.path().join("c.svg"));
        std::fs::write(&metrics, LINES).unwrap();
        draw(&metrics, &picture).unwrap();
        let svg = std::fs::read_to_string(picture).unwrap();
        for part in ["<svg", "Return of an episode", "grid4x4", "Losses", "actor", "update", "<polyline"] {
            assert!(svg.contains(part), "{part} is missing");
        }
    }

    #[test]
    fn nothing_to_draw_is_an_error() {
        let directory = tempfile::tempdir().unwrap();
        let metrics = directory.path().join("m.jsonl");
        std::fs::write(&metrics, "").unwrap();
        assert!(draw(&metrics, &directory.path().join("c.svg")).is_err());
    }
}
