//! What an actor tells about itself: Prometheus metrics and readiness.
//!
//! The recorder belongs to the actor, not to the process, so that tests can run several actors in one.

use metrics::{
    Counter, Gauge, Histogram, counter, describe_counter, describe_gauge, describe_histogram, gauge,
    histogram,
};
use metrics::{Unit, with_local_recorder};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle, PrometheusRecorder};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Upper bounds of the step-time histogram, seconds: from a small forward pass to a SUMO that is about to time out.
const SECONDS: [f64; 14] =
    [1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 2.5e-2, 5e-2, 0.1, 0.25, 1.0, 5.0, 30.0];

/// Why steps were simulated in vain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dropped {
    /// Made for a session of the learner that is over.
    OldSession,
    /// Older than the policy-lag limit.
    Stale,
    /// The learner did not know the episode.
    UnknownEpisode,
    /// The learner found fault with it.
    Refused,
    /// Unfinished when its episode was given up.
    Aborted,
    /// Not acknowledged in time when the actor stopped.
    Shutdown,
}

impl Dropped {
    const ALL: [Self; 6] =
        [Self::OldSession, Self::Stale, Self::UnknownEpisode, Self::Refused, Self::Aborted, Self::Shutdown];

    fn label(self) -> &'static str {
        match self {
            Self::OldSession => "old_session",
            Self::Stale => "stale",
            Self::UnknownEpisode => "unknown_episode",
            Self::Refused => "refused",
            Self::Aborted => "aborted",
            Self::Shutdown => "shutdown",
        }
    }
}

/// How an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// At its last step.
    Completed,
    /// The actor cannot go on.
    Failed,
    /// The actor was told to stop.
    Shutdown,
    /// The learner's session ended.
    SessionChanged,
    /// The learner did not know it.
    UnknownEpisode,
    /// SUMO ended or its connection broke.
    SumoCrashed,
    /// SUMO did not answer in time.
    SumoTimeout,
}

impl Outcome {
    const ALL: [Self; 7] = [
        Self::Completed,
        Self::Failed,
        Self::Shutdown,
        Self::SessionChanged,
        Self::UnknownEpisode,
        Self::SumoCrashed,
        Self::SumoTimeout,
    ];

    /// The label's value.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Failed => "failed",
            Self::Shutdown => "shutdown",
            Self::SessionChanged => "session_changed",
            Self::UnknownEpisode => "unknown_episode",
            Self::SumoCrashed => "sumo_crashed",
            Self::SumoTimeout => "sumo_timeout",
        }
    }
}

/// All metrics of one actor.
pub struct Telemetry {
    recorder: PrometheusRecorder,
    handle: PrometheusHandle,
    connected: AtomicBool,
    acting: AtomicBool,
    fixed: Fixed,
}

/// Handles of the metrics without labels, or with labels known in advance.
struct Fixed {
    step_sumo: Histogram,
    step_traci: Histogram,
    step_policy: Histogram,
    step_uplink: Histogram,
    policy_version: Gauge,
    unacked: Gauge,
    connected: Gauge,
    reconnects: Counter,
    snapshots: Counter,
    snapshots_damaged: Counter,
}

impl std::fmt::Debug for Telemetry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Telemetry").finish_non_exhaustive()
    }
}

/// How long the parts of one step took.
#[derive(Debug, Clone, Copy, Default)]
pub struct StepTimes {
    /// Waiting for SUMO to simulate; while the actor does something else, it does not wait.
    pub sumo: Duration,
    /// Talking to it.
    pub traci: Duration,
    /// The policy: its forward pass, and the critic's state on the way past SUMO.
    pub policy: Duration,
}

impl Telemetry {
    /// A fresh set of metrics, all known labels at zero.
    ///
    /// # Errors
    /// None in practice: the histogram's bounds, which are not empty, are all that is checked.
    pub fn new() -> Result<Self, metrics_exporter_prometheus::BuildError> {
        let recorder = PrometheusBuilder::new()
            .set_buckets_for_metric(Matcher::Full("cross_actor_step_seconds".to_owned()), &SECONDS)?
            .build_recorder();
        let handle = recorder.handle();
        let fixed = with_local_recorder(&recorder, || {
            describe();
            gauge!(
                "cross_build_info",
                "program" => "cross-actor",
                "version" => env!("CARGO_PKG_VERSION"),
                "libtorch" => cross_model::libtorch_version(),
                "protocol" => cross_proto::PROTOCOL_VERSION.to_string()
            )
            .set(1.0);
            for dropped in Dropped::ALL {
                counter!("cross_actor_fragments_dropped_total", "reason" => dropped.label()).absolute(0);
            }
            for kind in cross_traci::ErrorKind::ALL {
                counter!("cross_actor_sumo_restarts_total", "reason" => kind.as_str()).absolute(0);
            }
            let step = |part| histogram!("cross_actor_step_seconds", "part" => part);
            Fixed {
                step_sumo: step("sumo"),
                step_traci: step("traci"),
                step_policy: step("policy"),
                step_uplink: step("uplink"),
                policy_version: gauge!("cross_actor_policy_version"),
                unacked: gauge!("cross_actor_unacked_fragments"),
                connected: gauge!("cross_actor_connected"),
                reconnects: counter!("cross_actor_reconnects_total"),
                snapshots: counter!("cross_actor_snapshots_total", "outcome" => "received"),
                snapshots_damaged: counter!("cross_actor_snapshots_total", "outcome" => "damaged"),
            }
        });
        let (connected, acting) = (AtomicBool::new(false), AtomicBool::new(false));
        Ok(Self { recorder, handle, connected, acting, fixed })
    }

    /// Text in Prometheus' exposition format.
    #[must_use]
    pub fn render(&self) -> String {
        self.handle.render()
    }

    /// Folds what histograms have collected; to be called every few seconds, or they grow between scrapes.
    pub fn upkeep(&self) {
        self.handle.run_upkeep();
    }

    /// True while there is a learner and a policy to act with.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.connected.load(Ordering::Relaxed) && self.acting.load(Ordering::Relaxed)
    }

    /// A fragment stream is open.
    pub fn connected(&self) {
        self.connected.store(true, Ordering::Relaxed);
        self.fixed.connected.set(1.0);
    }

    /// No fragment stream is open.
    pub fn disconnected(&self) {
        self.connected.store(false, Ordering::Relaxed);
        self.fixed.connected.set(0.0);
    }

    /// Another connection will be tried.
    pub fn reconnect(&self) {
        self.fixed.reconnects.increment(1);
    }

    /// A snapshot is complete.
    pub fn snapshot_received(&self) {
        self.fixed.snapshots.increment(1);
    }

    /// A snapshot came damaged.
    pub fn snapshot_damaged(&self) {
        self.fixed.snapshots_damaged.increment(1);
    }

    /// The policy that acts from now on.
    pub fn acting(&self, policy_version: u64) {
        self.acting.store(true, Ordering::Relaxed);
        self.fixed.policy_version.set(policy_version as f64);
    }

    /// Fragments that are not acknowledged now.
    pub fn unacked(&self, fragments: usize) {
        self.fixed.unacked.set(fragments as f64);
    }

    /// Fragments that nobody will learn from.
    pub fn dropped(&self, why: Dropped, fragments: usize) {
        with_local_recorder(&self.recorder, || {
            counter!("cross_actor_fragments_dropped_total", "reason" => why.label())
                .increment(fragments as u64);
        });
    }

    /// One step.
    pub fn step(&self, times: StepTimes) {
        self.fixed.step_sumo.record(times.sumo);
        self.fixed.step_traci.record(times.traci);
        self.fixed.step_policy.record(times.policy);
    }

    /// Time for which the simulator waited to hand over a fragment.
    pub fn uplink(&self, waited: Duration) {
        self.fixed.step_uplink.record(waited);
    }

    /// SUMO failed and is started anew.
    pub fn sumo_restart(&self, reason: &'static str) {
        with_local_recorder(&self.recorder, || {
            counter!("cross_actor_sumo_restarts_total", "reason" => reason).increment(1);
        });
    }

    /// The scenarios of the run: their counters exist from now on, and keep what they have counted.
    pub fn scenarios<'a>(&self, names: impl Iterator<Item = &'a String>) {
        for name in names {
            self.decisions(name).increment(0);
            for outcome in Outcome::ALL {
                self.episodes(name, outcome).increment(0);
            }
        }
    }

    /// An episode ended.
    pub fn episode(&self, scenario: &str, outcome: Outcome) {
        self.episodes(scenario, outcome).increment(1);
    }

    fn episodes(&self, scenario: &str, outcome: Outcome) -> Counter {
        with_local_recorder(
            &self.recorder,
            || counter!("cross_actor_episodes_total", "scenario" => scenario.to_owned(), "outcome" => outcome.label()),
        )
    }

    /// Counts agent-decisions simulated.
    pub fn decisions(&self, scenario: &str) -> Counter {
        with_local_recorder(
            &self.recorder,
            || counter!("cross_actor_decisions_total", "scenario" => scenario.to_owned()),
        )
    }

    /// What a finished episode came to. The gauges do not exist before the first: 0 would be the best return there is.
    ///
    /// `episode_return` is the summed raw reward, mean over agents; `queue_length` the stopped vehicles per
    /// incoming lane as the reward counts them (beyond its range by `env.reward_beyond`), mean over the decisions.
    pub fn finished(&self, scenario: &str, episode_return: f64, queue_length: f64) {
        with_local_recorder(&self.recorder, || {
            gauge!("cross_actor_episode_return", "scenario" => scenario.to_owned()).set(episode_return);
            gauge!("cross_actor_queue_length_vehicles", "scenario" => scenario.to_owned()).set(queue_length);
        });
    }
}

fn describe() {
    describe_gauge!("cross_build_info", "1, with the versions of this process as labels");
    describe_counter!("cross_actor_decisions_total", "Agent-decisions simulated");
    describe_counter!("cross_actor_episodes_total", "Episodes by how they ended");
    describe_gauge!(
        "cross_actor_episode_return",
        "Summed raw reward of the newest finished episode, mean over agents"
    );
    describe_gauge!(
        "cross_actor_queue_length_vehicles",
        "Stopped vehicles per incoming lane as the reward counts them, mean over the newest finished episode"
    );
    describe_counter!("cross_actor_sumo_restarts_total", "SUMO processes replaced after a failure");
    describe_histogram!("cross_actor_step_seconds", Unit::Seconds, "Time of one decision step by part");
    describe_gauge!("cross_actor_policy_version", "Policy version that acts");
    describe_gauge!("cross_actor_unacked_fragments", "Fragments sent or waiting, not acknowledged");
    describe_counter!("cross_actor_fragments_dropped_total", "Fragments that nobody will learn from");
    describe_gauge!("cross_actor_connected", "1 while a fragment stream is open");
    describe_counter!("cross_actor_reconnects_total", "Connections to the learner lost or not made");
    describe_counter!("cross_actor_snapshots_total", "Weight snapshots by outcome");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_actors_in_one_process_count_apart() {
        let (one, other) = (Telemetry::new().unwrap(), Telemetry::new().unwrap());
        one.decisions("grid").increment(16);
        one.dropped(Dropped::Stale, 2);
        let text = one.render();
        assert!(text.contains("cross_actor_decisions_total{scenario=\"grid\"} 16"), "{text}");
        assert!(text.contains("cross_actor_fragments_dropped_total{reason=\"stale\"} 2"), "{text}");
        assert!(other.render().contains("cross_actor_fragments_dropped_total{reason=\"stale\"} 0"));
    }

    #[test]
    fn a_scenario_has_counters_from_the_start_and_gauges_from_its_first_finished_episode() {
        let telemetry = Telemetry::new().unwrap();
        let names = ["grid".to_owned()];
        telemetry.scenarios(names.iter());
        telemetry.episode("grid", Outcome::Completed);
        // Joined again: nothing is forgotten.
        telemetry.scenarios(names.iter());
        let text = telemetry.render();
        for outcome in Outcome::ALL {
            let count = u32::from(outcome == Outcome::Completed);
            let label = outcome.label();
            let line =
                format!("cross_actor_episodes_total{{scenario=\"grid\",outcome=\"{label}\"}} {count}\n");
            assert!(text.contains(&line), "{line} is not in {text}");
        }
        assert!(text.contains("cross_actor_decisions_total{scenario=\"grid\"} 0"), "{text}");
        assert!(!text.contains("cross_actor_episode_return{"), "{text}");
        assert!(!text.contains("cross_actor_queue_length_vehicles{"), "{text}");
        telemetry.finished("grid", -2.5, 0.5);
        let text = telemetry.render();
        assert!(text.contains("cross_actor_episode_return{scenario=\"grid\"} -2.5"), "{text}");
        assert!(text.contains("cross_actor_queue_length_vehicles{scenario=\"grid\"} 0.5"), "{text}");
    }

    #[test]
    fn the_build_is_labelled_like_the_learners() {
        let text = Telemetry::new().unwrap().render();
        let line = text.lines().find(|line| line.starts_with("cross_build_info{")).unwrap();
        for label in ["program=\"cross-actor\"", "version=", "libtorch=", "protocol="] {
            assert!(line.contains(label), "{label} is not in {line}");
        }
    }

    #[test]
    fn step_times_are_histograms_by_part() {
        let telemetry = Telemetry::new().unwrap();
        telemetry.step(StepTimes { sumo: Duration::from_millis(20), ..StepTimes::default() });
        telemetry.uplink(Duration::from_millis(1));
        let text = telemetry.render();
        for part in ["sumo", "traci", "policy", "uplink"] {
            assert!(text.contains(&format!("cross_actor_step_seconds_count{{part=\"{part}\"}} 1")), "{text}");
        }
        assert!(text.contains("cross_actor_step_seconds_bucket{part=\"sumo\",le=\"0.01\"} 0"), "{text}");
    }

    #[test]
    fn ready_means_connected_and_acting() {
        let telemetry = Telemetry::new().unwrap();
        telemetry.connected();
        assert!(!telemetry.is_ready());
        telemetry.acting(3);
        assert!(telemetry.is_ready());
        telemetry.disconnected();
        assert!(!telemetry.is_ready());
    }
}
