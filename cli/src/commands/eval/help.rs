//! What `cross eval --help` tells beside the options: policies, protocols, metrics, the columns of the CSV file.
//!
//! All of it comes from the lists that the commands work with, so that it cannot fall behind them.

use super::csv::{ALL_SEEDS, COLUMNS};
use cross_sim::controller::RuleBased;
use cross_sim::metrics::definitions;
use cross_sim::preset::Preset;
use std::fmt::Write as _;

const EXAMPLES: &str = "\
Examples:
  cross eval --scenario grid4x4 --policy fixed-time
  cross eval --scenario cologne8 --policy actuated --seeds 5
  cross eval --scenario arterial4x4 --policy max-pressure --protocol resco
  cross eval --scenario arterial4x4 --policy runs/20260131-235959  a run's newest checkpoint
  cross eval --scenario grid4x4 --policy runs/paper-3/checkpoints/000100 --json
  cross eval --scenario grid4x4 --policy s3://bucket/paper-3       newest copy in an object store
  cross eval --scenario grid4x4 --policy policy.safetensors        from `cross checkpoint export`
  cross eval --scenario grid4x4 --policy greedy --csv greedy.csv --out greedy.json";

/// Below the options of `-h`.
pub(super) fn short() -> String {
    format!(
        "{EXAMPLES}\n\nPolicies by name:\n  {}\nProtocols: {}\n`cross eval --help` says what each is, and defines every metric.",
        RuleBased::names().chunks(5).map(|names| names.join(", ")).collect::<Vec<_>>().join(",\n  "),
        Preset::names().join(", ")
    )
}

/// Below the options of `--help`.
pub(super) fn long() -> String {
    // Writing to a string cannot fail.
    let mut text = EXAMPLES.to_owned();
    text.push_str("\n\nPolicies by name:");
    for policy in RuleBased::ALL {
        let _ = write!(text, "\n  {:<24}  {}", policy.name(), policy.summary());
    }
    text.push_str("\n\nProtocols (decision interval/yellow, teleports after):");
    for preset in Preset::ALL {
        let _ = write!(text, "\n  {:<7}  {}", preset.name(), preset.summary());
    }
    text.push_str(
        "\n\nMetrics, by their keys in JSON and CSV. T: the seconds of an episode; entered vehicles: finished\n\
         and unfinished ones. A figure is the mean over the seeds; after ± stands the mean over the seeds of\n\
         the deviation inside an episode.",
    );
    for definition in definitions() {
        let _ = write!(
            text,
            "\n  {} ({})\n      {}\n      from {}",
            definition.key, definition.unit, definition.formula, definition.source
        );
    }
    let _ = write!(
        text,
        "\n\nColumns of --csv:\n  {}\nA row is one metric of one seed, or of all seeds (seed = {ALL_SEEDS}: means over the seeds, with the\n\
         deviation between them); blank where there is no such figure.",
        COLUMNS.join(" ")
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_line_is_broken_where_the_terminal_is_unknown() {
        for line in long().lines().chain(short().lines()) {
            assert!(line.chars().count() <= 100, "{line}");
        }
    }

    #[test]
    fn the_long_help_names_every_policy_protocol_metric_and_column() {
        let text = long();
        let words: Vec<&str> = text.split(|c: char| !(c.is_alphanumeric() || c == '-' || c == '_')).collect();
        let keys = definitions().into_iter().map(|definition| definition.key);
        for name in RuleBased::names().into_iter().chain(Preset::names()).chain(keys).chain(COLUMNS) {
            assert!(words.contains(&name), "{name} is missing in\n{text}");
        }
    }
}
