//! The supervisor's rules, by the commands it returns.

use super::*;

const KILLED: Exit = Exit::Signal(9);

fn at(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

fn limits() -> Limits {
    Limits {
        learner: Backoff::new(at(1), at(8), 3),
        actor: Backoff::new(at(1), at(8), 2),
        drain: at(30),
        actor_grace: at(10),
    }
}

/// Learner and actors up at second 0.
fn running(actors: usize) -> Supervisor {
    let mut supervisor = Supervisor::new(actors, limits());
    assert_eq!(supervisor.start(), [Command::StartLearner { again: false }]);
    let commands = supervisor.handle(at(0), Event::LearnerReady);
    let expected: Vec<_> = (0..actors).map(|actor| Command::StartActor { actor }).collect();
    assert_eq!(commands, expected);
    supervisor
}

/// Without what is only said.
fn acts(commands: Vec<Command>) -> Vec<Command> {
    commands.into_iter().filter(|command| !matches!(command, Command::Tell(_))).collect()
}

#[test]
fn a_run_that_completes() {
    let mut supervisor = running(2);
    supervisor.handle(at(9), Event::LearnerLeaving);
    assert_eq!(supervisor.handle(at(9), Event::ActorExited { actor: 0, exit: Exit::Code(0) }), []);
    let commands = supervisor.handle(at(10), Event::LearnerExited { exit: Exit::Code(0), complete: true });
    assert_eq!(commands, [Command::StopActor { actor: 1 }]);
    let commands = supervisor.handle(at(11), Event::ActorExited { actor: 1, exit: Exit::Signal(15) });
    assert_eq!(commands, [Command::Finish(Ending::Complete)]);
    assert_eq!(supervisor.handle(at(12), Event::Tick), []);
}

#[test]
fn a_killed_actor_starts_again_after_its_wait_and_not_before() {
    let mut supervisor = running(2);
    assert_eq!(acts(supervisor.handle(at(5), Event::ActorExited { actor: 1, exit: KILLED })), []);
    assert_eq!(supervisor.actors_alive(), 1);
    assert_eq!(supervisor.handle(at(5), Event::Tick), []);
    assert_eq!(supervisor.handle(at(6), Event::Tick), [Command::StartActor { actor: 1 }]);
    assert_eq!(supervisor.handle(at(7), Event::Tick), []);
    assert_eq!(supervisor.actors_alive(), 2);
}

#[test]
fn a_killed_learner_starts_again_and_its_actors_are_left_alone() {
    let mut supervisor = running(2);
    let died = Event::LearnerExited { exit: KILLED, complete: false };
    assert_eq!(acts(supervisor.handle(at(5), died)), []);
    assert_eq!(supervisor.handle(at(6), Event::Tick), [Command::StartLearner { again: true }]);
    assert_eq!(supervisor.handle(at(7), Event::LearnerReady), []);
    assert_eq!(supervisor.actors_alive(), 2);
}

#[test]
fn a_learner_that_ends_well_but_early_starts_again() {
    let mut supervisor = running(1);
    let left = Event::LearnerExited { exit: Exit::Code(0), complete: false };
    assert_eq!(acts(supervisor.handle(at(5), left)), []);
    assert_eq!(supervisor.handle(at(9), Event::Tick), [Command::StartLearner { again: true }]);
}

#[test]
fn bad_input_is_final_at_once() {
    let mut supervisor = running(1);
    let refused = Event::LearnerExited { exit: Exit::Code(2), complete: false };
    assert_eq!(supervisor.handle(at(1), refused), [Command::StopActor { actor: 0 }]);
    let commands = supervisor.handle(at(2), Event::ActorExited { actor: 0, exit: Exit::Code(0) });
    assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::LearnerInput))]);

    let mut supervisor = running(1);
    let refused = Event::ActorExited { actor: 0, exit: Exit::Code(2) };
    assert_eq!(supervisor.handle(at(1), refused), [Command::StopLearner]);
    let commands = supervisor.handle(at(2), Event::LearnerExited { exit: Exit::Code(0), complete: false });
    assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::ActorInput { actor: 0 }))]);
}

#[test]
fn a_learner_that_never_serves_is_not_tried_again() {
    let mut supervisor = Supervisor::new(2, limits());
    supervisor.start();
    let died = Event::LearnerExited { exit: Exit::Code(1), complete: false };
    let cause = Cause::LearnerNeverReady(Exit::Code(1));
    assert_eq!(supervisor.handle(at(1), died), [Command::Finish(Ending::Failed(cause))]);
}

#[test]
fn a_learner_that_keeps_dying_ends_the_run() {
    let mut supervisor = running(0);
    let died = Event::LearnerExited { exit: KILLED, complete: false };
    for round in 0..3 {
        assert_eq!(acts(supervisor.handle(at(10 * round), died)), []);
        let commands = supervisor.handle(at(10 * round + 9), Event::Tick);
        assert_eq!(commands, [Command::StartLearner { again: true }]);
    }
    let cause = Cause::LearnerRestarts { exit: KILLED, per_minute: 3 };
    assert_eq!(supervisor.handle(at(40), died), [Command::Finish(Ending::Failed(cause))]);
}

#[test]
fn an_actor_that_keeps_dying_stays_down_and_the_last_one_ends_the_run() {
    let mut supervisor = running(2);
    for actor in 0..2 {
        for second in [1, 4] {
            supervisor.handle(at(second), Event::ActorExited { actor, exit: KILLED });
            assert_eq!(supervisor.handle(at(second + 3), Event::Tick), [Command::StartActor { actor }]);
        }
        let commands = acts(supervisor.handle(at(8), Event::ActorExited { actor, exit: KILLED }));
        if actor == 0 {
            assert_eq!(commands, []);
        } else {
            assert_eq!(commands, [Command::StopLearner]);
        }
    }
    let commands = supervisor.handle(at(9), Event::LearnerExited { exit: Exit::Code(0), complete: false });
    let cause = Cause::ActorRestarts { actor: 1, exit: KILLED, per_minute: 2 };
    assert_eq!(commands, [Command::Finish(Ending::Failed(cause))]);
}

#[test]
fn a_stop_drains_the_learner_before_the_actors() {
    let mut supervisor = running(1);
    assert_eq!(acts(supervisor.handle(at(5), Event::StopAsked)), [Command::StopLearner]);
    let commands = supervisor.handle(at(7), Event::LearnerExited { exit: Exit::Code(0), complete: false });
    assert_eq!(commands, [Command::StopActor { actor: 0 }]);
    let commands = supervisor.handle(at(8), Event::ActorExited { actor: 0, exit: Exit::Code(0) });
    assert_eq!(commands, [Command::Finish(Ending::Interrupted)]);
}

#[test]
fn nothing_that_dies_while_stopping_is_started_again() {
    let mut supervisor = running(2);
    supervisor.handle(at(4), Event::ActorExited { actor: 0, exit: KILLED });
    supervisor.handle(at(5), Event::StopAsked);
    supervisor.handle(at(6), Event::ActorExited { actor: 1, exit: KILLED });
    assert_eq!(supervisor.handle(at(20), Event::Tick), []);
    let commands = supervisor.handle(at(21), Event::LearnerExited { exit: KILLED, complete: false });
    assert_eq!(commands, [Command::Finish(Ending::Interrupted)]);
}

#[test]
fn a_stop_after_the_last_update_interrupts_nothing() {
    let mut supervisor = running(0);
    supervisor.handle(at(5), Event::StopAsked);
    let commands = supervisor.handle(at(6), Event::LearnerExited { exit: Exit::Code(0), complete: true });
    assert_eq!(commands, [Command::Finish(Ending::Complete)]);
}

#[test]
fn a_second_stop_kills() {
    let mut supervisor = running(1);
    supervisor.handle(at(5), Event::StopAsked);
    assert_eq!(supervisor.handle(at(6), Event::StopAsked), [Command::KillAll]);
    supervisor.handle(at(7), Event::LearnerExited { exit: KILLED, complete: false });
    let commands = supervisor.handle(at(7), Event::ActorExited { actor: 0, exit: KILLED });
    assert_eq!(commands, [Command::Finish(Ending::Killed)]);
}

#[test]
fn a_drain_that_hangs_is_killed_once() {
    let mut supervisor = running(1);
    supervisor.handle(at(5), Event::StopAsked);
    assert_eq!(supervisor.handle(at(34), Event::Tick), []);
    assert_eq!(supervisor.handle(at(35), Event::Tick), [Command::KillAll]);
    assert_eq!(supervisor.handle(at(36), Event::Tick), []);
    supervisor.handle(at(36), Event::ActorExited { actor: 0, exit: KILLED });
    let commands = supervisor.handle(at(36), Event::LearnerExited { exit: KILLED, complete: false });
    assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::Hung))]);
}
