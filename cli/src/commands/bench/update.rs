//! `cross bench update`.

use crate::failure::Outcome;
use clap::{Args, ValueEnum};
use cross_bench::{Progress, Report, update};
use cross_config::Gfe;
use std::path::PathBuf;

/// A PPO update: packed, as it runs, beside the same padded, as the paper writes it
///
/// One episode (360 decisions) of each of the paper's three synthetic networks (57 intersections), 6 epochs, actor and
/// critic, one thread. Both sides learn the same numbers from the same weights; the plain side pads every intersection to 8
/// phases and 36 movements, computes constant parts at every step, runs all experts and predicts for all phases.
/// Then: what a decision costs in rounds of 1,000, 10,000 and 100,000 decisions, and how much memory they take.
/// No SUMO runs; counts are made up on the networks' real layouts.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross bench update                          both forms of the features, as used for the documentation
  cross bench update --form paper --repeats 3
  cross bench update --epochs 1               quick, the ratio is about the same
  cross bench update --json > update.json")]
pub(crate) struct Update {
    /// Feature extraction: as in the paper, ours, or both after one another
    #[arg(long, value_enum, default_value_t = Form::Both)]
    form: Form,
    /// Repetitions of each side, by turns; medians count
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Passes over the data in an update
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=1000))]
    epochs: u32,
    /// Measure nothing, but write the batch to this folder, for tests/reference/update_time.py
    #[arg(long, value_name = "DIR", conflicts_with_all = ["repeats", "epochs", "json"])]
    export: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Form {
    Paper,
    Movement,
    Both,
}

impl Update {
    /// A report, unless a batch was to be exported.
    pub(super) fn run(&self, progress: Progress<'_>) -> Outcome<Option<Report>> {
        let forms = match self.form {
            Form::Paper => vec![Gfe::Paper],
            Form::Movement => vec![Gfe::Movement],
            Form::Both => vec![Gfe::Paper, Gfe::Movement],
        };
        if let Some(directory) = &self.export {
            for form in forms {
                update::export(form, directory, progress)?;
            }
            return Ok(None);
        }
        Ok(Some(update::run(
            &update::Options { repeats: self.repeats, epochs: self.epochs, forms },
            progress,
        )?))
    }
}
