//! `cross scenario generate`.

use super::info::Facts;
use super::made::{Target, failure};
use crate::failure::Outcome;
use crate::output;
use crate::sumo::SumoOption;
use clap::{Args, Subcommand, ValueEnum};
use cross_sim::generate::{Demand, GridOptions, RoadOptions, generate_grid};

/// Makes a network and its traffic
#[derive(Debug, Args)]
pub(crate) struct Generate {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    Grid(Box<Grid>),
}

/// A grid of streets (east-west) and avenues (north-south), a traffic light at every crossing
///
/// The same options make the same traffic everywhere, and the same net with the same version of SUMO.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross scenario generate grid --columns 3 --rows 3 --name small
  cross scenario generate grid --street-lanes 3 --avenue-lanes 3 --demand uniform --vehicles-per-hour 1500 --name wide
  cross scenario generate grid --demand two-wave --first-peak 1100 --second-peak 925 --teleport 300 --name mine
  cross scenario generate grid --columns 4 --rows 4 --street-lanes 1 --closed 0.25 --jitter 40 --name town

One lane serves all turns; of two, the inner one is for left turns; from three on the outer one is for right turns as well.
With --closed there are junctions of three roads, with phases of their own, and with --jitter streets that are not straight.")]
struct Grid {
    #[command(flatten)]
    target: Target,
    /// Avenues, from west to east
    #[arg(long, value_name = "N", default_value_t = 5)]
    columns: u32,
    /// Streets, from south to north
    #[arg(long, value_name = "N", default_value_t = 5)]
    rows: u32,
    /// Metres between crossings
    #[arg(long, value_name = "M", default_value_t = 200.0)]
    spacing: f64,
    /// Metres from the outer crossings to the dead ends [default: as between crossings]
    #[arg(long, value_name = "M")]
    fringe: Option<f64>,
    /// Share of the roads that are left out, as far as every crossing keeps three arms: 0 to 0.5
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    closed: f64,
    /// Metres by which crossings lie beside where a regular grid has them, at most
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    jitter: f64,
    /// Lanes of a street in each direction
    #[arg(long, value_name = "N", default_value_t = 2)]
    street_lanes: u32,
    /// Lanes of an avenue in each direction
    #[arg(long, value_name = "N", default_value_t = 1)]
    avenue_lanes: u32,
    /// Speed limit of streets, m/s
    #[arg(long, value_name = "M/S", default_value_t = 20.0)]
    street_speed: f64,
    /// Speed limit of avenues, m/s
    #[arg(long, value_name = "M/S", default_value_t = 11.0)]
    avenue_speed: f64,
    /// Vehicles may turn right on red after a stop
    #[arg(long)]
    right_on_red: bool,
    /// Roads of one lane have a phase for left turns alone, too
    #[arg(long)]
    protected_left: bool,
    /// Seconds of every green of the net's own program
    #[arg(long, value_name = "S", default_value_t = 30)]
    green: u32,
    /// Seconds of every yellow of the net's own program
    #[arg(long, value_name = "S", default_value_t = 3)]
    yellow: u32,
    /// Who drives where and when
    #[arg(long, value_enum, default_value_t = Profile::Peak)]
    demand: Profile,
    /// Of uniform and peak: departures an hour, on average
    #[arg(long, value_name = "N", default_value_t = 2000)]
    vehicles_per_hour: u32,
    /// Of two-wave: vehicles an hour of each street at the peak of the first wave
    #[arg(long, value_name = "N", default_value_t = 1100)]
    first_peak: u32,
    /// Of two-wave: vehicles an hour of each street at the peak of the second wave
    #[arg(long, value_name = "N", default_value_t = 925)]
    second_peak: u32,
    /// Of two-wave: length of each of its ten slots, seconds
    #[arg(long, value_name = "S", default_value_t = 300)]
    slot: u32,
    /// Of two-wave: vehicles that stand on every inner lane at the beginning
    #[arg(long, value_name = "N", default_value_t = 0)]
    initial_per_lane: u32,
    /// Seconds of an episode, and of uniform and peak demand
    #[arg(long, value_name = "S", default_value_t = 3600, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    duration: u32,
    /// Seconds of standing after which SUMO moves a vehicle on; -1 never
    #[arg(long, value_name = "S", default_value_t = -1, allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-1..))]
    teleport: i32,
    /// Seed of everything random: the demand, and which roads are left out and crossings moved
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    sumo: SumoOption,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Profile {
    /// Single trips between dead ends at random; the rate rises to the middle and falls again
    Peak,
    /// Single trips between dead ends at random, at an even rate
    Uniform,
    /// Flows across the grid, first from north and west, then from south and east
    TwoWave,
}

impl Generate {
    pub(super) fn run(&self) -> Outcome<()> {
        match &self.kind {
            Kind::Grid(grid) => grid.run(),
        }
    }
}

impl Grid {
    fn run(&self) -> Outcome<()> {
        let options = self.options();
        // Before SUMO is looked for: a wrong option is wrong with any SUMO.
        options.validate().map_err(failure)?;
        let description = format!("{}x{} grid, {}", self.columns, self.rows, self.traffic());
        let text = serde_json::to_string(&options)?;
        let source = format!("cross scenario generate grid with the options {text}");
        let new = self.target.scenario(description, source, self.duration, f64::from(self.teleport))?;
        let home = self.sumo.locate()?;
        let folder = generate_grid(&home, &options, &new).map_err(failure)?;
        let facts = Facts::gather(&folder.display().to_string())?;
        if self.json { output::json(&facts) } else { output::text(&facts.render()) }
    }

    fn options(&self) -> GridOptions {
        GridOptions {
            columns: self.columns,
            rows: self.rows,
            spacing: self.spacing,
            fringe: self.fringe.unwrap_or(self.spacing),
            closed: self.closed,
            jitter: self.jitter,
            streets: RoadOptions { lanes: self.street_lanes, speed: self.street_speed },
            avenues: RoadOptions { lanes: self.avenue_lanes, speed: self.avenue_speed },
            right_on_red: self.right_on_red,
            protected_left: self.protected_left,
            green_seconds: self.green,
            yellow_seconds: self.yellow,
            demand: self.demand(),
            seed: self.seed,
        }
    }

    fn demand(&self) -> Demand {
        let (vehicles_per_hour, duration) = (self.vehicles_per_hour, self.duration);
        match self.demand {
            Profile::Peak => Demand::Peak { vehicles_per_hour, duration },
            Profile::Uniform => Demand::Uniform { vehicles_per_hour, duration },
            Profile::TwoWave => Demand::TwoWave {
                first_peak: self.first_peak,
                second_peak: self.second_peak,
                slot_seconds: self.slot,
                initial_per_lane: self.initial_per_lane,
            },
        }
    }

    fn traffic(&self) -> String {
        match self.demand {
            Profile::Peak => format!("{} vehicles an hour with a peak in the middle", self.vehicles_per_hour),
            Profile::Uniform => format!("{} vehicles an hour", self.vehicles_per_hour),
            Profile::TwoWave => format!(
                "two waves with peaks of {} and {} vehicles an hour and street",
                self.first_peak, self.second_peak
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        grid: Grid,
    }

    fn options(arguments: &[&str]) -> GridOptions {
        let arguments = ["grid", "--name", "mine"].iter().chain(arguments);
        Cli::try_parse_from(arguments).unwrap().grid.options()
    }

    #[test]
    fn what_is_not_said_is_the_library_s_default() {
        assert_eq!(options(&[]), GridOptions::default());
    }

    #[test]
    fn dead_ends_are_as_far_away_as_crossings_unless_said_otherwise() {
        let wide = options(&["--spacing", "300"]);
        assert_eq!((wide.spacing, wide.fringe), (300.0, 300.0));
        assert_eq!(options(&["--spacing", "300", "--fringe", "75"]).fringe, 75.0);
    }

    #[test]
    fn only_the_profile_that_was_chosen_counts() {
        let two_wave =
            options(&["--demand", "two-wave", "--second-peak", "7", "--vehicles-per-hour", "9"]).demand;
        let expected =
            Demand::TwoWave { first_peak: 1100, second_peak: 7, slot_seconds: 300, initial_per_lane: 0 };
        assert_eq!(two_wave, expected);
        let uniform =
            options(&["--demand", "uniform", "--vehicles-per-hour", "9", "--duration", "60"]).demand;
        assert_eq!(uniform, Demand::Uniform { vehicles_per_hour: 9, duration: 60 });
    }
}
