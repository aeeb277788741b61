//! Finished episodes on disk, one file each, so that nothing is simulated twice.
//!
//! `DIR/SCENARIO/POLICY/seed-N.json` appears whole or not at all. It tells what it was made with, and counts only where that
//! is still so: another net, demand, SUMO, setting, version of this program or generation of its figures makes another episode.

use crate::failure::{Failure, Outcome};
use crate::output_file::OutputFile;
use crate::policy::PolicySpec;
use crate::train::run_dir::write_atomically;
use anyhow::Context;
use cross_config::EnvConfig;
use cross_sim::evaluate::EvalReport;
use cross_sim::metrics::{MeanStd, Metric};
use cross_sim::scenario::{Scenario, SumoOptions};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Generation of the figures. Raise it with every change to the environment, the rules or the metrics after which an episode
/// may have other figures; then nothing that is stored counts any more.
const GENERATION: u32 = 1;

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

#[derive(Deserialize)]
struct Stored {
    made: Made,
    /// As `cross eval --json` has it, so that `cross report` reads the folder.
    evaluation: [Evaluation; 1],
}

#[derive(Deserialize)]
struct Evaluation {
    per_seed: [Episode; 1],
}

/// The folder of results.
#[derive(Debug)]
pub(crate) struct Store {
    folder: PathBuf,
}

impl Store {
    pub(crate) fn new(folder: PathBuf) -> Self {
        Self { folder }
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

    /// The folder's path.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The episode that was made exactly so, if it is there and has every metric of today.
    ///
    /// A file that cannot be read counts as not there: the episode is simulated again and the file replaced.
    pub(crate) fn load(&self, made: &Made) -> Option<Episode> {
        let text = std::fs::read(self.path(made)).ok()?;
        let Stored { made: found, evaluation: [Evaluation { per_seed: [episode] }] } =
            serde_json::from_slice(&text).ok()?;
        let complete = Metric::ALL.iter().all(|metric| episode.metrics.contains_key(metric.key()));
        (found == *made && complete).then_some(episode)
    }

    /// Keeps the report of a single episode.
    pub(crate) fn save(&self, made: &Made, report: &EvalReport) -> Outcome<()> {
        self.write(made, &serde_json::json!({ "made": made, "evaluation": [report] }))
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
fn plain(name: &str) -> String {
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

    fn document(made: &Made, episode: &Episode) -> Value {
        serde_json::json!({ "made": made, "evaluation": [{ "whatever": [1, 2], "per_seed": [{
            "seed": episode.seed, "metrics": episode.metrics, "vehicles": episode.vehicles, "gridlock": episode.gridlock,
        }]}]})
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
    }
}
