//! `cross train`: one command from a configuration to a trained, evaluated policy.

use crate::failure::{Failure, OrBadInput, Outcome};
use crate::output;
use crate::sumo::SumoOption;
use crate::train::closing::{self, Summary};
use crate::train::preflight::{self, Ready};
use crate::train::progress::{Progress, say, spell};
use crate::train::run::{self, Plan};
use crate::train::run_dir::{self, RunDir};
use crate::train::watch::Watch;
use anyhow::Context;
use clap::Args;
use cross_config::{ComputeDevice, Config};
use cross_support::client::ClientSecurity;
use cross_support::options::{ClientOptions, TokenOption};
use cross_support::token::Tokens;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Trains CROSS on SUMO, then compares it with Fixed-Time and Max-Pressure
///
/// Starts one learner and its actors on this machine, keeps them running until the updates are done, evaluates the final
/// policy beside the rule-based controllers on the same seeds, and leaves everything in the run directory.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross train                                       grid4x4 with the built-in configuration
  cross train --scenario grid4x4 --scenario arterial4x4 --updates 200
  cross train --config configs/paper.toml --seed 3 --run runs/paper-3
  cross train --resume --run runs/paper-3           go on where it stopped
  cross train --resume --run runs/paper-3 --updates 400    ... and further than was asked at first
  cross train --run runs/a --checkpoints s3://bucket/a   every checkpoint in an object store, too
  cross train --serial --seed 7                     one actor in lock step: the same numbers every time

Ctrl-C or SIGTERM once: the learner finishes its update and writes a checkpoint, and the command ends with
exit code 0 and \"interrupted\": true in the JSON result. Again, more than a second later: everything is killed at
once, exit code 1.")]
pub(crate) struct Train {
    /// Scenario to train on: a name or a directory; repeat it to train on several together [default: grid4x4]
    #[arg(long = "scenario", value_name = "NAME")]
    scenarios: Vec<String>,
    /// Updates of the whole run, those before a --resume included [default: 60, or the configuration's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    updates: Option<u64>,
    /// Actor processes, each with a SUMO of its own [default: one per core, at least 2; 1 with --serial]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    actors: Option<u16>,
    /// Run directory [default: runs/DATE-TIME; with --resume the newest under runs/]
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Go on from the newest checkpoint of the run directory, with its configuration unless --config names another
    #[arg(long)]
    resume: bool,
    /// Where checkpoints are copied besides the run directory: s3://BUCKET/PATH, gs://, az:// or file:///FOLDER; with
    /// --resume the run can go on from there. Credentials come from the environment
    #[arg(long, value_name = "URL")]
    checkpoints: Option<String>,
    /// Configuration in TOML; the options here go before it. docs/configuration.md explains every key
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Seed of everything random [default: 1]
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Where updates are computed: auto (CUDA if libtorch has it and a device is there), cpu or cuda [default: auto]
    #[arg(long, value_name = "DEVICE")]
    device: Option<ComputeDevice>,
    /// Lock-step mode: one actor, no collection during updates; one seed always gives the same numbers
    #[arg(long)]
    serial: bool,
    /// SUMO seeds 1 to N for the closing evaluation; 0 leaves it out
    #[arg(long, value_name = "N", default_value_t = 3)]
    eval_seeds: u32,
    #[command(flatten)]
    sumo: SumoOption,
    #[command(flatten)]
    token: TokenOption,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
    /// No progress, only what needs attention
    #[arg(long)]
    no_progress: bool,
}

impl Train {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let started = Instant::now();
        // Learner and actors read it again, but a person should hear of a bad one from this program, and at once.
        let client = ClientOptions { token: self.token.clone(), ..ClientOptions::default() };
        let security = ClientSecurity::load(&client, Tokens::variable()).or_bad_input()?;
        let elsewhere = self.checkpoints.as_ref().is_some_and(|url| !url.is_empty());
        let existing = if self.resume { Some(RunDir::open(self.run.as_deref(), elsewhere)?) } else { None };
        let config = self.resolve(existing.as_ref())?;
        let actors = self.actors(&config)?;
        let ready = preflight::check(&config, self.sumo.locate()?)?;
        let run = match existing {
            Some(run) => {
                // The learner checks the same, but by then the run's configuration is overwritten. Where a store may have
                // what the disk has lost, it alone can tell.
                if config.learner.checkpoint_url.is_empty() {
                    cross_learner::find_checkpoint(run.path(), &config).or_bad_input()?;
                }
                run
            }
            None => RunDir::create(self.run.as_deref())?,
        };
        run_dir::write_atomically(&run.config(), config.to_toml().as_bytes())?;
        if !self.no_progress {
            self.announce(&config, &ready, &run, actors);
        }

        // Attention, not progress: whoever forgot to ask for more would wait for the same evaluation once more.
        let done =
            if self.resume { run.newest_checkpoint().map_or(0, |(_, newest)| newest.updates) } else { 0 };
        if done >= config.updates {
            say(&format!(
                "all {} updates are done already ({done} in the newest checkpoint); --updates with a higher number trains on",
                config.updates
            ));
        }

        let watch = Watch::start(security).context("cannot listen for signals")?;
        let plan = Plan {
            actors,
            updates: config.updates,
            drain_seconds: config.learner.drain_seconds,
            resume: self.resume,
            checkpoint_url: config.learner.checkpoint_url.clone(),
            sumo_home: ready.sumo.path().to_owned(),
            token_file: self.token.token_file.clone(),
        };
        let mut progress = Progress::new(!self.no_progress, config.updates);
        let trained = run::run(&run, &plan, &watch, &mut progress)?;
        let mut summary = Summary::new(&run, &config, trained.interrupted);
        if trained.killed {
            return Err(Failure::failed(format!(
                "killed without waiting for a last checkpoint; continue from the newest one with {}",
                resume_command(run.path())
            )));
        }
        closing::draw_curves(&run, &mut summary);
        if trained.stopped_at_the_end {
            summary.leave_out_evaluation();
        } else if !trained.interrupted && self.eval_seeds > 0 {
            if !self.no_progress {
                say(&format!("evaluating over {} seeds", self.eval_seeds));
            }
            summary.evaluate(&ready, &config, self.eval_seeds, &watch, !self.no_progress)?;
        }
        summary.elapsed_seconds = started.elapsed().as_secs_f64();
        let document = summary.write(&run)?;
        if self.json {
            output::json(&document)?;
        } else {
            output::text(&summary.render())?;
        }
        if trained.interrupted {
            say(&format!(
                "stopped after update {} of {}; continue with {}",
                summary.updates,
                config.updates,
                resume_command(run.path())
            ));
        } else if !self.no_progress {
            say(&format!("done in {}", spell(started.elapsed())));
        }
        Ok(ExitCode::SUCCESS)
    }

    /// Defaults, then the file, then the options.
    fn resolve(&self, existing: Option<&RunDir>) -> Outcome<Config> {
        let mut config = match (&self.config, existing) {
            (Some(file), _) => Config::from_file(file).or_bad_input()?,
            (None, Some(run)) if run.config().exists() => Config::from_run(&run.config()).or_bad_input()?,
            (None, Some(run)) if self.checkpoints.is_some() => {
                return Err(Failure::input(format!(
                    "{} has no config.toml to go on with; name the run's configuration with --config",
                    run.path().display()
                )));
            }
            (None, Some(run)) => Config::from_run(&run.config()).or_bad_input()?,
            (None, None) => Config::default(),
        };
        if !self.scenarios.is_empty() {
            config.scenarios.clone_from(&self.scenarios);
        }
        for scenario in &mut config.scenarios {
            *scenario = absolute(scenario);
        }
        if let Some(updates) = self.updates {
            config.updates = updates;
        }
        if let Some(seed) = self.seed {
            config.seed = seed;
        }
        if let Some(device) = self.device {
            config.learner.device = device;
        }
        if let Some(url) = &self.checkpoints {
            config.learner.checkpoint_url.clone_from(url);
        }
        if self.serial {
            config.learner.serial = true;
        }
        config.validate().or_bad_input()?;
        Ok(config)
    }

    fn actors(&self, config: &Config) -> Outcome<usize> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        match (self.actors, config.learner.serial) {
            (None | Some(1), true) => Ok(1),
            (Some(actors), true) => Err(Failure::input(format!(
                "serial mode has one actor, and --actors asks for {actors}; leave one of the two out"
            ))),
            (None, false) => Ok(cores.max(2).min(config.learner.max_actors)),
            (Some(actors), false) if usize::from(actors) > config.learner.max_actors => {
                Err(Failure::input(format!(
                    "--actors asks for {actors}, more than learner.max_actors = {} admits",
                    config.learner.max_actors
                )))
            }
            (Some(actors), false) => Ok(usize::from(actors)),
        }
    }

    fn announce(&self, config: &Config, ready: &Ready, run: &RunDir, actors: usize) {
        let action = if self.resume { "resuming" } else { "training" };
        let mode = if config.learner.serial { ", serial" } else { "" };
        say(&format!(
            "{action} {} for {} updates with {actors} actor{}{mode}, seed {}",
            config.scenarios.join(" + "),
            config.updates,
            if actors == 1 { "" } else { "s" },
            config.seed
        ));
        say(&format!(
            "SUMO {} in {}, libtorch {}, updates on {} in {}",
            ready.sumo_version,
            ready.sumo.path().display(),
            cross_model::libtorch_version(),
            ready.placement.device_name(),
            ready.placement.precision_name()
        ));
        say(&format!("run directory {} (configuration, logs, checkpoints)", run.path().display()));
    }
}

fn resume_command(run: &Path) -> String {
    format!("`cross train --resume --run {}`", run.display())
}

/// A scenario that is given by its path, so that the run can be resumed from another folder. Names stay.
fn absolute(scenario: &str) -> String {
    let path = Path::new(scenario);
    if path.components().count() <= 1 && !scenario.starts_with('.') {
        return scenario.to_owned();
    }
    // What does not exist is reported where scenarios are loaded, under the name that was typed.
    path.canonicalize().map_or_else(|_| scenario.to_owned(), |path| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Harness {
        #[command(flatten)]
        train: Train,
    }

    fn parse(arguments: &[&str]) -> Train {
        Harness::try_parse_from(std::iter::once("train").chain(arguments.iter().copied())).unwrap().train
    }

    #[test]
    fn options_go_before_the_file_and_the_file_before_the_defaults() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("c.toml");
        std::fs::write(&file, "seed = 9\nupdates = 50\n").unwrap();
        let train =
            parse(&["--config", file.to_str().unwrap(), "--updates", "7", "--scenario", "arterial4x4"]);
        let config = train.resolve(None).unwrap();
        assert_eq!((config.seed, config.updates), (9, 7));
        assert_eq!(config.scenarios, ["arterial4x4"]);
        assert_eq!(config.ppo, Config::default().ppo);
    }

    #[test]
    fn what_cannot_work_is_bad_input() {
        for arguments in [&["--config", "/nowhere.toml"][..], &["--scenario", "a", "--scenario", "a"]] {
            let failure = parse(arguments).resolve(None).unwrap_err();
            assert_eq!(failure.code(), crate::failure::BAD_INPUT, "{failure}");
        }
    }

    #[test]
    fn serial_mode_has_one_actor() {
        let train = parse(&["--serial"]);
        let config = train.resolve(None).unwrap();
        assert_eq!(train.actors(&config).unwrap(), 1);
        assert!(parse(&["--serial", "--actors", "2"]).actors(&config).is_err());
        assert!(parse(&[]).actors(&Config::default()).unwrap() >= 2);
    }

    #[test]
    fn a_scenario_by_path_becomes_absolute_and_a_name_stays() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("..").join(directory.path().file_name().unwrap());
        assert_eq!(
            absolute(path.to_str().unwrap()),
            directory.path().canonicalize().unwrap().display().to_string()
        );
        assert_eq!(absolute("grid4x4"), "grid4x4");
        assert_eq!(absolute("no/such/place"), "no/such/place");
    }
}
