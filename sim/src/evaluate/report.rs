//! What an evaluation found, as one JSON document.

use super::details::Details;
use super::{Setting, format::Format};
use crate::controller::RuleBased;
use crate::layout::NetworkLayout;
use crate::metrics::keyed::{self, Keyed};
use crate::metrics::{EpisodeMetrics, Metric, Moments};
use cross_config::Detection;
use serde::{Deserialize, Serialize};

/// Everything besides the policy and the seeds on which the numbers depend.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Protocol {
    /// Whose protocol it is: a [preset](crate::preset::Preset)'s name, or `custom`.
    pub preset: String,
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
    /// What a vehicle that is stopped beyond that counts; documents of earlier versions are of 0.
    #[serde(default)]
    pub reward_beyond: f32,
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
            preset: crate::preset::name_of(env).to_owned(),
            interval_seconds: env.decision_seconds,
            yellow_seconds: env.yellow_seconds,
            begin_seconds: scenario.begin,
            episode_seconds: env.episode_seconds,
            detection: env.detection,
            reward_range_metres: env.reward_range_metres,
            reward_beyond: env.reward_beyond,
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
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SeedSummary {
    /// Mean of the episodes' means.
    pub mean: f64,
    /// Mean of the episodes' deviations: the spread inside an episode, over its seconds or vehicles, as papers print it.
    pub std: f64,
    /// Deviation of the episodes' means from each other, n-1 in the denominator; 0 for one seed.
    pub std_between_seeds: f64,
}

/// Mean number of vehicles of an episode, by what became of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
///
/// It reads back what it wrote. Members that this version does not know are passed over; a missing one is an error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    format: Format,
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
    #[serde(with = "keyed")]
    metrics: Keyed<SeedSummary>,
    /// Vehicles by what became of them, means over the seeds.
    pub vehicles: MeanVehicles,
    /// Mean over seeds of [`EpisodeMetrics::episode_return`].
    pub episode_return: f64,
    /// Seeds whose traffic came to rest before the end.
    pub gridlocked_seeds: Vec<u32>,
    /// The episodes, in the order of the seeds.
    pub per_seed: Vec<EpisodeMetrics>,
    /// What a report page draws, if it was asked for: [`Setting::details`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub details: Option<Details>,
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
            format: Format,
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
            details: None,
        }
    }

    /// The same report with details, whose seeds are put in order.
    #[must_use]
    pub fn with_details(self, mut details: Details) -> Self {
        details.seeds.sort_by_key(|seed| seed.seed);
        Self { details: Some(details), ..self }
    }

    /// Joins reports of different seeds of one policy on one scenario to one report of all of them; `None` without any.
    /// What seeds have in common is taken from the first. There are details only if all reports have some.
    #[must_use]
    pub fn join(reports: impl IntoIterator<Item = Self>) -> Option<Self> {
        let mut reports = reports.into_iter();
        let Self { scenario, policy, controller, protocol, mut per_seed, mut details, .. } =
            reports.next()?;
        for report in reports {
            per_seed.extend(report.per_seed);
            details = match (details, report.details) {
                (Some(mut details), Some(more)) => {
                    details.seeds.extend(more.seeds);
                    Some(details)
                }
                _ => None,
            };
        }
        let joined = Self::new(scenario, policy, controller, protocol, per_seed);
        Some(match details {
            Some(details) => joined.with_details(details),
            None => joined,
        })
    }

    /// Reads a document that [`to_json`](Self::to_json) wrote.
    ///
    /// # Errors
    /// What is missing or wrong, and where.
    pub fn from_json(text: &str) -> Result<Self, serde_json::Error> {
        serde_json::from_str(text)
    }

    /// Whether a program inside SUMO controlled the signals; interval and yellow of the protocol then steered nothing.
    #[must_use]
    pub fn signals_by_sumo(&self) -> bool {
        self.controller.parse::<RuleBased>().is_ok_and(RuleBased::is_sumos_program)
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::evaluate::details::{NetworkDrawing, SeedDetails, Series, Trips};
    use crate::metrics::{SecondMeter, TripTotals};
    use std::path::Path;

    fn protocol() -> Protocol {
        Protocol {
            preset: "paper".to_owned(),
            interval_seconds: 10,
            yellow_seconds: 3,
            begin_seconds: 0,
            episode_seconds: 3600,
            detection: Detection::Default,
            reward_range_metres: 50.0,
            reward_beyond: 0.0,
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

    fn details(seeds: &[u32]) -> Details {
        let of = |&seed: &u32| SeedDetails {
            seed,
            series: Series { interval_seconds: 10, speed: vec![0.1 + 0.2, 1.0 / 3.0], ..Series::default() },
            trips: Trips { never_inserted: vec![f64::from(seed)], ..Trips::default() },
            intersections: Vec::new(),
        };
        Details { network: NetworkDrawing::default(), seeds: seeds.iter().map(of).collect() }
    }

    #[test]
    fn a_report_reads_back_the_same_with_and_without_details() {
        let plain = report("grid4x4", "greedy", &[1.0, 2.0 / 3.0]);
        let detailed = plain.clone().with_details(details(&[2, 1]));
        for report in [plain, detailed] {
            let json = report.to_json();
            let read = EvalReport::from_json(&json).unwrap();
            assert_eq!(read, report);
            assert_eq!(read.to_json(), json);
            assert_eq!(json.contains("\"details\""), report.details.is_some());
        }
    }

    #[test]
    fn what_a_newer_version_adds_is_passed_over_and_what_is_missing_is_named() {
        let report = report("grid4x4", "greedy", &[1.0]);
        let json = report.to_json();
        let newer = json.replace("\"policy\":", "\"noise\": {\"mean\": [1]}, \"policy\":");
        assert_eq!(EvalReport::from_json(&newer).unwrap(), report);
        for (from, to, words) in [
            ("\"format\": 1,", "\"format\": 2,", "format 2"),
            ("\"format\": 1,", "", "`format`"),
            ("\"net_hash\": \"aa\",", "", "`net_hash`"),
            ("\"trip_delay\":", "\"trip_decay\":", "`trip_delay`"),
            ("\"seeds\": [", "\"seeds\": [-1,", "-1"),
        ] {
            assert!(json.contains(from), "{from} in {json}");
            let error = EvalReport::from_json(&json.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn reports_of_single_seeds_join_to_one_of_all_seeds() {
        let whole = report("s", "p", &[10.0, 20.0, 30.0]);
        let single = |seed: usize| {
            let episodes = vec![whole.per_seed[seed].clone()];
            EvalReport::new("s".to_owned(), "p".to_owned(), "p".to_owned(), protocol(), episodes)
        };
        assert_eq!(EvalReport::join([single(2), single(0), single(1)]).unwrap(), whole);
        assert_eq!(EvalReport::join([]), None);
        let detailed = |seed: usize| single(seed).with_details(details(&[whole.seeds[seed]]));
        let joined = EvalReport::join([detailed(1), detailed(2), detailed(0)]).unwrap();
        assert_eq!(joined, whole.clone().with_details(details(&[1, 2, 3])));
        // Details of some seeds alone would pass for those of all.
        assert_eq!(EvalReport::join([detailed(0), single(1)]).unwrap().details, None);
    }
}
