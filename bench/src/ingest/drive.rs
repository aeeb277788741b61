//! One case: so many actors send as fast as they are answered.
//!
//! ```text
//!   all connect, join, open ── warm up ── count ── stop: what is in flight is still waited for
//! ```

use super::tally::{Figures, Tally, Usage};
use crate::cluster::actor::{Actor, Peer};
use crate::cluster::recording::Recording;
use crate::cost::cpu_of;
use crate::error::BenchError;
use crate::memory;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;

/// Actors that connect at the same time.
const CONNECTING: usize = 64;
/// Sending before anything counts.
const WARM_UP: Duration = Duration::from_millis(500);
/// Between two looks how far the actors are.
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// After which a server's memory is looked at again.
const SETTLE: Duration = Duration::from_millis(500);
/// How long all actors may take to connect, and how long the last acknowledgements may take.
const PATIENCE: Duration = Duration::from_secs(120);
/// Fragments that an actor may have in flight beyond those counted.
const IN_FLIGHT: u64 = 2;

/// What is sent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Load<'a> {
    pub(super) actors: usize,
    /// Seconds that count.
    pub(super) seconds: f64,
    /// Fragments that count, after which it ends in any case.
    pub(super) fragments: u64,
    pub(super) recording: &'a Arc<Recording>,
}

impl Load<'_> {
    /// Fragments that are sent at most, those in flight when it ends included. Between two looks more may come than asked
    /// for, but not a second time as many.
    pub(super) fn most_fragments(&self) -> u64 {
        2 * self.fragments + IN_FLIGHT * self.actors as u64
    }
}

/// What all actors are doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// They connect.
    Open,
    /// They send.
    Warm,
    /// They send, and it counts.
    Count,
    /// They send nothing new.
    Stop,
}

/// How far all are together.
#[derive(Debug, Default)]
pub(super) struct Shared {
    pub(super) open: AtomicUsize,
    pub(super) held_back: AtomicUsize,
    pub(super) acknowledged: AtomicU64,
}

/// The actors of a case, each a task.
pub(super) struct Crowd {
    pub(super) shared: Arc<Shared>,
    pub(super) phase: watch::Sender<Phase>,
    tasks: JoinSet<Result<Tally, BenchError>>,
    tallies: Vec<Tally>,
    actors: usize,
}

impl Crowd {
    /// Starts the actors, and waits until each has its streams open.
    pub(super) async fn open(
        peer: Peer,
        address: &str,
        actors: usize,
        recording: &Arc<Recording>,
    ) -> Result<Self, BenchError> {
        let (phase, seen) = watch::channel(Phase::Open);
        let shared = Arc::new(Shared::default());
        let places = Arc::new(Semaphore::new(CONNECTING));
        let mut tasks = JoinSet::new();
        for number in 0..actors {
            let (address, id) = (address.to_owned(), format!("bench-{number}"));
            let (recording, places) = (Arc::clone(recording), Arc::clone(&places));
            let (shared, seen) = (Arc::clone(&shared), seen.clone());
            tasks.spawn(async move {
                // Nobody closes the semaphore.
                let place = places.acquire_owned().await.ok();
                let actor = Actor::open(peer, &address, id, recording).await?;
                drop(place);
                act(actor, &shared, seen).await
            });
        }
        let mut crowd = Self { shared, phase, tasks, tallies: Vec::new(), actors };
        let open = |shared: &Shared| shared.open.load(Ordering::Relaxed);
        crowd.until("their streams", open, actors).await?;
        Ok(crowd)
    }

    /// Waits until `so_far` is at least `wanted`.
    pub(super) async fn until(
        &mut self,
        what: &'static str,
        so_far: impl Fn(&Shared) -> usize,
        wanted: usize,
    ) -> Result<(), BenchError> {
        let end = Instant::now() + PATIENCE;
        loop {
            let reached = so_far(&self.shared);
            if reached >= wanted {
                return Ok(());
            }
            if Instant::now() >= end {
                let waiting = wanted - reached;
                return Err(BenchError::Unserved {
                    waiting,
                    clients: self.actors,
                    what,
                    seconds: PATIENCE.as_secs(),
                });
            }
            self.look().await?;
        }
    }

    /// Waits a moment; an actor's error, if one fails meanwhile.
    pub(super) async fn look(&mut self) -> Result<(), BenchError> {
        tokio::select! {
            ended = self.tasks.join_next(), if !self.tasks.is_empty() => self.keep(ended),
            () = tokio::time::sleep(LOOK_EVERY) => Ok(()),
        }
    }

    /// Waits long enough for a server to take in what is on its way.
    pub(super) async fn settle(&mut self) -> Result<(), BenchError> {
        let end = Instant::now() + SETTLE;
        while Instant::now() < end {
            self.look().await?;
        }
        Ok(())
    }

    fn keep(
        &mut self,
        ended: Option<Result<Result<Tally, BenchError>, tokio::task::JoinError>>,
    ) -> Result<(), BenchError> {
        match ended {
            Some(Ok(tally)) => self.tallies.push(tally?),
            Some(Err(error)) => {
                return Err(BenchError::Runtime { source: std::io::Error::other(error) });
            }
            None => {}
        }
        Ok(())
    }

    /// Lets the actors send nothing new, and waits for what is in flight.
    pub(super) async fn stop(mut self) -> Result<Vec<Tally>, BenchError> {
        self.phase.send_replace(Phase::Stop);
        let end = tokio::time::Instant::now() + PATIENCE;
        while !self.tasks.is_empty() {
            let Ok(ended) = tokio::time::timeout_at(end, self.tasks.join_next()).await else {
                let what = "their last acknowledgements";
                let waiting = self.tasks.len();
                return Err(BenchError::Unserved {
                    waiting,
                    clients: self.actors,
                    what,
                    seconds: PATIENCE.as_secs(),
                });
            };
            self.keep(ended)?;
        }
        Ok(self.tallies)
    }
}

/// Has the actors send to a server, whose process is `pid`.
pub(super) async fn run(peer: Peer, address: &str, pid: u32, load: &Load<'_>) -> Result<Figures, BenchError> {
    let mut crowd = Crowd::open(peer, address, load.actors, load.recording).await?;
    let rest = memory::resident_of(pid)?;
    let so_far = |crowd: &Crowd| crowd.shared.acknowledged.load(Ordering::Relaxed);
    crowd.phase.send_replace(Phase::Warm);
    let begun = Instant::now();
    while begun.elapsed() < WARM_UP && so_far(&crowd) < load.fragments / 4 {
        crowd.look().await?;
    }
    // A fast server is through with more than the warm-up was to take before it is looked at.
    let warm = so_far(&crowd);
    let (cpu, begun) = (cpu_of(pid)?, Instant::now());
    crowd.phase.send_replace(Phase::Count);
    while begun.elapsed().as_secs_f64() < load.seconds && so_far(&crowd) - warm < load.fragments {
        crowd.look().await?;
    }
    crowd.phase.send_replace(Phase::Stop);
    let (seconds, cpu) = (begun.elapsed().as_secs_f64(), cpu_of(pid)? - cpu);
    let tallies = crowd.stop().await?;
    let peak = memory::peak_of(pid)?;
    Ok(Figures::new(&tallies, seconds, Usage { cpu, rest, peak }))
}

/// An actor's life: sends whenever it may, until it is to stop and all is acknowledged.
async fn act(
    mut actor: Actor,
    shared: &Shared,
    mut phase: watch::Receiver<Phase>,
) -> Result<Tally, BenchError> {
    let mut tally = Tally::default();
    shared.open.fetch_add(1, Ordering::Relaxed);
    let mut held_back = false;
    loop {
        let now = *phase.borrow_and_update();
        match now {
            Phase::Open => {}
            Phase::Warm | Phase::Count => tally.sent += u64::from(actor.offer()),
            Phase::Stop if actor.is_idle() => return Ok(tally),
            Phase::Stop => {}
        }
        tokio::select! {
            turn = actor.turn() => if let Some(acknowledged) = turn? {
                tally.add(acknowledged, now == Phase::Count);
                shared.acknowledged.fetch_add(1, Ordering::Relaxed);
            },
            changed = phase.changed() => if changed.is_err() {
                // Whoever leads the case has given it up.
                return Ok(tally);
            },
        }
        if actor.is_held_back() != held_back {
            held_back = !held_back;
            if held_back {
                shared.held_back.fetch_add(1, Ordering::Relaxed);
            } else {
                shared.held_back.fetch_sub(1, Ordering::Relaxed);
            }
        }
    }
}
