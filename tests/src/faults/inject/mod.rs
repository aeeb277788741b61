//! Faults, a file for each part of the cluster: how each is made, and from which moment it is over.

mod disk;
mod network;
mod processes;
mod wire;

use super::Broken;
use super::plan::Fault;
use super::recovery::Over;
use super::world::{World, actor_name};
use std::time::{Duration, Instant};

/// What can go wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[expect(missing_docs, reason = "each is described by `Kind::what`")]
pub enum Kind {
    SumoKilled,
    SumoHung,
    SumoPaused,
    ActorKilled,
    ActorPaused,
    LearnerKilled,
    LearnerPaused,
    LearnerDrained,
    PowerCut,
    CutSilently,
    CutOneWay,
    CutEverybody,
    Unplugged,
    Reset,
    Slow,
    DiskFull,
    KilledOnFullDisk,
    TornFile,
    ClockJump,
    Duplicates,
    Reordered,
    Twin,
    OtherVersion,
    Stranger,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 24] = [
        Self::SumoKilled,
        Self::SumoHung,
        Self::SumoPaused,
        Self::ActorKilled,
        Self::ActorPaused,
        Self::LearnerKilled,
        Self::LearnerPaused,
        Self::LearnerDrained,
        Self::PowerCut,
        Self::CutSilently,
        Self::CutOneWay,
        Self::CutEverybody,
        Self::Unplugged,
        Self::Reset,
        Self::Slow,
        Self::DiskFull,
        Self::KilledOnFullDisk,
        Self::TornFile,
        Self::ClockJump,
        Self::Duplicates,
        Self::Reordered,
        Self::Twin,
        Self::OtherVersion,
        Self::Stranger,
    ];

    /// In words.
    #[must_use]
    pub fn what(self) -> &'static str {
        match self {
            Self::SumoKilled => "SIGKILL of a SUMO",
            Self::SumoHung => "SIGSTOP of a SUMO, for good",
            Self::SumoPaused => "SIGSTOP of a SUMO, up to 3 s",
            Self::ActorKilled => "SIGKILL of an actor",
            Self::ActorPaused => "SIGSTOP of an actor, up to 13 s",
            Self::LearnerKilled => "SIGKILL of the learner",
            Self::LearnerPaused => "SIGSTOP of the learner, up to 13 s",
            Self::LearnerDrained => "SIGTERM of the learner and another one",
            Self::PowerCut => "SIGKILL of everything at once",
            Self::CutSilently => "an actor's packets vanish, up to 13 s",
            Self::CutOneWay => "they vanish in one direction, up to 13 s",
            Self::CutEverybody => "all actors' packets vanish, up to 8 s",
            Self::Unplugged => "an actor's link is down, up to 8 s",
            Self::Reset => "an actor's connections are reset, for 1 s",
            Self::Slow => "an actor's link at 64 to 512 kbit/s, up to 6 s",
            Self::DiskFull => "disk full until a checkpoint fails",
            Self::KilledOnFullDisk => "the same, and SIGKILL of the learner meanwhile",
            Self::TornFile => "SIGKILL of the learner, and a torn file",
            Self::ClockJump => "wall clocks jump, up to two days",
            Self::Duplicates => "an actor's fragments are sent twice, for 2 s",
            Self::Reordered => "an actor's fragments change places, for 2 s",
            Self::Twin => "a second actor under a living actor's id",
            Self::OtherVersion => "an actor of another protocol version",
            Self::Stranger => "a client that breaks the rules of the stream",
        }
    }
}

/// Injects a fault, goes on until it is over, and says from when on.
///
/// # Errors
/// An invariant that does not hold meanwhile, or a fault that could not be injected.
pub fn inject(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    world.flow.disturbed();
    match fault.kind {
        Kind::SumoKilled => processes::sumo_killed(world, fault),
        Kind::SumoHung => processes::sumo_hung(world, fault),
        Kind::SumoPaused => processes::sumo_paused(world, fault),
        Kind::ActorKilled => processes::actor_killed(world, fault),
        Kind::ActorPaused => processes::actor_paused(world, fault),
        Kind::LearnerKilled => processes::learner_killed(world),
        Kind::LearnerPaused => processes::learner_paused(world, fault),
        Kind::LearnerDrained => processes::learner_drained(world),
        Kind::PowerCut => processes::power_cut(world),
        Kind::CutSilently | Kind::CutOneWay => network::cut(world, fault),
        Kind::CutEverybody => network::cut_everybody(world, fault),
        Kind::Unplugged => network::unplugged(world, fault),
        Kind::Reset => network::reset(world, fault),
        Kind::Slow => network::slow(world, fault),
        Kind::DiskFull => disk::full(world, false),
        Kind::KilledOnFullDisk => disk::full(world, true),
        Kind::TornFile => disk::torn(world, fault),
        Kind::ClockJump => processes::clock_jump(world, fault),
        Kind::Duplicates | Kind::Reordered => wire::mischief(world, fault),
        Kind::Twin => wire::twin(world, fault),
        Kind::OtherVersion => wire::other_version(world),
        Kind::Stranger => wire::stranger(world),
    }
}

/// What has to follow once throughput is back.
///
/// # Errors
/// If it does not.
pub fn afterwards(world: &mut World, over: &Over) -> Result<(), Broken> {
    let Some(before) = &over.checkpoint else { return Ok(()) };
    let run = world.run();
    world.until("a checkpoint on a disk that has room again", 60, |_| {
        disk::newest(&run).is_some_and(|newest| newest > *before).then_some(())
    })
}

/// Between a tenth of the longest and the longest.
fn lasts(fault: &Fault, longest: f64) -> Duration {
    Duration::from_secs_f64(longest * (0.1 + 0.9 * fault.share))
}

/// Over now, for this actor.
fn over(n: usize, anew: bool) -> Over {
    Over { since: Instant::now(), actors: vec![actor_name(n)], anew, checkpoint: None }
}

/// Over now, for every actor.
fn over_for_all(world: &World, anew: bool) -> Over {
    Over {
        since: Instant::now(),
        actors: (0..world.actors.len()).map(actor_name).collect(),
        anew,
        checkpoint: None,
    }
}

/// Over now, and it should not have touched anybody.
fn over_for_nobody() -> Over {
    Over { since: Instant::now(), actors: Vec::new(), anew: false, checkpoint: None }
}

/// Could not be injected.
fn missed(what: &str) -> Broken {
    Broken::new("faults can be injected", what)
}
