//! `cross results`: learned policies beside the rules and the paper's methods.

use super::baselines::{Table, quoted};
use crate::baselines::results;
use crate::failure::{Failure, Outcome};
use crate::policy::PolicySpec;
use crate::train::progress::say;
use clap::Args;
use cross_sim::controller::RuleBased;
use std::path::PathBuf;
use std::process::ExitCode;

/// Evaluates learned policies on the paper's scenarios, beside the rules and the figures that the paper prints
///
/// Fixed-Time and every variant of Max-Pressure run along. Finished episodes are kept in a folder, the same as those of `cross
/// baselines`, so that the command may be stopped and called again; those of a policy count for its very weights. Writes a page
/// of Markdown, the protocol included.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross results --policy pretrained/default --sampled                    the published policy, greedy and drawn
  cross results --markdown my-results.md --pictures pictures             a page, with a picture a scenario
  cross results --policy runs/20260131-235959 --scenario grid4x4 --scenario cologne8
  cross results --policy pretrained/default --seeds 1 --json

Without --scenario those of the eight that were not imported are named and left out; what --scenario names must be there.
Ctrl-C: the episodes under way are lost, the finished ones kept, exit code 1.")]
pub(crate) struct Results {
    /// Weights: a checkpoint, a run directory or a policy file; repeat it for several
    #[arg(long = "policy", value_name = "POLICY", default_value = "pretrained/default")]
    policies: Vec<String>,
    /// Show each policy a second time, with phases drawn by their probabilities, as in training
    #[arg(long)]
    sampled: bool,
    /// SUMO seeds 1 to N
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    seeds: u32,
    /// Draw queue and speed over time, and the experts and clusters of each policy, into this folder; one SVG file a scenario
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    #[command(flatten)]
    table: Table,
}

impl Results {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let rules = [RuleBased::FixedTime].into_iter().chain(RuleBased::MAX_PRESSURE_VARIANTS);
        let mut policies: Vec<_> = rules.map(PolicySpec::Rule).collect();
        for policy in &self.policies {
            let learned = PolicySpec::parse(policy)?;
            if let Some(rule) = learned.rule() {
                return Err(Failure::input(format!(
                    "{rule} is a rule; Fixed-Time and Max-Pressure are in the table anyway, others in that of cross baselines"
                )));
            }
            if policies.iter().any(|other| other.key() == learned.key()) {
                say(&format!("{policy} has the weights of another one that was named, and appears once"));
            }
            policies.push(learned.clone());
            if self.sampled {
                policies.push(learned.sampled()?);
            }
        }
        let mut words = vec!["cross results".to_owned()];
        words.extend(self.policies.iter().map(|policy| format!("--policy {}", quoted(policy))));
        if self.sampled {
            words.push("--sampled".to_owned());
        }
        words.push(format!("--seeds {}", self.seeds));
        words.extend(
            self.pictures.iter().map(|folder| format!("--pictures {}", quoted(&folder.to_string_lossy()))),
        );
        self.table.make(words, &policies, Some(self.seeds), self.pictures.as_deref(), results::render)
    }
}
