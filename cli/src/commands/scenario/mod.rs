//! `cross scenario`: what can be trained and evaluated on, and making more of it.

mod fetch;
mod generate;
mod import;
mod info;
mod list;
mod made;

use crate::failure::Outcome;
use clap::{Args, Subcommand};
use std::process::ExitCode;

/// Lists scenarios, tells what is in one, and makes new ones
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross scenario list
  cross scenario info grid4x4
  cross scenario info my/own/directory --json
  cross scenario generate grid --columns 3 --rows 3 --name small
  cross scenario import cityflow --roadnet roadnet_3_4.json --flow anon_3_4_jinan_real.json --name jinan1

A scenario is a directory with a scenario.toml; it is found by name under scenarios/ beside or above this program or the
current folder, under the folders of CROSS_SCENARIOS, or by its path.")]
pub(crate) struct Scenario {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    List(list::List),
    Info(info::Info),
    Fetch(fetch::Fetch),
    Generate(generate::Generate),
    Import(import::Import),
}

impl Scenario {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        match &self.command {
            Command::List(command) => command.run()?,
            Command::Info(command) => command.run()?,
            Command::Fetch(command) => command.run()?,
            Command::Generate(command) => command.run()?,
            Command::Import(command) => command.run()?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
