//! Prometheus metrics of one learner.
//!
//! The recorder belongs to the learner, not to the process, so that several can live in one test.

use crate::admission::{Admission, Dropped, Outcome};
use crate::checkpoint::remote::StoreTrouble;
use cross_model::{Placement, ScenarioStats, UpdateStats};
use metrics::{
    Counter, Gauge, Histogram, counter, describe_counter, describe_gauge, describe_histogram, gauge,
    histogram,
};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle, PrometheusRecorder};
use std::sync::Arc;

/// Upper bounds of the duration histograms, seconds.
const SECONDS: [f64; 14] = [0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 25.0, 50.0, 100.0, 250.0];

/// Every metric of the learner.
#[derive(Clone)]
pub struct Telemetry {
    /// Registers what is known only later: terms, experts, clusters.
    recorder: Arc<PrometheusRecorder>,
    handle: PrometheusHandle,
    updates: Counter,
    update_failures: Counter,
    checkpoint_failures: Counter,
    checkpoint_fallbacks: Counter,
    upload_failures: [(&'static str, Counter); StoreTrouble::LABELS.len()],
    log_failures: Counter,
    snapshots: Counter,
    policy_version: Gauge,
    lag: [Gauge; 3],
    actors: Gauge,
    update_seconds: Histogram,
    checkpoint_seconds: Histogram,
    upload_seconds: Histogram,
    /// Per scenario: offered by outcome, dropped by reason, buffered.
    scenarios: Arc<[ScenarioMetrics]>,
}

struct ScenarioMetrics {
    agents: u64,
    offered: [(Outcome, Counter); Outcome::ALL.len()],
    dropped: [(Dropped, Counter); Dropped::ALL.len()],
    episodes: Counter,
    buffered: Gauge,
}

impl std::fmt::Debug for Telemetry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Telemetry").finish_non_exhaustive()
    }
}

impl Telemetry {
    /// Registers everything at zero, so that a rate is defined from the first scrape on. Scenarios come with their agents.
    #[must_use]
    pub fn new(scenarios: &[(String, usize)]) -> Self {
        let mut builder = PrometheusBuilder::new();
        for name in [
            "cross_learner_update_seconds",
            "cross_learner_checkpoint_seconds",
            "cross_learner_checkpoint_upload_seconds",
        ] {
            // Fails only for an empty list of buckets.
            builder = match builder.set_buckets_for_metric(Matcher::Full(name.to_owned()), &SECONDS) {
                Ok(builder) => builder,
                Err(_) => PrometheusBuilder::new(),
            };
        }
        let recorder = Arc::new(builder.build_recorder());
        let handle = recorder.handle();
        metrics::with_local_recorder(&*recorder, || {
            describe();
            gauge!(
                "cross_build_info",
                "program" => "cross-learner",
                "version" => env!("CARGO_PKG_VERSION"),
                "libtorch" => cross_model::libtorch_version(),
                "protocol" => cross_proto::PROTOCOL_VERSION.to_string()
            )
            .set(1.0);
            let lag = |kind: &'static str| gauge!("cross_learner_policy_lag_versions", "statistic" => kind);
            Self {
                updates: counter!("cross_learner_updates_total"),
                update_failures: counter!("cross_learner_update_failures_total"),
                checkpoint_failures: counter!("cross_learner_checkpoint_failures_total"),
                checkpoint_fallbacks: counter!("cross_learner_checkpoint_fallbacks_total"),
                upload_failures: StoreTrouble::LABELS.map(|reason| {
                    (reason, counter!("cross_learner_checkpoint_upload_failures_total", "reason" => reason))
                }),
                log_failures: counter!("cross_learner_metrics_log_failures_total"),
                snapshots: counter!("cross_learner_snapshots_encoded_total"),
                policy_version: gauge!("cross_learner_policy_version"),
                lag: [lag("min"), lag("mean"), lag("max")],
                actors: gauge!("cross_learner_actors"),
                update_seconds: histogram!("cross_learner_update_seconds"),
                checkpoint_seconds: histogram!("cross_learner_checkpoint_seconds"),
                upload_seconds: histogram!("cross_learner_checkpoint_upload_seconds"),
                scenarios: scenarios
                    .iter()
                    .map(|(name, agents)| ScenarioMetrics::new(name, *agents))
                    .collect(),
                handle: handle.clone(),
                recorder: Arc::clone(&recorder),
            }
        })
    }

    /// The text that Prometheus scrapes.
    #[must_use]
    pub fn render(&self) -> String {
        self.handle.run_upkeep();
        self.handle.render()
    }

    /// An update is done.
    pub fn updated(&self, seconds: f64, stats: &UpdateStats) {
        self.updates.increment(1);
        self.update_seconds.record(seconds);
        metrics::with_local_recorder(&*self.recorder, || {
            for (term, value) in &stats.losses {
                gauge!("cross_learner_loss", "term" => term.clone()).set(*value);
            }
            for (name, value) in &stats.diagnostics {
                gauge!("cross_learner_diagnostic", "name" => name.clone()).set(*value);
            }
            for (expert, share) in stats.expert_usage.iter().enumerate() {
                gauge!("cross_expert_usage_ratio", "expert" => expert.to_string()).set(*share);
            }
            for (cluster, share) in stats.cluster_usage.iter().enumerate() {
                gauge!("cross_cluster_usage_ratio", "cluster" => cluster.to_string()).set(*share);
            }
            for (scenario, own) in &stats.scenarios {
                scenario_gauges(scenario, own);
            }
        });
    }

    /// Where updates are computed.
    pub fn placed(&self, placement: Placement) {
        metrics::with_local_recorder(&*self.recorder, || {
            gauge!(
                "cross_learner_device_info",
                "device" => placement.device_name(),
                "precision" => placement.precision_name()
            )
            .set(1.0);
        });
    }

    /// Weights were encoded, once for all who watch.
    pub fn encoded(&self) {
        self.snapshots.increment(1);
    }

    /// The version that is published from now on, `time` in seconds since 1970.
    pub fn published(&self, policy_version: u64, time: f64) {
        self.policy_version.set(policy_version as f64);
        metrics::with_local_recorder(&*self.recorder, || {
            gauge!("cross_learner_published_timestamp_seconds").set(time);
        });
    }

    /// How far a round's data was behind.
    pub fn lag(&self, lag: &crate::admission::Lag) {
        for (gauge, value) in self.lag.iter().zip([lag.min as f64, lag.mean, lag.max as f64]) {
            gauge.set(value);
        }
    }

    /// An update failed and its data is lost.
    pub fn update_failed(&self) {
        self.update_failures.increment(1);
    }

    /// A checkpoint was written.
    pub fn checkpointed(&self, seconds: f64) {
        self.checkpoint_seconds.record(seconds);
    }

    /// When the newest checkpoint on disk was written, seconds since 1970; one that is resumed from counts.
    pub fn checkpoint_from(&self, time: f64) {
        metrics::with_local_recorder(&*self.recorder, || {
            gauge!("cross_learner_checkpoint_timestamp_seconds").set(time);
        });
    }

    /// What the run directory's file system still takes.
    pub fn disk_available(&self, bytes: u64) {
        metrics::with_local_recorder(&*self.recorder, || {
            gauge!("cross_learner_disk_available_bytes").set(bytes as f64);
        });
    }

    /// A checkpoint could not be written.
    pub fn checkpoint_failed(&self) {
        self.checkpoint_failures.increment(1);
    }

    /// A checkpoint, written at this time (seconds since 1970), is whole in the object store.
    pub fn uploaded(&self, seconds: f64, written: f64) {
        self.upload_seconds.record(seconds);
        metrics::with_local_recorder(&*self.recorder, || {
            gauge!("cross_learner_checkpoint_uploaded_timestamp_seconds").set(written);
        });
    }

    /// The object store did not take a checkpoint, or did not answer.
    pub fn upload_failed(&self, reason: &str) {
        for (_, counter) in self.upload_failures.iter().filter(|(label, _)| *label == reason) {
            counter.increment(1);
        }
    }

    /// So many damaged checkpoints were passed over at the start.
    pub fn fell_back(&self, checkpoints: usize) {
        self.checkpoint_fallbacks.increment(checkpoints as u64);
    }

    /// A line of `metrics.jsonl` could not be written.
    pub fn log_failed(&self) {
        self.log_failures.increment(1);
    }

    /// Takes over the counters of admission.
    pub fn observe(&self, admission: &Admission) {
        self.actors.set(admission.actors() as f64);
        for (i, (scenario, settings)) in
            self.scenarios.iter().zip(&admission.settings().scenarios).enumerate()
        {
            for (outcome, counter) in &scenario.offered {
                counter.absolute(admission.offered(i, *outcome));
            }
            for (reason, counter) in &scenario.dropped {
                counter.absolute(admission.dropped(i, *reason));
            }
            if let Some(progress) = admission.progress().scenarios.get(&settings.name) {
                scenario.episodes.absolute(progress.episodes);
            }
            scenario.buffered.set((admission.buffered_steps(i) * scenario.agents) as f64);
        }
    }
}

impl ScenarioMetrics {
    fn new(name: &str, agents: usize) -> Self {
        let offered = Outcome::ALL.map(|outcome| {
            let labels = [("scenario", name.to_owned()), ("outcome", outcome.label().to_owned())];
            (outcome, counter!("cross_learner_fragments_total", &labels))
        });
        let dropped = Dropped::ALL.map(|reason| {
            let labels = [("scenario", name.to_owned()), ("reason", reason.label().to_owned())];
            (reason, counter!("cross_learner_dropped_fragments_total", &labels))
        });
        let scenario = [("scenario", name.to_owned())];
        Self {
            agents: agents as u64,
            offered,
            dropped,
            episodes: counter!("cross_learner_episodes_total", &scenario),
            buffered: gauge!("cross_learner_buffer_decisions", &scenario),
        }
    }
}

/// Names of their own, not a label more on the totals: a sum or a mean over the totals' series must not count twice.
fn scenario_gauges(scenario: &str, stats: &ScenarioStats) {
    let scenario = scenario.to_owned();
    for (name, value) in &stats.diagnostics {
        let labels = [("scenario", scenario.clone()), ("name", name.clone())];
        gauge!("cross_learner_scenario_diagnostic", &labels).set(*value);
    }
    for (expert, share) in stats.expert_usage.iter().enumerate() {
        let labels = [("scenario", scenario.clone()), ("expert", expert.to_string())];
        gauge!("cross_learner_expert_usage_ratio", &labels).set(*share);
    }
    for (cluster, share) in stats.cluster_usage.iter().enumerate() {
        let labels = [("scenario", scenario.clone()), ("cluster", cluster.to_string())];
        gauge!("cross_learner_cluster_usage_ratio", &labels).set(*share);
    }
}

fn describe() {
    describe_gauge!("cross_build_info", "What is running; always 1");
    describe_counter!("cross_learner_updates_total", "PPO updates done by this process");
    describe_counter!("cross_learner_update_failures_total", "Updates that gave no usable weights");
    describe_counter!("cross_learner_checkpoint_failures_total", "Checkpoints that could not be written");
    describe_counter!(
        "cross_learner_checkpoint_upload_failures_total",
        "Tries to copy a checkpoint to the object store that failed, by reason"
    );
    describe_histogram!(
        "cross_learner_checkpoint_upload_seconds",
        "Duration of copying a checkpoint to the object store"
    );
    describe_gauge!(
        "cross_learner_checkpoint_uploaded_timestamp_seconds",
        "When the newest checkpoint in the object store was written, seconds since 1970"
    );
    describe_counter!(
        "cross_learner_checkpoint_fallbacks_total",
        "Damaged checkpoints passed over when resuming"
    );
    describe_counter!(
        "cross_learner_metrics_log_failures_total",
        "Lines of metrics.jsonl that could not be written"
    );
    describe_gauge!(
        "cross_learner_published_timestamp_seconds",
        "When the newest version of the weights was published, seconds since 1970"
    );
    describe_counter!(
        "cross_learner_snapshots_encoded_total",
        "Snapshots encoded for publication, each once for all who watch"
    );
    describe_gauge!("cross_learner_policy_version", "Newest published version of the weights");
    describe_gauge!("cross_learner_policy_lag_versions", "Versions that the last round's data was behind");
    describe_gauge!("cross_learner_actors", "Actors with a lease");
    describe_histogram!("cross_learner_update_seconds", "Duration of an update");
    describe_histogram!("cross_learner_checkpoint_seconds", "Duration of writing a checkpoint");
    describe_counter!("cross_learner_fragments_total", "Fragments offered, by what became of them");
    describe_counter!(
        "cross_learner_dropped_fragments_total",
        "Fragments received and dropped later, by reason"
    );
    describe_counter!("cross_learner_episodes_total", "Episodes finished in the run");
    describe_gauge!("cross_learner_buffer_decisions", "Agent-decisions that wait for an update");
    describe_gauge!("cross_learner_loss", "Loss terms of the last update, before their weights");
    describe_gauge!("cross_learner_diagnostic", "Diagnostics of the last update");
    describe_gauge!(
        "cross_learner_checkpoint_timestamp_seconds",
        "When the newest checkpoint on disk was written, seconds since 1970"
    );
    describe_gauge!("cross_learner_disk_available_bytes", "Space left where the run directory is");
    describe_gauge!("cross_learner_device_info", "Where updates are computed; always 1");
    describe_gauge!("cross_learner_scenario_diagnostic", "Diagnostics of the last update, by scenario");
    describe_gauge!(
        "cross_learner_expert_usage_ratio",
        "Share of a scenario's gating weight that each expert has"
    );
    describe_gauge!("cross_learner_cluster_usage_ratio", "Mean assignment of a scenario to each cluster");
    describe_gauge!("cross_expert_usage_ratio", "Share of the gating weight of each expert, all scenarios");
    describe_gauge!("cross_cluster_usage_ratio", "Mean assignment to each cluster, all scenarios");
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn the_fixed_names_are_there() {
        let telemetry = Telemetry::new(&[("grid4x4".to_owned(), 16)]);
        let stats = UpdateStats {
            losses: BTreeMap::from([("actor_clip".to_owned(), 0.5)]),
            expert_usage: vec![0.5, 0.5],
            cluster_usage: vec![1.0],
            scenarios: BTreeMap::from([(
                "grid4x4".to_owned(),
                ScenarioStats {
                    diagnostics: BTreeMap::from([("approx_kl".to_owned(), 0.25)]),
                    expert_usage: vec![0.75, 0.25],
                    cluster_usage: vec![1.0],
                },
            )]),
            ..UpdateStats::default()
        };
        telemetry.placed(Placement::CPU);
        telemetry.updated(0.3, &stats);
        telemetry.encoded();
        telemetry.published(2, 1_750_000_001.25);
        telemetry.checkpointed(0.1);
        let before = telemetry.render();
        assert!(!before.contains("checkpoint_timestamp_seconds "), "no checkpoint has no time, not 1970");
        telemetry.checkpoint_from(1_750_000_000.5);
        telemetry.disk_available(1 << 30);
        let text = telemetry.render();
        // The labels that the actor gives it too, so that one query answers for both.
        let build = format!(
            "cross_build_info{{program=\"cross-learner\",version=\"{}\",libtorch=\"{}\",protocol=\"{}\"}} 1",
            env!("CARGO_PKG_VERSION"),
            cross_model::libtorch_version(),
            cross_proto::PROTOCOL_VERSION
        );
        for name in [
            &build,
            "cross_learner_updates_total 1",
            "cross_learner_policy_version 2",
            "cross_learner_snapshots_encoded_total 1",
            "cross_learner_published_timestamp_seconds 1750000001.25",
            "cross_learner_update_seconds_bucket{",
            "cross_learner_loss{term=\"actor_clip\"} 0.5",
            "cross_learner_fragments_total{scenario=\"grid4x4\",outcome=\"accepted\"} 0",
            "cross_learner_fragments_total{scenario=\"grid4x4\",outcome=\"stale\"} 0",
            "cross_learner_buffer_decisions{scenario=\"grid4x4\"}",
            "cross_learner_policy_lag_versions{",
            "cross_learner_actors ",
            "cross_learner_checkpoint_seconds_bucket{",
            "cross_expert_usage_ratio{expert=\"1\"} 0.5",
            "cross_cluster_usage_ratio{cluster=\"0\"} 1",
            "cross_learner_checkpoint_timestamp_seconds 1750000000.5",
            "cross_learner_disk_available_bytes 1073741824",
            "cross_learner_device_info{device=\"cpu\",precision=\"f32\"} 1",
            "cross_learner_scenario_diagnostic{scenario=\"grid4x4\",name=\"approx_kl\"} 0.25",
            "cross_learner_expert_usage_ratio{scenario=\"grid4x4\",expert=\"1\"} 0.25",
            "cross_learner_cluster_usage_ratio{scenario=\"grid4x4\",cluster=\"0\"} 1",
        ] {
            assert!(text.contains(name), "{name} is missing in:\n{text}");
        }
    }

    #[test]
    fn two_learners_in_one_process_do_not_share_numbers() {
        let (one, other) = (Telemetry::new(&[]), Telemetry::new(&[]));
        one.update_failed();
        assert!(one.render().contains("cross_learner_update_failures_total 1"));
        assert!(other.render().contains("cross_learner_update_failures_total 0"));
    }
}
