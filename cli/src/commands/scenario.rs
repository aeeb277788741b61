//! `cross scenario`: what can be trained and evaluated on.

use crate::failure::{OrBadInput, Outcome};
use crate::output;
use clap::{Args, Subcommand};
use cross_config::Config;
use cross_sim::layout::{Intersection, NetworkLayout};
use cross_sim::net::Net;
use cross_sim::scenario::{self, Scenario as Definition};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// Lists scenarios and tells what is in one
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross scenario list
  cross scenario info grid4x4
  cross scenario info my/own/directory --json

A scenario is a directory with a scenario.toml; it is found by name under scenarios/ beside or above this program or the
current folder, under the folders of CROSS_SCENARIOS, or by its path.")]
pub(crate) struct Scenario {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Every scenario that has a name here
    List {
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Intersections, movements, phases, lanes, vehicles, duration and hashes of one
    Info {
        /// Name, or path of a directory with a scenario.toml
        name: String,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
}

#[derive(Debug, Serialize)]
struct Listed {
    name: String,
    directory: PathBuf,
    /// Why it cannot be used as it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    #[serde(skip_serializing_if = "String::is_empty")]
    description: String,
}

#[derive(Debug, Serialize)]
struct Info {
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
    vehicles: u64,
    begin_seconds: u32,
    duration_seconds: u32,
    hashes: Hashes,
}

#[derive(Debug, Serialize)]
struct Span {
    min: usize,
    max: usize,
}

#[derive(Debug, Serialize)]
struct Hashes {
    net: String,
    demand: String,
    layout: String,
}

impl Scenario {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        match &self.command {
            Command::List { json } => list(*json)?,
            Command::Info { name, json } => info(name, *json)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

fn list(json: bool) -> Outcome<()> {
    let listed: Vec<_> = scenario::list()
        .into_iter()
        .map(|entry| match Definition::from_directory(&entry.directory) {
            Ok(loaded) => Listed {
                name: entry.name,
                directory: entry.directory,
                problem: None,
                description: loaded.description,
            },
            Err(error) => Listed {
                name: entry.name,
                directory: entry.directory,
                problem: Some(error.to_string()),
                description: String::new(),
            },
        })
        .collect();
    if json {
        return output::json(&serde_json::json!({ "scenarios": listed }));
    }
    let width = listed.iter().map(|entry| entry.name.len()).max().unwrap_or(0);
    let mut text = String::new();
    for entry in &listed {
        let what =
            entry.problem.as_ref().map_or_else(|| entry.description.clone(), |p| format!("not usable: {p}"));
        let _ = writeln!(text, "{:width$}  {what}", entry.name);
    }
    if listed.is_empty() {
        text.push_str("no scenario was found; run this from the project, or set CROSS_SCENARIOS");
    }
    output::text(&text)
}

fn info(name: &str, json: bool) -> Outcome<()> {
    let info = gather(name)?;
    if json { output::json(&info) } else { output::text(&render(&info)) }
}

fn gather(name: &str) -> Outcome<Info> {
    let definition = Definition::load(name).or_bad_input()?;
    let net = Net::read(&definition.net).or_bad_input()?;
    let layout = NetworkLayout::from_net(&net, &Config::default().env).or_bad_input()?;
    Ok(Info {
        intersections: layout.agents(),
        movements: span(&layout, |intersection| intersection.movements.len()),
        phases: span(&layout, |intersection| intersection.phases.len()),
        lanes: net.edges.iter().map(|edge| edge.lanes.len()).sum(),
        signalised_lanes: layout.intersections.iter().map(|intersection| intersection.incoming.len()).sum(),
        vehicles: definition.vehicles().or_bad_input()?,
        begin_seconds: definition.begin,
        duration_seconds: definition.end - definition.begin,
        hashes: Hashes { net: definition.net_hash, demand: definition.demand_hash, layout: layout.hash() },
        name: definition.name,
        description: definition.description,
        source: definition.source,
        directory: definition.directory,
    })
}

fn span(layout: &NetworkLayout, count: impl Fn(&Intersection) -> usize) -> Span {
    let counts = || layout.intersections.iter().map(&count);
    Span { min: counts().min().unwrap_or(0), max: counts().max().unwrap_or(0) }
}

fn render(info: &Info) -> String {
    let span = |span: &Span| {
        if span.min == span.max { format!("{}", span.min) } else { format!("{} to {}", span.min, span.max) }
    };
    let mut text = format!("{}: {}\n", info.name, info.description);
    for (label, value) in [
        ("source", info.source.clone()),
        ("directory", info.directory.display().to_string()),
        ("intersections", info.intersections.to_string()),
        ("movements", format!("{} per intersection", span(&info.movements))),
        ("phases", format!("{} per intersection", span(&info.phases))),
        ("lanes", format!("{}, of which {} end at a signal", info.lanes, info.signalised_lanes)),
        ("vehicles", info.vehicles.to_string()),
        ("duration", format!("{} s", info.duration_seconds)),
        ("net hash", info.hashes.net.clone()),
        ("demand hash", info.hashes.demand.clone()),
        ("layout hash", info.hashes.layout.clone()),
    ] {
        let _ = writeln!(text, "  {label:14} {value}");
    }
    text
}
