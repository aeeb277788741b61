//! What a table does not show: queue and speed over an episode, and where and when a policy's experts and clusters are at work.
//!
//! One SVG file for each scenario. Curves and shares are means over the seeds, by the minute.

use super::plan::{Job, Plan, Subject};
use super::report::ScenarioReport;
use super::store::{Course, Store, plain};
use crate::failure::{Failure, Outcome};
use crate::output_file::OutputFile;
use crate::policy::PolicySpec;
use crate::routing;
use crate::train::curves::COLOURS;
use anyhow::{Context, anyhow};
use cross_sim::controller::RuleBased;
use cross_sim::evaluate::Series;
use cross_support::files::replace_file;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::path::{Path, PathBuf};

const WIDTH: u32 = 1100;
const PANEL_HEIGHT: u32 = 280;
/// Axes that are so much longer than the values leave room for a legend.
const LEGEND_ROOM_ABOVE: f64 = 1.8;
const LEGEND_ROOM_BESIDE: f64 = 1.14;
/// Seconds of a point.
const POINT_SECONDS: usize = 60;

type Drawn = Result<(), Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// One diagram.
#[derive(Debug, Clone, PartialEq)]
enum Panel {
    /// Curves over minutes, by name.
    Lines { title: String, curves: Vec<(String, Vec<f64>)> },
    /// Shares that sum to 1, one list for each place along the horizontal axis, whose name follows.
    Shares { title: String, axis: &'static str, shares: Vec<Vec<f64>> },
}

/// Makes the folder that [`draw`] writes into, if it is not there, and sees that it can: an hour of work comes before.
///
/// # Errors
/// When it cannot, or two scenarios' pictures would have one name.
pub(crate) fn prepare(plan: &Plan, folder: &Path) -> Outcome<()> {
    std::fs::create_dir_all(folder).map_err(|error| {
        Failure::input(format!(
            "cannot create {}: {error}; name another folder with --pictures",
            folder.display()
        ))
    })?;
    let mut names = Vec::new();
    for Subject { scenario, .. } in &plan.subjects {
        let name = file_name(&scenario.name);
        if names.contains(&name) {
            return Err(Failure::input(format!(
                "the pictures of two scenarios would both be called {}; rename {} in its scenario.toml",
                name.display(),
                scenario.name
            )));
        }
        OutputFile::prepare(&folder.join(&name))?;
        names.push(name);
    }
    Ok(())
}

/// Draws every scenario of the report into a folder that was [prepared](prepare).
///
/// # Errors
/// When an episode is gone from the store, or a file cannot be written.
pub(crate) fn draw(plan: &Plan, store: &Store, scenarios: &[ScenarioReport], folder: &Path) -> Outcome<()> {
    for (subject, report) in plan.subjects.iter().zip(scenarios) {
        let panels = panels(plan, store, subject, report)?;
        let svg =
            render(&panels).map_err(|error| anyhow!("cannot draw {}: {error}", subject.scenario.name))?;
        let file = folder.join(file_name(&subject.scenario.name));
        replace_file(&file, svg.as_bytes()).with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(())
}

/// Name of a scenario's picture.
pub(super) fn file_name(scenario: &str) -> PathBuf {
    PathBuf::from(format!("{}.svg", plain(scenario)))
}

/// Two diagrams a row: queue and speed, then for each learned policy what it uses when, and what it uses where.
fn panels(plan: &Plan, store: &Store, subject: &Subject, report: &ScenarioReport) -> Outcome<Vec<Panel>> {
    let mut queues = Vec::new();
    let mut speeds = Vec::new();
    let mut routings = Vec::new();
    let mut shown: Vec<String> = Vec::new();
    for (policy, of_policy) in subject.policies.iter().zip(&report.policies) {
        let drawn =
            policy.rule().is_none_or(|rule| rule == RuleBased::FixedTime) || of_policy.strongest_max_pressure;
        if !drawn {
            continue;
        }
        let courses = courses(plan, store, subject, policy)?;
        queues.push((policy.name().to_owned(), by_minute(&courses, |series| &series.queue_length)));
        speeds.push((policy.name().to_owned(), by_minute(&courses, |series| &series.speed)));
        // Drawn or most probable, the same weights would be shown twice.
        if matches!(policy, PolicySpec::Learned(weights) if !shown.contains(&weights.hash)) {
            if let PolicySpec::Learned(weights) = policy {
                shown.push(weights.hash.clone());
            }
            let name = policy.name();
            type Rows = fn(&Course) -> &Vec<Vec<f64>>;
            let wanted: [(&str, &'static str, Rows); 4] = [
                ("experts over time", "minute", |course| &course.routing.experts.over_time),
                ("clusters over time", "minute", |course| &course.routing.clusters.over_time),
                ("experts by intersection", "intersection", |course| &course.routing.experts.by_agent),
                ("clusters by intersection", "intersection", |course| &course.routing.clusters.by_agent),
            ];
            routings.extend(wanted.map(|(what, axis, rows)| Panel::Shares {
                title: format!("{name}: {what}"),
                axis,
                shares: routing::mean(courses.iter().map(rows)),
            }));
        }
    }
    let lines = |title: &str, curves| Panel::Lines { title: title.to_owned(), curves };
    let mut panels = vec![
        lines("Stopped vehicles per incoming lane", queues),
        lines("Speed of the vehicles in the network, m/s", speeds),
    ];
    panels.extend(routings);
    Ok(panels)
}

/// How the episodes of a policy went, one for each seed.
fn courses(plan: &Plan, store: &Store, subject: &Subject, policy: &PolicySpec) -> Outcome<Vec<Course>> {
    let seeds = subject.seeds(policy).into_iter();
    let courses = seeds.map(|seed| {
        store.course(&plan.made(&Job { subject, policy, seed })).ok_or_else(|| {
            Failure::failed(format!(
                "the result of {} on {}, seed {seed}, is gone from {}; run the command again",
                policy.name(),
                subject.scenario.name,
                store.folder().display()
            ))
        })
    });
    courses.collect()
}

/// Means of a curve by the minute, over the episodes.
fn by_minute(courses: &[Course], curve: fn(&Series) -> &Vec<f64>) -> Vec<f64> {
    let mut sums: Vec<(f64, f64)> = Vec::new();
    for Course { series, .. } in courses {
        for (at, value) in curve(series).iter().enumerate() {
            let minute = at * series.interval_seconds as usize / POINT_SECONDS;
            if sums.len() <= minute {
                sums.resize(minute + 1, (0.0, 0.0));
            }
            sums[minute].0 += value;
            sums[minute].1 += 1.0;
        }
    }
    sums.iter().map(|(sum, count)| sum / f64::max(*count, 1.0)).collect()
}

fn render(panels: &[Panel]) -> Result<String, Box<dyn std::error::Error>> {
    let mut svg = String::new();
    {
        let rows = panels.len().div_ceil(2).max(1);
        let height = PANEL_HEIGHT * u32::try_from(rows)?;
        let root = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        root.fill(&WHITE)?;
        for (area, panel) in root.split_evenly((rows, 2)).iter().zip(panels) {
            match panel {
                Panel::Lines { title, curves } => lines(area, title, curves)?,
                Panel::Shares { title, axis, shares } => stacked(area, title, axis, shares)?,
            }
        }
        root.present()?;
    }
    Ok(svg)
}

fn lines(area: &Area<'_>, title: &str, curves: &[(String, Vec<f64>)]) -> Drawn {
    let longest = curves.iter().map(|(_, curve)| curve.len()).max().unwrap_or(0).max(1);
    let highest = curves.iter().flat_map(|(_, curve)| curve).copied().fold(0.0, f64::max).max(1e-3);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(48)
        .build_cartesian_2d(0.0..longest as f64, 0.0..highest * LEGEND_ROOM_ABOVE)?;
    chart
        .configure_mesh()
        .x_desc("minute")
        .x_label_formatter(&|minute| format!("{minute:.0}"))
        .label_style(("sans-serif", 12))
        .light_line_style(WHITE)
        .draw()?;
    for ((name, curve), colour) in curves.iter().zip(COLOURS.iter().cycle()) {
        // A minute's mean stands in its middle.
        let points = curve.iter().enumerate().map(|(minute, value)| (minute as f64 + 0.5, *value));
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    legend(&mut chart, SeriesLabelPosition::UpperLeft)
}

/// Bars of height 1, each place's shares on top of each other.
fn stacked(area: &Area<'_>, title: &str, axis: &str, shares: &[Vec<f64>]) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(48)
        .build_cartesian_2d(0.0..shares.len().max(1) as f64 * LEGEND_ROOM_BESIDE, 0.0..1.0)?;
    chart
        .configure_mesh()
        .x_desc(axis)
        .x_label_formatter(&|place| format!("{place:.0}"))
        .label_style(("sans-serif", 12))
        .disable_mesh()
        .draw()?;
    let parts = shares.iter().map(Vec::len).max().unwrap_or(0);
    for (part, colour) in (0..parts).zip(COLOURS.iter().cycle()) {
        let bars = shares.iter().enumerate().filter_map(|(place, of_place)| {
            let below: f64 = of_place.iter().take(part).sum();
            let height = of_place.get(part).copied().filter(|height| *height > 0.0)?;
            let corners = [(place as f64, below), (place as f64 + 1.0, below + height)];
            Some(Rectangle::new(corners, colour.filled()))
        });
        chart
            .draw_series(bars)?
            .label((part + 1).to_string())
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 10, y + 5)], colour.filled()));
    }
    if parts == 0 {
        return Ok(());
    }
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}

fn legend<'a, 'b: 'a>(chart: &mut Chart<'a, 'b>, position: SeriesLabelPosition) -> Drawn {
    chart
        .configure_series_labels()
        .position(position)
        .label_font(("sans-serif", 12))
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::store::tests::course;
    use super::*;

    #[test]
    fn curves_are_means_by_the_minute_over_the_seeds() {
        let mut long = course();
        long.series.queue_length = vec![3.0; 7];
        // Six intervals of ten seconds are a minute; the seventh begins the next.
        let queue = by_minute(&[course(), long], |series| &series.queue_length);
        assert_eq!(queue, [(3.0 + 18.0) / 9.0, 3.0]);
    }

    #[test]
    fn a_picture_holds_every_panel_with_its_names() {
        let Course { series, routing } = course();
        let svg = render(&[
            Panel::Lines {
                title: "Queue".to_owned(),
                curves: vec![("fixed-time <b>".to_owned(), series.queue_length)],
            },
            Panel::Shares {
                title: "experts over time".to_owned(),
                axis: "minute",
                shares: routing.experts.over_time,
            },
            Panel::Shares { title: "nobody".to_owned(), axis: "intersection", shares: Vec::new() },
        ])
        .unwrap();
        for part in
            ["<svg", "Queue", "fixed-time &lt;b&gt;", "experts over time", "minute", "nobody", "<polyline"]
        {
            assert!(svg.contains(part), "{part} is missing");
        }
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn a_scenario_s_picture_stays_in_its_folder() {
        assert_eq!(file_name("../a b"), PathBuf::from("___a_b.svg"));
    }
}
