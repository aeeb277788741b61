//! `cross scenario info`.

use crate::failure::{OrBadInput, Outcome};
use crate::output;
use clap::Args;
use cross_config::Config;
use cross_sim::layout::{Intersection, NetworkLayout};
use cross_sim::net::Net;
use cross_sim::scenario::Scenario;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Volume, arrivals, intersections, movements, phases, lanes, duration and hashes of one
#[derive(Debug, Args)]
pub(crate) struct Info {
    /// Name, or path of a directory with a scenario.toml
    name: String,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// What there is to know about a scenario without simulating it.
#[derive(Debug, Serialize)]
pub(super) struct Facts {
    name: String,
    description: String,
    source: String,
    directory: PathBuf,
    intersections: usize,
    /// Lane-to-lane links of an intersection's signal.
    movements: Span,
    /// Green phases of an intersection.
    phases: Span,
    /// Lanes of the whole net.
    lanes: usize,
    /// Lanes that end at a signal.
    signalised_lanes: usize,
    /// Vehicles that the demand defines; of flows, what their rates make.
    vehicles: u64,
    arrivals: Arrivals,
    begin_seconds: u32,
    duration_seconds: u32,
    hashes: Hashes,
}

#[derive(Debug, Serialize)]
struct Span {
    min: usize,
    max: usize,
}

/// Departures within the duration, and in each minute of it.
#[derive(Debug, Serialize)]
struct Arrivals {
    volume: f64,
    per_minute: PerMinute,
    /// Vehicles that the files define outside the duration.
    outside: f64,
}

#[derive(Debug, Serialize)]
struct PerMinute {
    mean: f64,
    std: f64,
    max: f64,
    min: f64,
    /// Minutes without departures; they count for the mean alone.
    empty_minutes: usize,
}

#[derive(Debug, Serialize)]
struct Hashes {
    net: String,
    demand: String,
    layout: String,
}

impl Info {
    pub(super) fn run(&self) -> Outcome<()> {
        let facts = Facts::gather(&self.name)?;
        if self.json { output::json(&facts) } else { output::text(&facts.render()) }
    }
}

impl Facts {
    /// Reads net and demand of a scenario.
    pub(super) fn gather(name: &str) -> Outcome<Self> {
        let scenario = Scenario::load(name).or_bad_input()?;
        let net = Net::read(&scenario.net).or_bad_input()?;
        let layout = NetworkLayout::from_net(&net, &Config::default().env).or_bad_input()?;
        let arrivals = scenario.arrivals().or_bad_input()?;
        Ok(Self {
            intersections: layout.agents(),
            movements: span(&layout, |intersection| intersection.movements.len()),
            phases: span(&layout, |intersection| intersection.phases.len()),
            lanes: net.edges.iter().map(|edge| edge.lanes.len()).sum(),
            signalised_lanes: layout
                .intersections
                .iter()
                .map(|intersection| intersection.incoming.len())
                .sum(),
            vehicles: scenario.vehicles().or_bad_input()?,
            arrivals: Arrivals {
                volume: arrivals.volume(),
                per_minute: PerMinute {
                    mean: arrivals.mean(),
                    std: arrivals.std(),
                    max: arrivals.max(),
                    min: arrivals.min(),
                    empty_minutes: arrivals.empty_minutes(),
                },
                outside: arrivals.outside,
            },
            begin_seconds: scenario.begin,
            duration_seconds: scenario.end - scenario.begin,
            hashes: Hashes { net: scenario.net_hash, demand: scenario.demand_hash, layout: layout.hash() },
            name: scenario.name,
            description: scenario.description,
            source: scenario.source,
            directory: scenario.directory,
        })
    }

    /// The facts as lines.
    pub(super) fn render(&self) -> String {
        let span = |span: &Span| {
            if span.min == span.max {
                format!("{}", span.min)
            } else {
                format!("{} to {}", span.min, span.max)
            }
        };
        let minutes = &self.arrivals.per_minute;
        let mut text = format!("{}: {}\n", self.name, self.description);
        for (label, value) in [
            ("source", self.source.clone()),
            ("directory", self.directory.display().to_string()),
            ("intersections", self.intersections.to_string()),
            ("movements", format!("{} per intersection", span(&self.movements))),
            ("phases", format!("{} per intersection", span(&self.phases))),
            ("lanes", format!("{}, of which {} end at a signal", self.lanes, self.signalised_lanes)),
            ("duration", format!("{} s", self.duration_seconds)),
            ("volume", self.volume()),
            ("per minute", minutes.render()),
            ("net hash", self.hashes.net.clone()),
            ("demand hash", self.hashes.demand.clone()),
            ("layout hash", self.hashes.layout.clone()),
        ] {
            let _ = writeln!(text, "  {label:14} {value}");
        }
        text
    }

    fn volume(&self) -> String {
        let mut text = format!("{} vehicles", self.vehicles);
        if self.arrivals.outside >= 1.0 {
            let _ = write!(text, " ({:.0} more lie outside the duration)", self.arrivals.outside);
        }
        text
    }
}

impl PerMinute {
    fn render(&self) -> String {
        let Self { mean, std, max, min, empty_minutes } = self;
        let mut text = format!("mean {mean:.2}, std {std:.2}, max {max:.2}, min {min:.2}");
        if *empty_minutes > 0 {
            let _ = write!(text, " ({empty_minutes} minutes without departures count for the mean alone)");
        }
        text
    }
}

fn span(layout: &NetworkLayout, count: impl Fn(&Intersection) -> usize) -> Span {
    let counts = || layout.intersections.iter().map(&count);
    Span { min: counts().min().unwrap_or(0), max: counts().max().unwrap_or(0) }
}
