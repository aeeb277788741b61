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
        in_vain: 5,
        ready: at(120),
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
    let commands =
        supervisor.handle(at(10), Event::LearnerExited { exit: Exit::Code(0), saved: 9, complete: true });
    assert_eq!(commands, [Command::StopActor { actor: 1 }]);
    let commands = supervisor.handle(at(11), Event::ActorExited { actor: 1, exit: Exit::Signal(15) });
    assert_eq!(commands, [Command::Finish(Ending::Complete { stopped: false })]);
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
    let died = Event::LearnerExited { exit: KILLED, saved: 0, complete: false };
    assert_eq!(acts(supervisor.handle(at(5), died)), []);
    assert_eq!(supervisor.handle(at(6), Event::Tick), [Command::StartLearner { again: true }]);
    assert_eq!(supervisor.handle(at(7), Event::LearnerReady), []);
    assert_eq!(supervisor.actors_alive(), 2);
}

#[test]
fn a_learner_that_ends_well_but_early_starts_again() {
    let mut supervisor = running(1);
    let left = Event::LearnerExited { exit: Exit::Code(0), saved: 0, complete: false };
    assert_eq!(acts(supervisor.handle(at(5), left)), []);
    assert_eq!(supervisor.handle(at(9), Event::Tick), [Command::StartLearner { again: true }]);
}

#[test]
fn bad_input_is_final_at_once() {
    let mut supervisor = running(1);
    let refused = Event::LearnerExited { exit: Exit::Code(2), saved: 0, complete: false };
    assert_eq!(supervisor.handle(at(1), refused), [Command::StopActor { actor: 0 }]);
    let commands = supervisor.handle(at(2), Event::ActorExited { actor: 0, exit: Exit::Code(0) });
    assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::LearnerInput))]);

    let mut supervisor = running(1);
    let refused = Event::ActorExited { actor: 0, exit: Exit::Code(2) };
    assert_eq!(supervisor.handle(at(1), refused), [Command::StopLearner]);
    let commands =
        supervisor.handle(at(2), Event::LearnerExited { exit: Exit::Code(0), saved: 0, complete: false });
    assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::ActorInput { actor: 0 }))]);
}

#[test]
fn a_learner_that_never_serves_is_not_tried_again() {
    let mut supervisor = Supervisor::new(2, limits());
    supervisor.start();
    let died = Event::LearnerExited { exit: Exit::Code(1), saved: 0, complete: false };
    let cause = Cause::LearnerNeverReady(Exit::Code(1));
    assert_eq!(supervisor.handle(at(1), died), [Command::Finish(Ending::Failed(cause))]);
}

#[test]
fn a_learner_that_keeps_dying_ends_the_run() {
    let mut supervisor = running(0);
    let died = Event::LearnerExited { exit: KILLED, saved: 0, complete: false };
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
    let commands =
        supervisor.handle(at(9), Event::LearnerExited { exit: Exit::Code(0), saved: 0, complete: false });
    let cause = Cause::ActorRestarts { actor: 1, exit: KILLED, per_minute: 2 };
    assert_eq!(commands, [Command::Finish(Ending::Failed(cause))]);
}

#[test]
fn a_stop_drains_the_learner_before_the_actors() {
    let mut supervisor = running(1);
    assert_eq!(acts(supervisor.handle(at(5), Event::StopAsked)), [Command::StopLearner]);
    let commands =
        supervisor.handle(at(7), Event::LearnerExited { exit: Exit::Code(0), saved: 0, complete: false });
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
    let left = Event::LearnerExited { exit: Exit::Code(0), saved: 0, complete: false };
    assert_eq!(supervisor.handle(at(21), left), [Command::Finish(Ending::Interrupted)]);
}

#[test]
fn a_stop_during_the_last_update_leaves_the_training_complete_and_is_remembered() {
    let mut supervisor = running(0);
    supervisor.handle(at(5), Event::StopAsked);
    let commands =
        supervisor.handle(at(6), Event::LearnerExited { exit: Exit::Code(0), saved: 9, complete: true });
    assert_eq!(commands, [Command::Finish(Ending::Complete { stopped: true })]);
}

#[test]
fn a_second_stop_kills() {
    let mut supervisor = running(1);
    supervisor.handle(at(5), Event::StopAsked);
    assert_eq!(supervisor.handle(at(6), Event::StopAsked), [Command::KillAll]);
    supervisor.handle(at(7), Event::LearnerExited { exit: KILLED, saved: 0, complete: false });
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
    let commands =
        supervisor.handle(at(36), Event::LearnerExited { exit: KILLED, saved: 0, complete: false });
    assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::Hung))]);
}

#[test]
fn a_drain_that_fails_is_a_failure() {
    for exit in [Exit::Code(1), Exit::Code(101), KILLED, Exit::Signal(15)] {
        let mut supervisor = running(1);
        supervisor.handle(at(5), Event::StopAsked);
        let commands = supervisor.handle(at(6), Event::LearnerExited { exit, saved: 3, complete: false });
        assert_eq!(commands, [Command::StopActor { actor: 0 }]);
        let commands = supervisor.handle(at(7), Event::ActorExited { actor: 0, exit: Exit::Code(0) });
        assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::DrainFailed(exit)))]);
    }
}

#[test]
fn a_stop_before_the_learner_serves_loses_nothing() {
    for (exit, ending) in [
        (Exit::Code(0), Ending::Interrupted),
        (Exit::Signal(15), Ending::Interrupted),
        (Exit::Code(1), Ending::Failed(Cause::DrainFailed(Exit::Code(1)))),
    ] {
        let mut supervisor = Supervisor::new(2, limits());
        supervisor.start();
        assert_eq!(acts(supervisor.handle(at(1), Event::StopAsked)), [Command::StopLearner]);
        let commands = supervisor.handle(at(2), Event::LearnerExited { exit, saved: 0, complete: false });
        assert_eq!(commands, [Command::Finish(ending)]);
    }
}

#[test]
fn an_earlier_failure_is_not_hidden_by_what_follows() {
    let mut supervisor = running(1);
    supervisor.handle(at(1), Event::ActorExited { actor: 0, exit: Exit::Code(2) });
    assert_eq!(acts(supervisor.handle(at(2), Event::StopAsked)), []);
    assert_eq!(supervisor.handle(at(4), Event::StopAsked), [Command::KillAll]);
    let commands = supervisor.handle(at(5), Event::LearnerExited { exit: KILLED, saved: 0, complete: false });
    assert_eq!(commands, [Command::Finish(Ending::Failed(Cause::ActorInput { actor: 0 }))]);
}

#[test]
fn a_stop_while_the_actors_leave_is_remembered_and_a_second_one_kills() {
    for twice in [false, true] {
        let mut supervisor = running(1);
        supervisor.handle(at(5), Event::LearnerExited { exit: Exit::Code(0), saved: 9, complete: true });
        assert_eq!(supervisor.handle(at(6), Event::StopAsked), []);
        if twice {
            assert_eq!(supervisor.handle(at(8), Event::StopAsked), [Command::KillAll]);
        }
        let commands = supervisor.handle(at(9), Event::ActorExited { actor: 0, exit: Exit::Code(0) });
        let ending = if twice { Ending::Killed } else { Ending::Complete { stopped: true } };
        assert_eq!(commands, [Command::Finish(ending)]);
    }
}

#[test]
fn a_learner_that_dies_slowly_without_any_progress_ends_the_run() {
    let mut supervisor = running(0);
    let died = |saved| Event::LearnerExited { exit: KILLED, saved, complete: false };
    // Four deaths at one checkpoint are forgiven by the next one.
    for (round, saved) in [2, 2, 2, 2, 3, 3, 3, 3].into_iter().enumerate() {
        let second = 100 * (round as u64 + 1);
        assert_eq!(acts(supervisor.handle(at(second), died(saved))), []);
        assert_eq!(supervisor.handle(at(second + 9), Event::Tick), [Command::StartLearner { again: true }]);
        supervisor.handle(at(second + 10), Event::LearnerReady);
        // What was done but not saved is done again after the next death: no progress.
        supervisor.handle(at(second + 20), Event::Updates(saved + 4));
    }
    let cause = Cause::LearnerInVain { exit: KILLED, deaths: 5 };
    assert_eq!(supervisor.handle(at(2000), died(3)), [Command::Finish(Ending::Failed(cause))]);
}

/// Actor `actor` dies so many times, far enough apart for its rate, and is started again each time.
fn dies(supervisor: &mut Supervisor, actor: usize, from: u64, times: u64) {
    for second in (0..times).map(|round| from + 100 * round) {
        assert_eq!(acts(supervisor.handle(at(second), Event::ActorExited { actor, exit: KILLED })), []);
        assert_eq!(supervisor.handle(at(second + 9), Event::Tick), [Command::StartActor { actor }]);
    }
}

#[test]
fn actors_that_all_die_slowly_without_any_update_end_the_run() {
    let mut supervisor = running(2);
    dies(&mut supervisor, 0, 10, 6);
    dies(&mut supervisor, 1, 20, 4);
    let commands = supervisor.handle(at(1000), Event::ActorExited { actor: 1, exit: KILLED });
    assert_eq!(commands, [Command::StopLearner]);
    let commands =
        supervisor.handle(at(1001), Event::LearnerExited { exit: Exit::Code(0), saved: 0, complete: false });
    assert_eq!(commands, [Command::StopActor { actor: 0 }]);
    let commands = supervisor.handle(at(1002), Event::ActorExited { actor: 0, exit: Exit::Code(0) });
    let cause = Cause::ActorsInVain { actor: 1, exit: KILLED, deaths: 5 };
    assert_eq!(commands, [Command::Finish(Ending::Failed(cause))]);
}

#[test]
fn an_actor_that_keeps_dying_slowly_beside_one_that_works_starts_again() {
    let mut supervisor = running(2);
    dies(&mut supervisor, 0, 10, 9);
    let mut alone = running(1);
    dies(&mut alone, 0, 10, 4);
    alone.handle(at(500), Event::Updates(1));
    dies(&mut alone, 0, 510, 4);
    // An older count, from a learner that went back to its checkpoint, is no progress.
    alone.handle(at(1000), Event::Updates(1));
    let commands = alone.handle(at(1010), Event::ActorExited { actor: 0, exit: KILLED });
    assert_eq!(commands, [Command::StopLearner]);
}

#[test]
fn a_learner_that_lives_but_never_serves_is_killed_once() {
    let mut supervisor = Supervisor::new(1, limits());
    supervisor.start();
    assert_eq!(supervisor.handle(at(119), Event::Tick), []);
    assert_eq!(acts(supervisor.handle(at(120), Event::Tick)), [Command::KillLearner]);
    assert_eq!(supervisor.handle(at(121), Event::Tick), []);
    let died = Event::LearnerExited { exit: KILLED, saved: 0, complete: false };
    let cause = Cause::LearnerNeverServed { seconds: 120 };
    assert_eq!(supervisor.handle(at(121), died), [Command::Finish(Ending::Failed(cause))]);
}

#[test]
fn a_restarted_learner_has_its_own_time_until_it_serves() {
    let mut supervisor = running(1);
    let died = Event::LearnerExited { exit: KILLED, saved: 0, complete: false };
    assert_eq!(supervisor.handle(at(500), Event::Tick), []);
    for start in [600, 1000] {
        supervisor.handle(at(start), died);
        let commands = supervisor.handle(at(start + 10), Event::Tick);
        assert_eq!(commands, [Command::StartLearner { again: true }]);
        assert_eq!(supervisor.handle(at(start + 129), Event::Tick), []);
        assert_eq!(acts(supervisor.handle(at(start + 130), Event::Tick)), [Command::KillLearner]);
    }
    // Killed for it, the learner counts as one that died: it starts again.
    supervisor.handle(at(1131), died);
    assert_eq!(supervisor.handle(at(1140), Event::Tick), [Command::StartLearner { again: true }]);
    supervisor.handle(at(1150), Event::LearnerReady);
    assert_eq!(supervisor.handle(at(2000), Event::Tick), []);
}

#[test]
fn an_actor_dismissed_by_a_learner_that_starts_again_is_started_again() {
    let mut supervisor = running(2);
    supervisor.handle(at(5), Event::LearnerLeaving);
    assert_eq!(supervisor.handle(at(6), Event::ActorExited { actor: 1, exit: Exit::Code(0) }), []);
    let left = Event::LearnerExited { exit: Exit::Code(0), saved: 4, complete: false };
    assert_eq!(acts(supervisor.handle(at(7), left)), []);
    assert_eq!(supervisor.handle(at(9), Event::Tick), [Command::StartLearner { again: true }]);
    assert_eq!(supervisor.handle(at(10), Event::LearnerReady), [Command::StartActor { actor: 1 }]);
    assert_eq!(supervisor.actors_alive(), 2);
}
