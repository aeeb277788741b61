//! Which process to start, stop or give up on: the rules of `cross train`, without any I/O.
//!
//! ```text
//!   events ──> Supervisor ──> commands
//!   learner ready / exited / leaving        start, stop or kill the learner
//!   actor exited, updates done              start or stop an actor
//!   stop asked for (Ctrl-C, SIGTERM)        kill everything
//!   a tick of the clock                     finish
//! ```
//! The loop that owns the processes ([`super::run`]) carries commands out and reports back; times are since its start.

use super::backoff::{Backoff, InVain};
use cross_support::child::Exit;
use std::time::Duration;

/// What [`Command::StopLearner`] does to a learner that does not listen for signals yet.
const SIGTERM: Exit = Exit::Signal(15);

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Event {
    /// The learner serves.
    LearnerReady,
    /// The learner says that it finishes or drains: it will end by itself, and actors that leave now are right to.
    LearnerLeaving,
    /// The learner ended. Its newest checkpoint holds `saved` updates; `complete` if that is all that were asked for.
    LearnerExited { exit: Exit, saved: u64, complete: bool },
    /// An actor ended.
    ActorExited { actor: usize, exit: Exit },
    /// The learner says that it has done so many updates.
    Updates(u64),
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
    /// SIGKILL to the learner alone.
    KillLearner,
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
    /// All updates are done; `stopped` if a stop was asked for meanwhile, so that nothing more should be begun.
    Complete { stopped: bool },
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
    /// The learner did not serve within its time, at the first start.
    LearnerNeverServed { seconds: u64 },
    /// The learner died too often.
    LearnerRestarts { exit: Exit, per_minute: usize },
    /// The learner died so many times without a checkpoint that goes further.
    LearnerInVain { exit: Exit, deaths: u32 },
    /// Every actor died too often; the last one named.
    ActorRestarts { actor: usize, exit: Exit, per_minute: usize },
    /// Every actor died so many times, or for good, without a new update; the last one named.
    ActorsInVain { actor: usize, exit: Exit, deaths: u32 },
    /// The learner was to finish its update and write a checkpoint, and ended without.
    DrainFailed(Exit),
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
    /// Deaths without any progress that are too many.
    pub in_vain: u32,
    /// How long the learner may take from its start until it serves.
    pub ready: Duration,
    /// How long the learner may drain.
    pub drain: Duration,
    /// How long actors may take to end once the learner has.
    pub actor_grace: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Process {
    /// Not started yet, or dismissed by a learner: actors wait for one that serves.
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
    /// While the learner runs and does not serve yet: when it must.
    learner_ready_by: Option<Duration>,
    /// It was killed because it did not serve in time.
    learner_overdue: bool,
    learner_leaving: bool,
    learner_backoff: Backoff,
    learner_in_vain: InVain,
    actors: Vec<(Process, Backoff)>,
    actors_in_vain: Vec<InVain>,
    /// Most updates that a learner has told of.
    updates: u64,
    in_vain: u32,
    ready: Duration,
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
            learner_ready_by: None,
            learner_overdue: false,
            learner_leaving: false,
            learner_backoff: limits.learner,
            learner_in_vain: InVain::default(),
            actors: vec![(Process::New, limits.actor); actors],
            actors_in_vain: vec![InVain::default(); actors],
            updates: 0,
            in_vain: limits.in_vain,
            ready: limits.ready,
            drain: limits.drain,
            actor_grace: limits.actor_grace,
            stops_asked: 0,
        }
    }

    /// The first commands.
    pub(crate) fn start(&mut self) -> Vec<Command> {
        self.learner = Process::Running;
        self.learner_ready_by = Some(self.ready);
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
            Event::LearnerExited { exit, saved, complete } => {
                self.learner_exited(now, exit, saved, complete, &mut commands);
            }
            Event::Updates(updates) => self.updates = self.updates.max(updates),
            Event::ActorExited { actor, exit } => self.actor_exited(now, actor, exit, &mut commands),
            Event::StopAsked => self.stop_asked(now, &mut commands),
            Event::Tick => self.tick(now, &mut commands),
        }
        self.finish_if_all_ended(&mut commands);
        commands
    }

    fn learner_ready(&mut self, commands: &mut Vec<Command>) {
        self.learner_was_ready = true;
        self.learner_ready_by = None;
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

    fn learner_exited(
        &mut self,
        now: Duration,
        exit: Exit,
        saved: u64,
        complete: bool,
        commands: &mut Vec<Command>,
    ) {
        self.learner = Process::Ended;
        self.learner_leaving = false;
        let served = self.learner_ready_by.take().is_none();
        let overdue = std::mem::take(&mut self.learner_overdue);
        match &mut self.phase {
            Phase::Running => {}
            Phase::Stopping { ending, .. } => {
                // An earlier failure says more than its consequences.
                if *ending == Ending::Interrupted {
                    // Before it serves it has nothing to save, and may not yet listen for signals.
                    let nothing_lost = exit == Exit::Code(0) || (!served && (exit == SIGTERM || overdue));
                    if complete {
                        *ending = Ending::Complete { stopped: true };
                    } else if !nothing_lost {
                        *ending = Ending::Failed(Cause::DrainFailed(exit));
                    }
                }
                self.stop_actors(now, commands);
                return;
            }
            Phase::Finished => return,
        }
        if exit == Exit::Code(0) && complete {
            return self.stop(now, Ending::Complete { stopped: false }, commands);
        }
        if exit == Exit::Code(2) {
            return self.stop(now, Ending::Failed(Cause::LearnerInput), commands);
        }
        if !self.learner_was_ready {
            let cause = if overdue {
                Cause::LearnerNeverServed { seconds: self.ready.as_secs() }
            } else {
                Cause::LearnerNeverReady(exit)
            };
            return self.stop(now, Ending::Failed(cause), commands);
        }
        let deaths = self.learner_in_vain.after_death(saved);
        if deaths >= self.in_vain {
            return self.stop(now, Ending::Failed(Cause::LearnerInVain { exit, deaths }), commands);
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
        let Some((state, _)) = self.actors.get_mut(actor) else { return };
        *state = Process::Ended;
        if self.phase != Phase::Running {
            return;
        }
        if self.learner_leaving && exit == Exit::Code(0) {
            // The learner said goodbye; only another one, if there is to be one, has work for this actor.
            *state = Process::New;
            return;
        }
        if exit == Exit::Code(2) {
            return self.stop(now, Ending::Failed(Cause::ActorInput { actor }), commands);
        }
        let in_vain = self.actors_in_vain.get_mut(actor).map_or(0, |count| count.after_death(self.updates));
        if in_vain >= self.in_vain && self.all_actors_in_vain() {
            let cause = Cause::ActorsInVain { actor, exit, deaths: in_vain };
            return self.stop(now, Ending::Failed(cause), commands);
        }
        let Some((state, backoff)) = self.actors.get_mut(actor) else { return };
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

    /// Whether no actor is left that may yet bring training on. One that keeps dying beside others that work is only
    /// held to its rate: their updates forgive it.
    fn all_actors_in_vain(&self) -> bool {
        let mut actors = self.actors.iter().zip(&self.actors_in_vain);
        actors
            .all(|((state, _), count)| *state == Process::Ended || count.deaths(self.updates) >= self.in_vain)
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
                    // What has failed by then stays the news.
                    if !matches!(ending, Ending::Failed(_)) {
                        *ending = Ending::Killed;
                    }
                    commands.push(Command::KillAll);
                } else if let Ending::Complete { stopped } = ending {
                    *stopped = true;
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
                    self.learner_ready_by = Some(now + self.ready);
                    commands.push(Command::StartLearner { again: true });
                }
                if !self.learner_overdue && self.learner_ready_by.is_some_and(|by| now >= by) {
                    self.learner_overdue = true;
                    commands.push(Command::Tell(format!(
                        "the learner does not serve {} s after its start; it is killed",
                        self.ready.as_secs()
                    )));
                    commands.push(Command::KillLearner);
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
