//! The stored episodes summed up: means over seeds, which variant is the strongest, what agrees with whom.

use super::agreement::{Comparison, Spread};
use super::plan::{Missing, Plan, Subject, published_variant};
use super::reference;
use super::store::{Episode, Store};
use crate::failure::{Failure, Outcome};
use crate::paper;
use crate::policy::PolicySpec;
use cross_config::EnvConfig;
use cross_sim::controller::RuleBased;
use cross_sim::metrics::Metric;
use cross_sim::scenario::SumoOptions;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Share of all vehicles by which variants may differ in how many they leave outside and still be ranked by trip delay.
const OUTSIDE_APART: f64 = 0.01;

/// Everything that the page shows, and what `--json` prints.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    /// Command that makes it again.
    pub(crate) command: String,
    /// This program's version.
    pub(crate) cross_version: &'static str,
    pub(crate) sumo_version: String,
    pub(crate) env: EnvConfig,
    pub(crate) scenarios: Vec<ScenarioReport>,
    pub(crate) missing: Vec<Missing>,
    /// Where the scenarios' pictures are, as the page refers to it, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) pictures: Option<PathBuf>,
}

/// All rules on a scenario.
#[derive(Debug, Serialize)]
pub(crate) struct ScenarioReport {
    pub(crate) scenario: String,
    /// Vehicles that its demand defines.
    pub(crate) vehicles: u64,
    pub(crate) begin_seconds: u32,
    pub(crate) net_hash: String,
    pub(crate) demand_hash: String,
    pub(crate) sumo: SumoOptions,
    pub(crate) policies: Vec<PolicyReport>,
}

/// A policy on a scenario.
#[derive(Debug, Serialize)]
pub(crate) struct PolicyReport {
    /// The rule's name, or what the weights were called.
    pub(crate) policy: String,
    /// What the weights are, if it is learned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) learned: Option<LearnedReport>,
    pub(crate) seeds: Vec<u32>,
    /// What the paper calls it, if it is a rule of the paper in the paper's variant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) paper_method: Option<&'static str>,
    /// Whether it is the strongest of several Max-Pressure variants.
    pub(crate) strongest_max_pressure: bool,
    /// By [`Metric::key`].
    pub(crate) metrics: BTreeMap<&'static str, Figure>,
    /// Mean counts by what became of the vehicles.
    pub(crate) vehicles: BTreeMap<String, f64>,
    pub(crate) gridlocked_seeds: Vec<u32>,
    /// Beside the paper's figures.
    pub(crate) paper: Vec<Comparison>,
    /// Beside the independent measurement, over the seeds that both have.
    pub(crate) reference: Vec<Comparison>,
}

/// What makes a policy a learned one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct LearnedReport {
    /// First digits of the hash of the weights.
    pub(crate) weights: String,
    /// Whether it was trained on streets that are these, whatever the traffic; `None` if the weights do not tell.
    pub(crate) trained_here: Option<bool>,
}

/// A metric over the seeds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Figure {
    /// Mean of the episodes' means.
    pub(crate) mean: f64,
    /// Mean of the episodes' deviations.
    pub(crate) std: f64,
    /// The seed with the lowest mean.
    pub(crate) low: f64,
    /// The seed with the highest mean.
    pub(crate) high: f64,
}

impl Report {
    /// Reads every episode of the plan from the store, where all of them must be.
    pub(crate) fn read(plan: &Plan, store: &Store, command: String) -> Outcome<Self> {
        let scenarios = plan.subjects.iter().map(|subject| ScenarioReport::read(plan, subject, store));
        Ok(Self {
            command,
            cross_version: env!("CARGO_PKG_VERSION"),
            sumo_version: plan.sumo_version.clone(),
            env: plan.env.clone(),
            scenarios: scenarios.collect::<Outcome<_>>()?,
            missing: plan.missing.clone(),
            pictures: None,
        })
    }
}

impl ScenarioReport {
    fn read(plan: &Plan, subject: &Subject, store: &Store) -> Outcome<Self> {
        let mut policies = Vec::new();
        for policy in &subject.policies {
            let episodes = subject.seeds(policy).into_iter().map(|seed| {
                let made = plan.made(&super::plan::Job { subject, policy, seed });
                store.load(&made).ok_or_else(|| {
                    Failure::failed(format!(
                        "the result of {} on {}, seed {seed}, is gone from {}; run the command again",
                        policy.name(),
                        subject.scenario.name,
                        store.folder().display()
                    ))
                })
            });
            let episodes: Vec<_> = episodes.collect::<Outcome<_>>()?;
            let published = policy.rule() == Some(published_variant(&subject.scenario));
            let mut report = PolicyReport::new(&subject.scenario.name, policy, published, &episodes);
            if let Some(learned) = &mut report.learned {
                learned.trained_here = policy.trained_on(&subject.layout_hash);
            }
            policies.push(report);
        }
        mark_strongest(&mut policies, subject.vehicles);
        let scenario = &subject.scenario;
        Ok(Self {
            scenario: scenario.name.clone(),
            vehicles: subject.vehicles,
            begin_seconds: scenario.begin,
            net_hash: scenario.net_hash.clone(),
            demand_hash: scenario.demand_hash.clone(),
            sumo: scenario.sumo.clone(),
            policies,
        })
    }
}

impl PolicyReport {
    /// Sums up; `published` says whether this is the variant with which the paper's Max-Pressure row is reproduced.
    pub(super) fn new(scenario: &str, policy: &PolicySpec, published: bool, episodes: &[Episode]) -> Self {
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let means = |metric: Metric, wanted: &dyn Fn(u32) -> bool| -> Vec<f64> {
            let episodes = episodes.iter().filter(|episode| wanted(episode.seed));
            episodes.filter_map(|episode| Some(episode.metrics.get(metric.key())?.mean)).collect()
        };
        let figure = |metric: Metric| {
            let Spread { mean: of_means, low, high } = Spread::of(&means(metric, &|_| true))?;
            let deviations = episodes.iter().filter_map(|e| Some(e.metrics.get(metric.key())?.std)).collect();
            Some((metric.key(), Figure { mean: of_means, std: mean(deviations), low, high }))
        };
        let paper_method = match policy.rule() {
            Some(RuleBased::FixedTime) => Some("fixed-time"),
            _ if published => Some("max-pressure"),
            _ => None,
        };
        let paper = Metric::PAPER.into_iter().filter_map(|metric| {
            let published = paper::lookup(scenario, paper_method?, metric.key())?.mean;
            let ours = Spread::of(&means(metric, &|_| true))?;
            Some(Comparison::with_published(scenario, metric, ours, published))
        });
        let others: Vec<_> =
            policy.rule().into_iter().flat_map(|rule| reference::episodes(scenario, rule)).collect();
        let both = |seed: u32| {
            others.iter().any(|other| other.seed == seed) && episodes.iter().any(|own| own.seed == seed)
        };
        let reference = Metric::ALL.into_iter().filter_map(|metric| {
            let theirs = others.iter().filter(|other| both(other.seed));
            let theirs: Vec<_> = theirs.filter_map(|other| other.means.get(metric.key()).copied()).collect();
            let ours = Spread::of(&means(metric, &both))?.mean;
            Some(Comparison::with_reference(scenario, metric, ours, Spread::of(&theirs)?))
        });
        let mut vehicles: BTreeMap<String, f64> = BTreeMap::new();
        for (fate, count) in episodes.iter().flat_map(|episode| &episode.vehicles) {
            *vehicles.entry(fate.clone()).or_default() += count / episodes.len() as f64;
        }
        Self {
            policy: policy.name().to_owned(),
            learned: match policy {
                PolicySpec::Rule(_) => None,
                PolicySpec::Learned(weights) => {
                    Some(LearnedReport { weights: weights.hash.clone(), trained_here: None })
                }
            },
            seeds: episodes.iter().map(|episode| episode.seed).collect(),
            paper_method,
            strongest_max_pressure: false,
            metrics: Metric::ALL.into_iter().filter_map(figure).collect(),
            vehicles,
            gridlocked_seeds: episodes.iter().filter(|e| e.gridlock).map(|e| e.seed).collect(),
            paper: paper.collect(),
            reference: reference.collect(),
        }
    }
}

/// Marks the Max-Pressure variant to beat: the lowest trip delay. That counts the vehicles that got in, so that it only ranks
/// variants which let in about as many; where they differ, the waiting time of all vehicles ranks them, the time outside in it.
fn mark_strongest(policies: &mut [PolicyReport], all_vehicles: u64) {
    let variant = |policy: &&mut PolicyReport| {
        RuleBased::MAX_PRESSURE_VARIANTS.iter().any(|rule| rule.name() == policy.policy)
    };
    let mut variants: Vec<_> = policies.iter_mut().filter(variant).collect();
    let outside: Vec<_> = variants
        .iter()
        .map(|policy| policy.vehicles.get("never_inserted").copied().unwrap_or_default())
        .collect();
    let apart = Spread::of(&outside).map_or(0.0, |spread| spread.high - spread.low);
    let alike = apart <= OUTSIDE_APART * all_vehicles as f64;
    let ranked_by = if alike { Metric::TripDelay } else { Metric::WaitingTime };
    let value = |policy: &PolicyReport| {
        policy.metrics.get(ranked_by.key()).map_or(f64::INFINITY, |figure| figure.mean)
    };
    variants.sort_by(|a, b| value(a).total_cmp(&value(b)));
    if let [strongest, _, ..] = variants.as_mut_slice() {
        strongest.strongest_max_pressure = true;
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::store::tests::episode;
    use super::*;

    /// A report of these rules on these scenarios, every metric 2 on seed 1 and 4 on seed 2, times the rule's place.
    pub(in crate::baselines) fn report(scenarios: &[&str], policies: &[RuleBased]) -> Report {
        let scenarios = scenarios.iter().map(|&name| {
            let mut reports: Vec<_> = (1..)
                .zip(policies)
                .map(|(place, &policy)| {
                    let place = f64::from(place);
                    let episodes = [episode(1, 2.0 * place), episode(2, 4.0 * place)];
                    PolicyReport::new(
                        name,
                        &PolicySpec::Rule(policy),
                        policy == RuleBased::MaxPressureAll,
                        &episodes,
                    )
                })
                .collect();
            mark_strongest(&mut reports, 1473);
            ScenarioReport {
                scenario: name.to_owned(),
                vehicles: 1473,
                begin_seconds: 0,
                net_hash: "0123456789abcdef".to_owned(),
                demand_hash: "fedcba9876543210".to_owned(),
                sumo: SumoOptions::default(),
                policies: reports,
            }
        });
        Report {
            command: "cross baselines".to_owned(),
            cross_version: "1",
            sumo_version: "1.28.0".to_owned(),
            env: EnvConfig::default(),
            scenarios: scenarios.collect(),
            missing: vec![Missing { scenario: "jinan1".to_owned(), reason: "get it".to_owned() }],
            pictures: None,
        }
    }

    #[test]
    fn seeds_are_averaged_and_their_spread_is_kept() {
        let report = report(&["grid4x4"], &[RuleBased::FixedTime]);
        let figure = report.scenarios[0].policies[0].metrics["trip_delay"];
        assert_eq!(figure, Figure { mean: 3.0, std: 1.5, low: 2.0, high: 4.0 });
        assert_eq!(report.scenarios[0].policies[0].vehicles["finished"], 10.0);
    }

    #[test]
    fn each_row_of_the_paper_stands_beside_the_rule_it_is_of() {
        let report = report(
            &["grid4x4"],
            &[
                RuleBased::FixedTime,
                RuleBased::MaxPressureStopped,
                RuleBased::MaxPressureAll,
                RuleBased::Greedy,
            ],
        );
        let [fixed, stopped, all, greedy] = report.scenarios[0].policies.as_slice() else { panic!() };
        assert_eq!((fixed.paper_method, all.paper_method), (Some("fixed-time"), Some("max-pressure")));
        assert_eq!(fixed.paper.iter().find(|c| c.metric == "trip_delay").unwrap().theirs, 54.96);
        assert_eq!(all.paper.iter().find(|c| c.metric == "trip_delay").unwrap().theirs, 33.18);
        assert!(stopped.paper.is_empty() && greedy.paper.is_empty() && greedy.reference.is_empty());
        // The independent measurement has every variant; of its three seeds only those count that were run here.
        let delay = stopped.reference.iter().find(|c| c.metric == "trip_delay").unwrap();
        assert!((delay.theirs - (23.0292 + 23.4134) / 2.0).abs() < 1e-9, "{delay:?}");
        assert_eq!(delay.agrees, Some(false));
        // The lower delay of the two variants is the stronger rule's.
        assert!(
            stopped.strongest_max_pressure && !all.strongest_max_pressure && !greedy.strongest_max_pressure
        );
    }

    #[test]
    fn one_variant_alone_is_not_the_strongest_of_anything() {
        let report = report(&["grid4x4"], &[RuleBased::MaxPressureAll]);
        assert!(!report.scenarios[0].policies[0].strongest_max_pressure);
    }

    #[test]
    fn a_variant_that_keeps_vehicles_out_is_not_the_strongest_for_its_low_delay() {
        let variant = |policy, factor: f64, outside: f64, waiting: f64| {
            let mut episode = episode(1, factor);
            episode.vehicles.insert("never_inserted".to_owned(), outside);
            episode.metrics.get_mut(Metric::WaitingTime.key()).unwrap().mean = waiting;
            PolicyReport::new("mine", &PolicySpec::Rule(policy), false, &[episode])
        };
        let strongest = |outside: f64| {
            let mut policies = [
                variant(RuleBased::MaxPressureStopped, 1.0, outside, 9.0),
                variant(RuleBased::MaxPressureAll, 2.0, 0.0, 8.0),
            ];
            mark_strongest(&mut policies, 1000);
            policies.map(|policy| policy.strongest_max_pressure)
        };
        assert_eq!(strongest(10.0), [true, false]);
        assert_eq!(strongest(11.0), [false, true]);
    }
}
