//! One episode: observe, act, step, record, and hand over a fragment whenever one is full.

use crate::error::ActorError;
use crate::link::{Halt, Record, SimulatorEnd};
use crate::recorder::{EpisodeHeader, Recorder};
use crate::session::{Prepared, Session};
use crate::telemetry::{Dropped, StepTimes, Telemetry};
use cross_model::{ActMode, Decision, ModelError, Policy};
use cross_proto::v1;
use cross_sim::SimError;
use cross_sim::env::Env;
use cross_sim::trajectory::{Fragment, FragmentEnd};
use metrics::Counter;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::time::Instant;

/// Wire reason of an abort: SUMO ended or its connection broke.
pub(crate) const REASON_SUMO_CRASHED: &str = "SUMO_CRASHED";
/// Wire reason of an abort: SUMO did not answer in time.
pub(crate) const REASON_SUMO_TIMEOUT: &str = "SUMO_TIMEOUT";
/// Wire reason of an abort: the learner's session is not the one it was assigned in.
pub(crate) const REASON_SESSION_CHANGED: &str = "SESSION_CHANGED";
/// Wire reason of an abort: the actor ends.
pub(crate) const REASON_SHUTDOWN: &str = "SHUTDOWN";

/// Why an episode did not come to its end.
#[derive(Debug)]
pub(crate) enum Interrupted {
    /// Somebody else's decision.
    Halt(Halt),
    /// SUMO failed.
    Simulator(SimError),
    /// Nothing can be done about it.
    Fatal(ActorError),
}

impl From<Halt> for Interrupted {
    fn from(halt: Halt) -> Self {
        Self::Halt(halt)
    }
}

/// The behaviour policy, and which weights are in it.
#[derive(Debug, Default)]
pub(crate) struct Behaviour {
    policy: Option<Policy>,
    /// Session and version of the weights.
    installed: Option<(u64, u64)>,
}

impl Behaviour {
    /// Puts weights into the policy; the recurrent state stays.
    fn install(
        &mut self,
        session: &Session,
        snapshot: &cross_proto::weights::Snapshot,
        telemetry: &Telemetry,
    ) -> Result<&mut Policy, ActorError> {
        let version = snapshot.policy_version;
        let wanted = (session.epoch, version);
        let failed = |source: ModelError| ActorError::Policy { version, source };
        // Another session may bring another configuration, which replaced weights must not.
        let same_session = self.installed.is_some_and(|(epoch, _)| epoch == session.epoch);
        let policy = match self.policy.take() {
            Some(policy) if self.installed == Some(wanted) => policy,
            Some(mut policy) if same_session => {
                policy.replace_weights(&snapshot.bytes).map_err(failed)?;
                policy
            }
            _ => Policy::from_snapshot(&snapshot.bytes).map_err(failed)?,
        };
        if *policy.env() != session.config.env || *policy.config() != session.config.model {
            return Err(ActorError::ForeignPolicy { version });
        }
        self.installed = Some(wanted);
        telemetry.acting(version);
        Ok(self.policy.insert(policy))
    }
}

/// What an episode needs; lives as long as it does.
pub(crate) struct Episode<'a> {
    pub(crate) session: &'a Session,
    pub(crate) assignment: &'a v1::EpisodeAssignment,
    pub(crate) prepared: &'a Prepared,
    pub(crate) actor_id: &'a str,
    pub(crate) link: &'a mut SimulatorEnd,
    pub(crate) env: &'a mut Env,
    pub(crate) behaviour: &'a mut Behaviour,
    pub(crate) telemetry: &'a Telemetry,
}

impl Episode<'_> {
    /// Simulates the episode to its end and hands over its fragments.
    pub(crate) fn run(mut self) -> Result<(), Interrupted> {
        let header = EpisodeHeader {
            actor: self.actor_id.to_owned(),
            session_epoch: self.session.epoch,
            episode: self.assignment.episode,
            scenario: self.assignment.scenario.clone(),
            layout_hash: self.prepared.layout_hash.clone(),
        };
        let mut recorder = Recorder::new(header, self.session.fragment_steps);
        let result = self.record(&mut recorder);
        if result.is_err() && recorder.is_dirty() {
            self.telemetry.dropped(Dropped::Aborted, 1);
        }
        result
    }

    fn record(&mut self, recorder: &mut Recorder) -> Result<(), Interrupted> {
        let decisions = self.telemetry.decisions(&self.assignment.scenario);
        // Seeded for each episode: what is sampled depends on weights and seeds, not on which actor samples.
        let mut rng = ChaCha8Rng::seed_from_u64(self.assignment.action_seed);
        let layout = self.prepared.layout.as_ref();
        let snapshot = self.link.weights(self.session, self.assignment.min_policy_version)?;
        let version = snapshot.policy_version;
        let model_failed = |source| Interrupted::Fatal(ActorError::Policy { version, source });
        let policy =
            self.behaviour.install(self.session, &snapshot, self.telemetry).map_err(Interrupted::Fatal)?;
        policy.begin_episode(layout).map_err(model_failed)?;
        recorder.begin_fragment(version, policy.recurrent_state());
        self.env.reset(self.assignment.sumo_seed).map_err(Interrupted::Simulator)?;
        if let Some(reason) = self.env.take_replaced() {
            self.telemetry.sumo_restart(reason.as_str());
        }

        let mut reward_sum = 0.0;
        loop {
            self.link.check(self.session, self.assignment.episode)?;
            let (rewards, done) = self.step(recorder, &mut rng, &decisions)?;
            reward_sum += rewards;
            if !done && !recorder.is_full() {
                continue;
            }
            let end = if done { FragmentEnd::Truncated } else { FragmentEnd::Continues };
            let fragment = recorder.finish_fragment(self.env.observation(), end);
            self.hand_over(&fragment)?;
            if done {
                self.finished(reward_sum, recorder.steps());
                return Ok(());
            }
            // Between two fragments, so that each has one behaviour version.
            let snapshot = self.link.weights(self.session, 0)?;
            let policy = self
                .behaviour
                .install(self.session, &snapshot, self.telemetry)
                .map_err(Interrupted::Fatal)?;
            recorder.begin_fragment(snapshot.policy_version, policy.recurrent_state());
        }
    }

    /// One decision of every agent; gives the sum of rewards and whether the episode is over.
    fn step(
        &mut self,
        recorder: &mut Recorder,
        rng: &mut ChaCha8Rng,
        decisions: &Counter,
    ) -> Result<(f64, bool), Interrupted> {
        let started = Instant::now();
        let decision = self.decide(rng)?;
        let mut policy_time = started.elapsed();

        let before = self.env.timings();
        let step = self.env.begin_step(&decision.actions).map_err(Interrupted::Simulator)?;
        // What the next decision needs and this one did not, while SUMO simulates.
        recorder.decide(step.before(), &decision);
        let started = Instant::now();
        if let Some(policy) = self.behaviour.policy.as_mut() {
            policy.catch_up();
        }
        policy_time += started.elapsed();
        let step = step.complete().map_err(Interrupted::Simulator)?;
        let rewards = step.rewards.iter().map(|&r| f64::from(r)).sum();
        let done = step.done;
        recorder.reward(step.rewards);
        decisions.increment(decision.actions.len() as u64);

        let after = self.env.timings();
        self.telemetry.step(StepTimes {
            sumo: after.sumo.saturating_sub(before.sumo),
            traci: after.traci.saturating_sub(before.traci),
            policy: policy_time,
        });
        Ok((rewards, done))
    }

    fn decide(&mut self, rng: &mut ChaCha8Rng) -> Result<Decision, Interrupted> {
        let Some(policy) = self.behaviour.policy.as_mut() else {
            // Installed before the first step and never taken out; asking for weights again is all one could do.
            return Err(Interrupted::Halt(Halt::SessionChanged));
        };
        let version = policy.version();
        policy
            .act(self.env.observation(), ActMode::Sample(rng))
            .map_err(|source| Interrupted::Fatal(ActorError::Policy { version, source }))
    }

    fn hand_over(&mut self, fragment: &Fragment) -> Result<(), Interrupted> {
        let started = Instant::now();
        let (episode, sequence) = (fragment.id.episode, fragment.id.sequence);
        if let Err(halt) = self.link.send(self.session, Record::Fragment(Box::new(fragment.into()))) {
            self.telemetry.dropped(Dropped::Aborted, 1);
            return Err(halt.into());
        }
        if self.session.config.learner.serial {
            // Lock-step: which weights the next fragment acts on must not depend on who is quicker.
            self.link.acknowledged(self.session, episode, sequence)?;
        }
        self.telemetry.uplink(started.elapsed());
        Ok(())
    }

    fn finished(&self, reward_sum: f64, steps: u32) {
        let layout = &self.prepared.layout;
        let lanes: usize = layout.intersections.iter().map(|i| i.incoming.len()).sum();
        let episode_return = reward_sum / layout.agents().max(1) as f64;
        let queue_length = -reward_sum / (lanes.max(1) as f64 * f64::from(steps.max(1)));
        self.telemetry.finished(&self.assignment.scenario, episode_return, queue_length);
    }
}
