//! `cross scenario import`.

use super::info::Facts;
use super::made::{Target, failure};
use crate::failure::{Failure, Outcome};
use crate::output;
use crate::sumo::SumoOption;
use clap::{Args, Subcommand};
use cross_sim::import::cityflow::{self, ImportError, Item};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Makes a scenario from another simulator's files
#[derive(Debug, Args)]
pub(crate) struct Import {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    Cityflow(CityFlow),
}

/// From CityFlow's roadnet and flow files
///
/// Says what was kept, changed or lost. Roads, lanes, turns, signals and routes stay as they are; vehicles become SUMO's default cars.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  cross scenario import cityflow --roadnet roadnet_3_4.json --flow anon_3_4_jinan_real.json --name jinan1

The names jinan1 to jinan3, hangzhou1 and hangzhou2 belong to data sets that `cross scenario list` tells the files of.")]
struct CityFlow {
    /// The road network
    #[arg(long, value_name = "FILE")]
    roadnet: PathBuf,
    /// Who drives where and when
    #[arg(long, value_name = "FILE")]
    flow: PathBuf,
    #[command(flatten)]
    target: Target,
    /// Seconds that are simulated; later vehicles are left out
    #[arg(long, value_name = "S", default_value_t = 3600, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    end: u32,
    #[command(flatten)]
    sumo: SumoOption,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Result {
    scenario: Facts,
    report: Vec<Item>,
}

impl Import {
    pub(super) fn run(&self) -> Outcome<()> {
        match &self.kind {
            Kind::Cityflow(command) => command.run(),
        }
    }
}

impl CityFlow {
    fn run(&self) -> Outcome<()> {
        let file = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (roadnet, flow) = (file(&self.roadnet), file(&self.flow));
        let description = format!("imported from CityFlow's {roadnet} and {flow}");
        let new = self.target.scenario(description, "CityFlow files".to_owned(), self.end, -1.0)?;
        let home = self.sumo.locate()?;
        let imported =
            cityflow::import(&home, &self.roadnet, &self.flow, &new).map_err(|error| match error {
                ImportError::Generate(error) => failure(error),
                other => Failure::bad_input(other),
            })?;
        let facts = Facts::gather(&imported.folder.display().to_string())?;
        if self.json {
            return output::json(&Result { scenario: facts, report: imported.report });
        }
        output::text(&format!("{}\n{}", facts.render(), render(&imported.report)))
    }
}

fn render(report: &[Item]) -> String {
    let mut text = format!("{:14} {:>8} {:>8} {:>8} {:>8}\n", "", "read", "kept", "changed", "lost");
    for item in report {
        let Item { what, read, kept, changed, lost, notes } = item;
        let _ = writeln!(text, "{what:14} {read:8} {kept:8} {changed:8} {lost:8}  {}", notes.join("; "));
    }
    text
}
