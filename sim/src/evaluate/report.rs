//! What an evaluation found, as one JSON document.

use super::Setting;
use crate::layout::NetworkLayout;
use crate::metrics::{EpisodeMetrics, Metric, Moments};
use cross_config::Detection;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

/// Everything besides the policy and the seeds on which the numbers depend.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Protocol {
    /// Seconds between two decisions.
    pub interval_seconds: u32,
    /// Seconds of yellow at a change of phase, inside the interval.
    pub yellow_seconds: u32,
    /// Simulated time at which an episode begins.
    pub begin_seconds: u32,
    /// Simulated seconds of an episode.
    pub episode_seconds: u32,
    /// Detection bands of the observation, which only learned policies read.
    pub detection: Detection,
    /// Metres before the stop line within which a stopped vehicle counts against the reward.
    pub reward_range_metres: f32,
    /// Seconds of standing after which SUMO moves a vehicle on; -1 never.
    pub time_to_teleport_seconds: f64,
    /// SUMO's `--default.departspeed`.
    pub depart_speed: String,
    /// SUMO's `--default.departlane`.
    pub depart_lane: String,
    /// SUMO's version.
    pub sumo_version: String,
    /// SHA-256 of the net.
    pub net_hash: String,
    /// SHA-256 of the demand.
    pub demand_hash: String,
    /// Hash of what was read from the net: [`NetworkLayout::hash`].
    pub layout_hash: String,
}

impl Protocol {
    pub(super) fn new(setting: &Setting<'_>, layout: &NetworkLayout, sumo_version: String) -> Self {
        let Setting { scenario, env, .. } = setting;
        Self {
            interval_seconds: env.decision_seconds,
            yellow_seconds: env.yellow_seconds,
            begin_seconds: scenario.begin,
            episode_seconds: env.episode_seconds,
            detection: env.detection,
            reward_range_metres: env.reward_range_metres,
            time_to_teleport_seconds: scenario.sumo.time_to_teleport,
            depart_speed: scenario.sumo.depart_speed.clone(),
            depart_lane: scenario.sumo.depart_lane.clone(),
            sumo_version,
            net_hash: scenario.net_hash.clone(),
            demand_hash: scenario.demand_hash.clone(),
            layout_hash: layout.hash(),
        }
    }
}

/// A metric over the seeds of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SeedSummary {
    /// Mean of the episodes' means.
    pub mean: f64,
    /// Mean of the episodes' deviations: the spread inside an episode, over its seconds or vehicles, as papers print it.
    pub std: f64,
    /// Deviation of the episodes' means from each other, n-1 in the denominator; 0 for one seed.
    pub std_between_seeds: f64,
}

/// Mean number of vehicles of an episode, by what became of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeanVehicles {
    /// Reached their destination.
    pub finished: f64,
    /// Still in the network at the end.
    pub unfinished: f64,
    /// Wanted to enter and found no room until the end.
    pub never_inserted: f64,
    /// Teleports that began.
    pub teleports: f64,
}

/// A policy on a scenario: one episode for each seed, and their means.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EvalReport {
    /// Scenario name.
    pub scenario: String,
    /// Policy, by the name it was asked for.
    pub policy: String,
    /// Controller that acted; for `max-pressure` this tells the variant.
    pub controller: String,
    /// What the numbers depend on.
    pub protocol: Protocol,
    /// SUMO seeds, ascending.
    pub seeds: Vec<u32>,
    /// Each metric over the seeds, in the order of [`Metric::ALL`].
    #[serde(serialize_with = "as_map")]
    metrics: [SeedSummary; Metric::ALL.len()],
    /// Vehicles by what became of them, means over the seeds.
    pub vehicles: MeanVehicles,
    /// Mean over seeds of [`EpisodeMetrics::episode_return`].
    pub episode_return: f64,
    /// Seeds whose traffic came to rest before the end.
    pub gridlocked_seeds: Vec<u32>,
    /// The episodes, in the order of the seeds.
    pub per_seed: Vec<EpisodeMetrics>,
}

impl EvalReport {
    /// Summarises the episodes of one policy on one scenario.
    #[must_use]
    pub fn new(
        scenario: String,
        policy: String,
        controller: String,
        protocol: Protocol,
        mut per_seed: Vec<EpisodeMetrics>,
    ) -> Self {
        per_seed.sort_by_key(|episode| episode.seed);
        let mean_of = |value: &dyn Fn(&EpisodeMetrics) -> f64| {
            per_seed.iter().map(value).collect::<Moments>().mean_std().mean
        };
        let metrics = Metric::ALL.map(|metric| SeedSummary {
            mean: mean_of(&|episode| episode.get(metric).mean),
            std: mean_of(&|episode| episode.get(metric).std),
            std_between_seeds: sample_deviation(
                per_seed.iter().map(|episode| episode.get(metric).mean).collect(),
            ),
        });
        Self {
            scenario,
            policy,
            controller,
            protocol,
            seeds: per_seed.iter().map(|episode| episode.seed).collect(),
            metrics,
            vehicles: MeanVehicles {
                finished: mean_of(&|episode| episode.vehicles.finished as f64),
                unfinished: mean_of(&|episode| episode.vehicles.unfinished as f64),
                never_inserted: mean_of(&|episode| episode.vehicles.never_inserted as f64),
                teleports: mean_of(&|episode| episode.vehicles.teleports as f64),
            },
            episode_return: mean_of(&|episode| episode.episode_return),
            gridlocked_seeds: per_seed
                .iter()
                .filter(|episode| episode.gridlock)
                .map(|episode| episode.seed)
                .collect(),
            per_seed,
        }
    }

    /// One metric over the seeds.
    #[must_use]
    pub fn get(&self, metric: Metric) -> SeedSummary {
        // The array holds the metrics in declaration order, which is that of `Metric::ALL`.
        self.metrics[metric as usize]
    }

    /// The document as indented JSON; the same evaluation gives the same bytes.
    #[must_use]
    pub fn to_json(&self) -> String {
        // Strings and finite numbers always serialise.
        serde_json::to_string_pretty(self).expect("a report serialises")
    }
}

/// The report with the lowest mean trip delay: which of several Max-Pressure variants is the one to beat.
#[must_use]
pub fn strongest<'r>(reports: impl IntoIterator<Item = &'r EvalReport>) -> Option<&'r EvalReport> {
    let delay = |report: &EvalReport| report.get(Metric::TripDelay).mean;
    reports.into_iter().min_by(|a, b| delay(a).total_cmp(&delay(b)))
}

fn sample_deviation(moments: Moments) -> f64 {
    match moments.count() {
        0 | 1 => 0.0,
        count => moments.mean_std().std * (count as f64 / (count - 1) as f64).sqrt(),
    }
}

fn as_map<S: Serializer>(
    metrics: &[SeedSummary; Metric::ALL.len()],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(metrics.len()))?;
    for (metric, value) in Metric::ALL.iter().zip(metrics) {
        map.serialize_entry(metric.key(), value)?;
    }
    map.end()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::metrics::{SecondMeter, TripTotals};
    use std::path::Path;

    fn protocol() -> Protocol {
        Protocol {
            interval_seconds: 10,
            yellow_seconds: 3,
            begin_seconds: 0,
            episode_seconds: 3600,
            detection: Detection::Default,
            reward_range_metres: 50.0,
            time_to_teleport_seconds: -1.0,
            depart_speed: "0".to_owned(),
            depart_lane: "first".to_owned(),
            sumo_version: "1.28.0".to_owned(),
            net_hash: "aa".to_owned(),
            demand_hash: "bb".to_owned(),
            layout_hash: "cc".to_owned(),
        }
    }

    /// An episode with one vehicle that stood for so many seconds.
    fn episode(seed: u32, waited: f64) -> EpisodeMetrics {
        let text = format!(
            "<tripinfos><tripinfo depart=\"0\" arrival=\"100\" duration=\"100\" waitingTime=\"{waited}\" \
             waitingCount=\"1\" timeLoss=\"{waited}\" departDelay=\"0\"/></tripinfos>"
        );
        let trips = TripTotals::parse(text.as_bytes(), Path::new("t.xml")).unwrap();
        EpisodeMetrics::new(seed, &SecondMeter::default(), &trips, -waited)
    }

    pub(in crate::evaluate) fn report(scenario: &str, policy: &str, delays: &[f64]) -> EvalReport {
        let mut episodes: Vec<_> = (1..).zip(delays).map(|(seed, &waited)| episode(seed, waited)).collect();
        // They arrive in whatever order the threads finish.
        episodes.reverse();
        EvalReport::new(scenario.to_owned(), policy.to_owned(), policy.to_owned(), protocol(), episodes)
    }

    #[test]
    fn summarises_over_seeds_in_seed_order() {
        let report = report("grid4x4", "fixed-time", &[10.0, 20.0, 30.0]);
        assert_eq!(report.seeds, [1, 2, 3]);
        let delay = report.get(Metric::TripDelay);
        assert_eq!((delay.mean, delay.std), (20.0, 0.0));
        assert!((delay.std_between_seeds - 10.0).abs() < 1e-9);
        assert_eq!(report.per_seed[2].get(Metric::TripDelay).mean, 30.0);
        assert_eq!(report.vehicles.finished, 1.0);
        assert_eq!(report.episode_return, -20.0);
    }

    #[test]
    fn one_seed_has_no_spread_between_seeds() {
        assert_eq!(report("s", "p", &[10.0]).get(Metric::TripDelay).std_between_seeds, 0.0);
    }

    #[test]
    fn the_strongest_has_the_lowest_delay() {
        let reports =
            [report("s", "a", &[5.0, 9.0]), report("s", "b", &[6.0, 7.0]), report("s", "c", &[8.0])];
        assert_eq!(strongest(&reports).unwrap().policy, "b");
        assert_eq!(strongest(&[]), None);
    }

    #[test]
    fn json_has_the_documented_members() {
        let json: serde_json::Value =
            serde_json::from_str(&report("grid4x4", "greedy", &[1.0, 2.0]).to_json()).unwrap();
        assert_eq!(json["scenario"], "grid4x4");
        assert_eq!(json["policy"], "greedy");
        assert_eq!(json["seeds"], serde_json::json!([1, 2]));
        for metric in Metric::PAPER {
            assert!(json["metrics"][metric.key()]["mean"].is_number(), "{}", metric.key());
            assert!(json["metrics"][metric.key()]["std"].is_number(), "{}", metric.key());
        }
        assert_eq!(json["protocol"]["sumo_version"], "1.28.0");
        assert_eq!(json["protocol"]["detection"], "default");
        assert_eq!(json["per_seed"][1]["seed"], 2);
        assert_eq!(json["per_seed"][1]["metrics"]["trip_delay"]["mean"], 2.0);
    }
}
