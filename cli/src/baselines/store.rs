//! Finished episodes on disk, one file each, so that nothing is simulated twice.
//!
//! `DIR/SCENARIO/POLICY/seed-N.json` appears whole or not at all. It tells what it was made with, and counts only where that
//! is still so: another net, demand, SUMO, setting, version of this program or generation of its figures makes another episode.

use crate::failure::{Failure, Outcome};
use crate::output_file::OutputFile;
use crate::policy::PolicySpec;
use crate::routing::EpisodeRouting;
use crate::train::run_dir::write_atomically;
use anyhow::Context;
use cross_config::EnvConfig;
use cross_sim::evaluate::{EvalReport, Series};
use cross_sim::metrics::{MeanStd, Metric};
use cross_sim::scenario::{Scenario, SumoOptions};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Generation of the figures. Raise it with every change to the environment, the rules or the metrics after which an episode
/// may have other figures; then nothing that is stored counts any more.
const GENERATION: u32 = 2;

/// Everything that an episode's result depends on, but for the processor's vector instructions: with others a policy's sums
/// round otherwise, which moves a figure within what seeds differ by. A folder is not meant to be carried between machines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Made {
    generation: u32,
    cross: String,
    sumo: String,
    net: String,
    demand: String,
    begin: u32,
    sumo_options: SumoOptions,
    env: EnvConfig,
    scenario: String,
    policy: String,
    seed: u32,
}

impl Made {
    pub(crate) fn new(
        scenario: &Scenario,
        env: &EnvConfig,
        sumo_version: &str,
        policy: &PolicySpec,
        seed: u32,
    ) -> Self {
        Self {
            generation: GENERATION,
            cross: env!("CARGO_PKG_VERSION").to_owned(),
            sumo: sumo_version.to_owned(),
            net: scenario.net_hash.clone(),
            demand: scenario.demand_hash.clone(),
            begin: scenario.begin,
            sumo_options: scenario.sumo.clone(),
            env: env.clone(),
            scenario: scenario.name.clone(),
            policy: policy.key(),
            seed,
        }
    }
}

/// What an episode amounted to, as far as the table needs it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(crate) struct Episode {
    pub(crate) seed: u32,
    /// By [`Metric::key`].
    pub(crate) metrics: BTreeMap<String, MeanStd>,
    /// Counts by what became of the vehicles.
    pub(crate) vehicles: BTreeMap<String, f64>,
    pub(crate) gridlock: bool,
}

/// How an episode went, for a picture of it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(crate) struct Course {
    /// Queue and speed over time.
    pub(crate) series: Series,
    /// Experts and clusters; a rule has none.
    pub(crate) routing: EpisodeRouting,
}

#[derive(Deserialize)]
struct Stored {
    made: Made,
    /// As `cross eval --json` has it, so that `cross report` reads the folder.
    evaluation: [Evaluation; 1],
    /// Not in what this program once wrote.
    #[serde(flatten)]
    course: Option<Course>,
}

#[derive(Deserialize)]
struct Evaluation {
    per_seed: [Episode; 1],
}

/// The folder of results.
#[derive(Debug)]
pub(crate) struct Store {
    folder: PathBuf,
    /// Whether only those episodes count of which is known how they went.
    with_courses: bool,
}

impl Store {
    pub(crate) fn new(folder: PathBuf) -> Self {
        Self { folder, with_courses: false }
    }

    /// The store in a folder, which is made if it is not there and has to be one that can be written to.
    pub(crate) fn open(folder: &Path) -> Outcome<Self> {
        std::fs::create_dir_all(folder).map_err(|error| {
            Failure::input(format!(
                "cannot create {}: {error}; name another folder with --out",
                folder.display()
            ))
        })?;
        OutputFile::prepare(&folder.join("seed-1.json"))?;
        Ok(Self::new(folder.to_owned()))
    }

    /// The same store for whoever draws: an episode of which is not known how it went counts as not there.
    pub(crate) fn with_courses(self) -> Self {
        Self { with_courses: true, ..self }
    }

    /// The folder's path.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The episode that was made exactly so, if it is there and has every metric of today.
    ///
    /// A file that cannot be read counts as not there: the episode is simulated again and the file replaced.
    pub(crate) fn load(&self, made: &Made) -> Option<Episode> {
        let Stored { evaluation: [Evaluation { per_seed: [episode] }], .. } = self.read(made)?;
        Some(episode)
    }

    /// How the episode went that was made exactly so, if [`Store::load`] would find it.
    pub(crate) fn course(&self, made: &Made) -> Option<Course> {
        self.read(made)?.course
    }

    fn read(&self, made: &Made) -> Option<Stored> {
        let text = std::fs::read(self.path(made)).ok()?;
        let stored: Stored = serde_json::from_slice(&text).ok()?;
        let [Evaluation { per_seed: [episode] }] = &stored.evaluation;
        let complete = Metric::ALL.iter().all(|metric| episode.metrics.contains_key(metric.key()))
            && (stored.course.is_some() || !self.with_courses);
        (stored.made == *made && complete).then_some(stored)
    }

    /// Keeps the report of a single episode, and of its details the curves: every trip would be most of the folder.
    pub(crate) fn save(&self, made: &Made, mut report: EvalReport, routing: &EpisodeRouting) -> Outcome<()> {
        let details = report.details.take().into_iter();
        let series = details.flat_map(|details| details.seeds).map(|seed| seed.series).next();
        let series = series.ok_or_else(|| {
            Failure::failed("an evaluation that was asked for curves has none; this is a defect of cross")
        })?;
        let document = serde_json::json!({
            "made": made, "evaluation": [report], "series": series, "routing": routing,
        });
        self.write(made, &document)
    }

    fn write(&self, made: &Made, document: &Value) -> Outcome<()> {
        let path = self.path(made);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).with_context(|| {
                format!("cannot create {}; name another folder with --out", folder.display())
            })?;
        }
        write_atomically(&path, format!("{document:#}\n").as_bytes())
    }

    fn path(&self, made: &Made) -> PathBuf {
        self.folder
            .join(plain(&made.scenario))
            .join(plain(&made.policy))
            .join(format!("seed-{}.json", made.seed))
    }
}

/// A name as a folder's: whatever a user calls a scenario, it stays inside the store.
pub(super) fn plain(name: &str) -> String {
    let letter =
        |letter: char| if letter.is_ascii_alphanumeric() || "-_".contains(letter) { letter } else { '_' };
    name.chars().map(letter).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use cross_sim::controller::RuleBased;

    fn made(policy: RuleBased, seed: u32) -> Made {
        Made {
            generation: GENERATION,
            cross: "1".to_owned(),
            sumo: "1.28.0".to_owned(),
            net: "aa".to_owned(),
            demand: "bb".to_owned(),
            begin: 0,
            sumo_options: SumoOptions::default(),
            env: EnvConfig::default(),
            scenario: "../a b".to_owned(),
            policy: policy.name().to_owned(),
            seed,
        }
    }

    /// An episode in which every metric has this mean.
    pub(in crate::baselines) fn episode(seed: u32, mean: f64) -> Episode {
        let value = MeanStd { mean, std: mean / 2.0 };
        Episode {
            seed,
            metrics: Metric::ALL.iter().map(|metric| (metric.key().to_owned(), value)).collect(),
            vehicles: [("finished".to_owned(), 10.0), ("unfinished".to_owned(), 1.0)].into(),
            gridlock: false,
        }
    }

    /// How the episode of a learned policy with two experts went.
    pub(in crate::baselines) fn course() -> Course {
        let shares = |shares: [f64; 2]| crate::routing::Shares {
            over_time: vec![shares.to_vec(); 2],
            by_agent: vec![shares.to_vec(); 3],
        };
        Course {
            series: Series {
                interval_seconds: 10,
                queue_length: vec![0.5, 1.5, 1.0],
                speed: vec![9.0, 8.0, 7.0],
                ..Series::default()
            },
            routing: EpisodeRouting { experts: shares([0.25, 0.75]), clusters: shares([0.5, 0.5]) },
        }
    }

    fn document(made: &Made, episode: &Episode) -> Value {
        serde_json::json!({ "made": made, "evaluation": [{ "whatever": [1, 2], "per_seed": [{
            "seed": episode.seed, "metrics": episode.metrics, "vehicles": episode.vehicles, "gridlock": episode.gridlock,
        }]}], "series": course().series, "routing": course().routing })
    }

    #[test]
    fn an_episode_counts_only_for_what_it_was_made_with() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path().join("new"));
        let made = made(RuleBased::FixedTime, 3);
        assert_eq!(store.load(&made), None);
        let episode = episode(3, 2.0);
        store.write(&made, &document(&made, &episode)).unwrap();
        assert_eq!(store.load(&made), Some(episode));
        assert_eq!(store.course(&made), Some(course()));
        for other in [
            Made { seed: 4, ..made.clone() },
            Made { generation: GENERATION + 1, ..made.clone() },
            Made { sumo: "1.29.0".to_owned(), ..made.clone() },
            Made { net: "ab".to_owned(), ..made.clone() },
            Made { env: EnvConfig { yellow_seconds: 4, ..EnvConfig::default() }, ..made },
        ] {
            assert_eq!(store.load(&other), None, "{other:?}");
        }
        // Whatever the scenario is called, its files are in the store.
        assert!(folder.path().join("new/___a_b/fixed-time/seed-3.json").is_file());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_is_damaged_or_lacks_a_metric_is_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path().to_owned());
        let made = made(RuleBased::Greedy, 1);
        let mut without = episode(1, 2.0);
        without.metrics.remove(Metric::TripDelay.key());
        store.write(&made, &document(&made, &without)).unwrap();
        assert_eq!(store.load(&made), None);
        std::fs::write(store.path(&made), "{\"made\":").unwrap();
        assert_eq!(store.load(&made), None);
        // As this program once wrote them: enough for a table, not for a picture.
        let mut without = document(&made, &episode(1, 2.0));
        without.as_object_mut().unwrap().remove("series");
        store.write(&made, &without).unwrap();
        assert_eq!((store.load(&made), store.course(&made)), (Some(episode(1, 2.0)), None));
        assert_eq!(store.with_courses().load(&made), None);
    }
}
