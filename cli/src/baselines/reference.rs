//! An independent implementation's measurement of the rules, read from `data/rule-based-reference.csv`.

use crate::paper::records;
use cross_sim::controller::RuleBased;
use std::collections::BTreeMap;
use std::sync::LazyLock;

const TABLE: &str = include_str!("../../data/rule-based-reference.csv");

/// One of its episodes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Reference {
    pub(crate) scenario: &'static str,
    pub(crate) policy: RuleBased,
    pub(crate) seed: u32,
    /// Means by [`cross_sim::metrics::Metric::key`].
    pub(crate) means: BTreeMap<&'static str, f64>,
}

/// The episodes of a rule on a scenario, by seed; none where nothing was measured.
pub(crate) fn episodes(scenario: &str, policy: RuleBased) -> impl Iterator<Item = &'static Reference> {
    all().iter().filter(move |episode| episode.scenario == scenario && episode.policy == policy)
}

fn all() -> &'static [Reference] {
    static EPISODES: LazyLock<Vec<Reference>> =
        LazyLock::new(|| records(TABLE).filter_map(|fields| reference(&fields)).collect());
    &EPISODES
}

fn reference(fields: &[&'static str]) -> Option<Reference> {
    let policy = match *fields.get(1)? {
        "ft" => RuleBased::FixedTime,
        "mp_halt" => RuleBased::MaxPressureStopped,
        "mp_veh" => RuleBased::MaxPressureAll,
        "mp_halt50" => RuleBased::MaxPressureStopped50m,
        _ => return None,
    };
    let means = [
        ("queue_length", 3),
        ("speed", 5),
        ("trip_completion_rate", 7),
        ("trip_time", 8),
        ("trip_delay", 10),
        ("time_loss", 12),
        ("trip_duration", 13),
    ];
    let means = means.into_iter().map(|(key, column)| Some((key, fields.get(column)?.parse().ok()?)));
    Some(Reference {
        scenario: fields.first()?,
        policy,
        seed: fields.get(2)?.parse().ok()?,
        means: means.collect::<Option<_>>()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::baselines::plan::SCENARIOS;

    #[test]
    fn every_scenario_has_four_rules_and_its_seeds() {
        assert_eq!(all().len(), 124, "a line that cannot be read would be missing");
        for scenario in SCENARIOS {
            let seeds = if scenario == "grid5x5" { 10 } else { 3 };
            for policy in [
                RuleBased::FixedTime,
                RuleBased::MaxPressureStopped,
                RuleBased::MaxPressureAll,
                RuleBased::MaxPressureStopped50m,
            ] {
                let found: Vec<_> = episodes(scenario, policy).map(|episode| episode.seed).collect();
                assert_eq!(found, (1..=seeds).collect::<Vec<_>>(), "{scenario} {policy}");
            }
        }
        assert_eq!(episodes("grid4x4", RuleBased::Greedy).count(), 0);
    }

    #[test]
    fn columns_are_what_their_header_says() {
        let header = TABLE.lines().find(|line| line.starts_with("scenario,")).unwrap();
        let columns: Vec<_> = header.split(',').collect();
        let first = episodes("jinan1", RuleBased::FixedTime).next().unwrap();
        let line = TABLE.lines().find(|line| line.starts_with("jinan1,ft,1,")).unwrap();
        let fields: Vec<_> = line.split(',').collect();
        assert_eq!(first.means.len(), 7);
        for (key, mean) in &first.means {
            let column = columns.iter().position(|column| column == key).unwrap();
            assert_eq!(fields[column].parse::<f64>().unwrap(), *mean, "{key}");
        }
    }
}
