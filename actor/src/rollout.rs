//! The simulator thread: owns SUMO and the policy, simulates one episode after another.
//!
//! libtorch's networks and SUMO's connection stay on this one thread; the network tasks see only bytes.

use crate::episode::{self, Behaviour, Episode, Interrupted};
use crate::error::ActorError;
use crate::link::{Halt, Record, SimulatorEnd};
use crate::session::{Prepared, Session};
use crate::telemetry::{Outcome, Telemetry};
use cross_proto::v1;
use cross_sim::SimError;
use cross_sim::env::{Env, EnvOptions};
use cross_traci::sumo::SumoHome;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::oneshot;

/// Pause after SUMO's first failure; doubles with each further one in a row.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// Longest such pause.
const LONGEST_PAUSE: Duration = Duration::from_secs(8);

/// Time to hand over the news that the actor stops: short, since it is only a courtesy.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// What the simulator thread starts with.
#[derive(Debug)]
pub(crate) struct Rollout {
    pub(crate) link: SimulatorEnd,
    pub(crate) home: SumoHome,
    pub(crate) actor_id: String,
    pub(crate) telemetry: Arc<Telemetry>,
}

/// Starts the thread; the receiver gets its result, or an error if it panicked.
pub(crate) fn spawn(rollout: Rollout) -> Result<oneshot::Receiver<Result<(), ActorError>>, ActorError> {
    let (done, result) = oneshot::channel();
    std::thread::Builder::new()
        .name("simulator".to_owned())
        .spawn(move || {
            // Nobody waits any more if the grace period is over; the process then ends anyway.
            let _ = done.send(Simulator::new(rollout).run());
        })
        .map_err(|error| ActorError::Thread { problem: format!("cannot be started: {error}") })?;
    Ok(result)
}

struct Simulator {
    link: SimulatorEnd,
    home: SumoHome,
    actor_id: String,
    telemetry: Arc<Telemetry>,
    behaviour: Behaviour,
    /// SUMO, with the session and scenario that it was started for.
    env: Option<(u64, String, Env)>,
    /// SUMO's failures since an episode last came to its end.
    failures: u32,
}

impl Simulator {
    fn new(rollout: Rollout) -> Self {
        let Rollout { link, home, actor_id, telemetry } = rollout;
        Self { link, home, actor_id, telemetry, behaviour: Behaviour::default(), env: None, failures: 0 }
    }

    fn run(mut self) -> Result<(), ActorError> {
        // Several threads on a busy machine make a small forward pass a hundred times slower.
        cross_model::set_single_threaded();
        let result = self.sessions();
        let Self { link, env, .. } = self;
        // First lets the network send what is left, then ends SUMO.
        drop(link);
        if let Some((.., env)) = env
            && let Err(error) = env.close()
        {
            tracing::debug!("SUMO did not end by itself: {error}");
        }
        result
    }

    fn sessions(&mut self) -> Result<(), ActorError> {
        while let Some(session) = self.link.session() {
            match self.episodes(&session)? {
                Halt::Stop => break,
                Halt::SessionChanged | Halt::UnknownEpisode => {}
            }
        }
        Ok(())
    }

    /// Simulates episodes until something halts it.
    fn episodes(&mut self, session: &Arc<Session>) -> Result<Halt, ActorError> {
        loop {
            let assignment = match self.link.next_episode(session) {
                Ok(assignment) => assignment,
                Err(halt) => return Ok(halt),
            };
            let name = assignment.scenario.clone();
            let Some(prepared) = session.scenarios.get(&name) else {
                return Err(ActorError::UnknownScenario { scenario: name });
            };
            match self.episode(session, &assignment, prepared) {
                Ok(()) => {
                    self.failures = 0;
                    self.telemetry.episode(&name, Outcome::Completed);
                }
                Err(Interrupted::Halt(halt)) => {
                    if let Some(halt) = self.halted(session, &assignment, halt) {
                        return Ok(halt);
                    }
                }
                Err(Interrupted::Simulator(error)) => {
                    if let Err(halt) = self.simulator_failed(session, &assignment, error)? {
                        return Ok(halt);
                    }
                }
                Err(Interrupted::Fatal(error)) => {
                    self.telemetry.episode(&name, Outcome::Failed);
                    return Err(error);
                }
            }
        }
    }

    fn episode(
        &mut self,
        session: &Session,
        assignment: &v1::EpisodeAssignment,
        prepared: &Prepared,
    ) -> Result<(), Interrupted> {
        tracing::debug!(episode = assignment.episode, scenario = %assignment.scenario, "starting");
        self.make_env(session, &assignment.scenario, prepared).map_err(Interrupted::Simulator)?;
        let Some((.., env)) = self.env.as_mut() else {
            // Made above.
            return Err(Interrupted::Halt(Halt::SessionChanged));
        };
        Episode {
            session,
            assignment,
            prepared,
            actor_id: &self.actor_id,
            link: &mut self.link,
            env,
            behaviour: &mut self.behaviour,
            telemetry: &self.telemetry,
        }
        .run()
    }

    /// Has an environment for the scenario, the one at hand if it is the same.
    fn make_env(&mut self, session: &Session, name: &str, prepared: &Prepared) -> Result<(), SimError> {
        if self.env.as_ref().is_some_and(|(epoch, scenario, _)| *epoch == session.epoch && scenario == name) {
            return Ok(());
        }
        self.env = None;
        let options = EnvOptions {
            timeout: Duration::from_secs(session.config.actor.sumo_timeout_seconds),
            ..EnvOptions::new(session.config.env.clone())
        };
        let env = Env::new(&self.home, &prepared.scenario, options)?;
        self.env = Some((session.epoch, name.to_owned(), env));
        Ok(())
    }

    /// Settles an episode that was halted; gives the halt back if there is more to leave than the episode.
    fn halted(&mut self, session: &Session, assignment: &v1::EpisodeAssignment, halt: Halt) -> Option<Halt> {
        let episode = assignment.episode;
        let outcome = match halt {
            Halt::Stop => {
                let reason = episode::REASON_SHUTDOWN;
                // A courtesy that gives the learner its share back at once; without it the lease does so later.
                self.link.send_last(session, Record::Aborted { episode, reason }, LAST_WORDS);
                Outcome::Shutdown
            }
            Halt::SessionChanged => Outcome::SessionChanged,
            Halt::UnknownEpisode => Outcome::UnknownEpisode,
        };
        self.telemetry.episode(&assignment.scenario, outcome);
        tracing::info!(episode, scenario = %assignment.scenario, outcome = outcome.label(), "episode given up");
        (halt != Halt::UnknownEpisode).then_some(halt)
    }

    /// Reports SUMO's failure and prepares for another try.
    fn simulator_failed(
        &mut self,
        session: &Session,
        assignment: &v1::EpisodeAssignment,
        error: SimError,
    ) -> Result<Result<(), Halt>, ActorError> {
        // Drops what is left of the process; the next start takes a new port.
        self.env = None;
        let scenario = assignment.scenario.clone();
        if !error.is_simulator_failure() {
            self.telemetry.episode(&scenario, Outcome::Failed);
            return Err(ActorError::Simulation { scenario, source: Box::new(error) });
        }
        self.failures += 1;
        let timeout = error.reason() == cross_traci::ErrorKind::Timeout.as_str();
        let (outcome, reason) = if timeout {
            (Outcome::SumoTimeout, episode::REASON_SUMO_TIMEOUT)
        } else {
            (Outcome::SumoCrashed, episode::REASON_SUMO_CRASHED)
        };
        self.telemetry.episode(&scenario, outcome);
        self.telemetry.sumo_restart(error.reason());
        tracing::warn!(
            episode = assignment.episode,
            %scenario,
            failures = self.failures,
            "episode lost, starting another SUMO: {error}"
        );
        let record = Record::Aborted { episode: assignment.episode, reason };
        if let Err(halt) = self.link.send(session, record) {
            return Ok(Err(halt));
        }
        if self.failures >= session.config.actor.max_sumo_failures {
            let failures = self.failures;
            return Err(ActorError::SumoKeepsFailing { scenario, failures, source: Box::new(error) });
        }
        let doublings = (self.failures - 1).min(16);
        Ok(self.link.sleep(session, (FIRST_PAUSE * (1 << doublings)).min(LONGEST_PAUSE)))
    }
}
