//! The command `cross`: train, evaluate, inspect.
//!
//! Commands parse, check and print; what they do lives in the crates they call.

mod baselines;
mod commands;
mod evaluate;
mod failure;
mod learned;
mod output;
mod output_file;
mod paper;
mod policy;
mod report;
mod routing;
mod saved;
mod sumo;
mod train;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::process::ExitCode;

/// Trains and evaluates CROSS, a traffic-signal controller that learns on SUMO.
#[derive(Debug, Parser)]
#[command(name = "cross", arg_required_else_help = true, max_term_width = 110, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  cross doctor                                    is this machine ready?
  cross train --scenario grid4x4 --updates 100    train, compare, draw the curves
  cross eval --scenario grid4x4 --policy max-pressure --seeds 3
  cross eval --scenario arterial4x4 --policy runs/20260131-235959
  cross report runs/20260131-235959               one HTML page: tables beside the paper's, plots
  cross checkpoint list

Exit codes: 0 success, 2 wrong usage or bad input, 1 anything else.
Progress and errors go to standard error, results to standard output.";

#[derive(Debug, Subcommand)]
enum Command {
    Train(commands::train::Train),
    Eval(commands::eval::Eval),
    Baselines(commands::baselines::Baselines),
    Results(commands::results::Results),
    Report(commands::report::Report),
    Bench(commands::bench::Bench),
    Scenario(commands::scenario::Scenario),
    Checkpoint(commands::checkpoint::Checkpoint),
    Doctor(commands::doctor::Doctor),
}

fn main() -> ExitCode {
    // Before any tensor exists, as the library asks. Parallelism is one process or thread per episode.
    cross_model::set_single_threaded();
    // clap wants a version that lives as long as the program; it is made once.
    let version: &'static str = Box::leak(version().into_boxed_str());
    let matches = Cli::command().version(version).get_matches();
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    let outcome = match cli.command {
        Command::Train(command) => command.run(),
        Command::Eval(command) => command.run(),
        Command::Baselines(command) => command.run(),
        Command::Results(command) => command.run(),
        Command::Report(command) => command.run(),
        Command::Bench(command) => command.run(),
        Command::Scenario(command) => command.run(),
        Command::Checkpoint(command) => command.run(),
        Command::Doctor(command) => command.run(),
    };
    match outcome {
        Ok(code) => code,
        Err(failure) => {
            train::progress::say(&format!("cross: {failure}"));
            ExitCode::from(failure.code())
        }
    }
}

/// What `--version` prints.
fn version() -> String {
    format!(
        "{} (protocol {}, libtorch {})",
        env!("CARGO_PKG_VERSION"),
        cross_proto::PROTOCOL_VERSION,
        cross_model::libtorch_version()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
