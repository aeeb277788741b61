//! Which process to start, stop or give up on: the rules of `cross train`, without any I/O.
//!
//! ```text
//!   events ──> Supervisor ──> commands
//!   learner ready / exited / leaving        start or stop the learner
//!   actor exited                            start or stop an actor
//!   stop asked for (Ctrl-C, SIGTERM)        kill everything
//!   a tick of the clock                     finish
//! ```
//! The loop that owns the processes ([`super::run`]) carries commands out and reports back; times are since its start.

use super::backoff::Backoff;
use std::fmt;
use std::time::Duration;

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    Code(i32),
    Signal(i32),
}

impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Code(code) => write!(f, "ended with exit code {code}"),
            Self::Signal(signal) => write!(f, "was killed by signal {signal}"),
        }
    }
}

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Event {
    /// The learner serves.
    LearnerReady,
    /// The learner says that it finishes or drains: it will end by itself, and actors that leave now are right to.
    LearnerLeaving,
    /// The learner ended; `complete` if its newest checkpoint holds all the updates that were asked for.
    LearnerExited { exit: Exit, complete: bool },
    /// An actor ended.
    ActorExited { actor: usize, exit: Exit },
    /// Ctrl-C or SIGTERM.
    StopAsked,
    /// Time went by.
    Tick,
}

/// What to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Command {
    /// `again`: it ran before in this run, so it must take up its own checkpoints.
    StartLearner {
        again: bool,
    },
    StartActor {
        actor: usize,
    },
    /// SIGTERM: drain and checkpoint.
    StopLearner,
    /// SIGTERM.
    StopActor {
        actor: usize,
    },
    /// SIGKILL, whatever still runs.
    KillAll,
    /// Something the person should know.
    Tell(String),
    /// Everything has ended.
    Finish(Ending),
}

/// How the run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Ending {
    /// All updates are done.
    Complete,
    /// Stopped on request, drained and checkpointed.
    Interrupted,
    /// Stopped on request without waiting.
    Killed,
    /// Could not go on.
    Failed(Cause),
}

/// Why a run could not go on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Cause {
    /// The learner refused its input; its own message says why.
    LearnerInput,
    /// An actor refused its input; its own message says why.
    ActorInput { actor: usize },
    /// The learner ended before it served for the first time.
    LearnerNeverReady(Exit),
    /// The learner died too often.
    LearnerRestarts { exit: Exit, per_minute: usize },
    /// Every actor died too often; the last one named.
    ActorRestarts { actor: usize, exit: Exit, per_minute: usize },
    /// The learner or an actor did not end within the grace period.
    Hung,
}

/// Patience.
#[derive(Debug, Clone)]
pub(crate) struct Limits {
    /// Restarts of the learner.
    pub learner: Backoff,
    /// Restarts of each actor.
    pub actor: Backoff,
    /// How long the learner may drain.
    pub drain: Duration,
    /// How long actors may take to end once the learner has.
    pub actor_grace: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Process {
    /// Not started yet: actors wait for the learner.
    New,
    Running,
    /// Died; starts again at this time.
    Waiting(Duration),
    /// Ended for good.
    Ended,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Phase {
    Running,
    /// Everything is to end, with this result; killed at the deadline.
    Stopping {
        ending: Ending,
        deadline: Duration,
    },
    Finished,
}

/// The rules.
#[derive(Debug)]
pub(crate) struct Supervisor {
    phase: Phase,
    learner: Process,
    learner_was_ready: bool,
    learner_leaving: bool,
    learner_backoff: Backoff,
    actors: Vec<(Process, Backoff)>,
    drain: Duration,
    actor_grace: Duration,
    stops_asked: u32,
}

impl Supervisor {
    pub(crate) fn new(actors: usize, limits: Limits) -> Self {
        Self {
            phase: Phase::Running,
            learner: Process::New,
            learner_was_ready: false,
            learner_leaving: false,
            learner_backoff: limits.learner,
            actors: vec![(Process::New, limits.actor); actors],
            drain: limits.drain,
            actor_grace: limits.actor_grace,
            stops_asked: 0,
        }
    }

    /// The first commands.
    pub(crate) fn start(&mut self) -> Vec<Command> {
        self.learner = Process::Running;
        vec![Command::StartLearner { again: false }]
    }

    /// Actors that run now.
    pub(crate) fn actors_alive(&self) -> usize {
        self.actors.iter().filter(|(state, _)| *state == Process::Running).count()
    }

    /// Takes an event at time `now` and says what to do about it, in order.
    pub(crate) fn handle(&mut self, now: Duration, event: Event) -> Vec<Command> {
        let mut commands = Vec::new();
        match event {
            Event::LearnerReady => self.learner_ready(&mut commands),
            // One that has ended since is not leaving any more.
            Event::LearnerLeaving => self.learner_leaving = self.learner == Process::Running,
            Event::LearnerExited { exit, complete } => {
                self.learner_exited(now, exit, complete, &mut commands);
            }
            Event::ActorExited { actor, exit } => self.actor_exited(now, actor, exit, &mut commands),
            Event::StopAsked => self.stop_asked(now, &mut commands),
            Event::Tick => self.tick(now, &mut commands),
        }
        self.finish_if_all_ended(&mut commands);
        commands
    }

    fn learner_ready(&mut self, commands: &mut Vec<Command>) {
        self.learner_was_ready = true;
        if self.phase != Phase::Running {
            return;
        }
        for (actor, (state, _)) in self.actors.iter_mut().enumerate() {
            if *state == Process::New {
                *state = Process::Running;
                commands.push(Command::StartActor { actor });
            }
        }
    }

    fn learner_exited(&mut self, now: Duration, exit: Exit, complete: bool, commands: &mut Vec<Command>) {
        self.learner = Process::Ended;
        self.learner_leaving = false;
        match self.phase {
            Phase::Running => {}
            Phase::Stopping { .. } => {
                // A stop that came after the last update interrupted nothing.
                if complete
                    && let Phase::Stopping { ending: ending @ Ending::Interrupted, .. } = &mut self.phase
                {
                    *ending = Ending::Complete;
                }
                self.stop_actors(now, commands);
                return;
            }
            Phase::Finished => return,
        }
        if exit == Exit::Code(0) && complete {
            return self.stop(now, Ending::Complete, commands);
        }
        if exit == Exit::Code(2) {
            return self.stop(now, Ending::Failed(Cause::LearnerInput), commands);
        }
        if !self.learner_was_ready {
            return self.stop(now, Ending::Failed(Cause::LearnerNeverReady(exit)), commands);
        }
        match self.learner_backoff.after_death(now) {
            Some(wait) => {
                self.learner = Process::Waiting(now + wait);
                commands.push(Command::Tell(format!(
                    "the learner {exit}; it starts again from its newest checkpoint in {} s",
                    wait.as_secs_f32()
                )));
            }
            None => {
                let per_minute = self.learner_backoff.per_minute();
                self.stop(now, Ending::Failed(Cause::LearnerRestarts { exit, per_minute }), commands);
            }
        }
    }

    fn actor_exited(&mut self, now: Duration, actor: usize, exit: Exit, commands: &mut Vec<Command>) {
        let Some((state, backoff)) = self.actors.get_mut(actor) else { return };
        *state = Process::Ended;
        // An actor leaves by itself when the learner says goodbye; nothing is left for it to do then.
        let dismissed = self.learner_leaving && exit == Exit::Code(0);
        if self.phase != Phase::Running || dismissed {
            return;
        }
        if exit == Exit::Code(2) {
            return self.stop(now, Ending::Failed(Cause::ActorInput { actor }), commands);
        }
        match backoff.after_death(now) {
            Some(wait) => {
                *state = Process::Waiting(now + wait);
                commands.push(Command::Tell(format!(
                    "actor {actor} {exit}; another starts in {} s",
                    wait.as_secs_f32()
                )));
            }
            None => {
                let per_minute = backoff.per_minute();
                if self.actors.iter().all(|(state, _)| *state == Process::Ended) {
                    let cause = Cause::ActorRestarts { actor, exit, per_minute };
                    self.stop(now, Ending::Failed(cause), commands);
                } else {
                    commands.push(Command::Tell(format!(
                        "actor {actor} {exit}, its {}th end within a minute; it stays down, see logs/actor-{actor}.log",
                        per_minute + 1
                    )));
                }
            }
        }
    }

    fn stop_asked(&mut self, now: Duration, commands: &mut Vec<Command>) {
        self.stops_asked += 1;
        match &mut self.phase {
            Phase::Running => {
                commands.push(Command::Tell(
                    "stopping: the learner finishes its update and writes a checkpoint (once more to stop at once)"
                        .to_owned(),
                ));
                self.stop(now, Ending::Interrupted, commands);
            }
            Phase::Stopping { ending, .. } => {
                if self.stops_asked > 1 {
                    *ending = Ending::Killed;
                    commands.push(Command::KillAll);
                }
            }
            Phase::Finished => {}
        }
    }

    /// Begins the end. The learner drains first: its goodbye lets the actors leave by themselves.
    fn stop(&mut self, now: Duration, ending: Ending, commands: &mut Vec<Command>) {
        self.phase = Phase::Stopping { ending, deadline: now + self.drain };
        for (state, _) in &mut self.actors {
            if matches!(state, Process::New | Process::Waiting(_)) {
                *state = Process::Ended;
            }
        }
        if self.learner == Process::Running {
            commands.push(Command::StopLearner);
        } else {
            self.learner = Process::Ended;
            self.stop_actors(now, commands);
        }
    }

    fn stop_actors(&mut self, now: Duration, commands: &mut Vec<Command>) {
        if let Phase::Stopping { deadline, .. } = &mut self.phase {
            *deadline = now + self.actor_grace;
        }
        for (actor, (state, _)) in self.actors.iter().enumerate() {
            if *state == Process::Running {
                commands.push(Command::StopActor { actor });
            }
        }
    }

    fn tick(&mut self, now: Duration, commands: &mut Vec<Command>) {
        match &mut self.phase {
            Phase::Running => {
                if matches!(self.learner, Process::Waiting(at) if now >= at) {
                    self.learner = Process::Running;
                    commands.push(Command::StartLearner { again: true });
                }
                for (actor, (state, _)) in self.actors.iter_mut().enumerate() {
                    if matches!(state, Process::Waiting(at) if now >= *at) {
                        *state = Process::Running;
                        commands.push(Command::StartActor { actor });
                    }
                }
            }
            Phase::Stopping { ending, deadline } => {
                if now >= *deadline {
                    // All updates are on disk by then, or an earlier failure says more; only a drain that hung is news.
                    if *ending == Ending::Interrupted && self.learner == Process::Running {
                        *ending = Ending::Failed(Cause::Hung);
                    }
                    *deadline = Duration::MAX;
                    commands.push(Command::KillAll);
                }
            }
            Phase::Finished => {}
        }
    }

    fn finish_if_all_ended(&mut self, commands: &mut Vec<Command>) {
        let Phase::Stopping { ending, .. } = &self.phase else { return };
        if self.learner == Process::Ended && self.actors.iter().all(|(state, _)| *state == Process::Ended) {
            commands.push(Command::Finish(ending.clone()));
            self.phase = Phase::Finished;
        }
    }
}

#[cfg(test)]
#[path = "supervise_tests.rs"]
mod tests;
