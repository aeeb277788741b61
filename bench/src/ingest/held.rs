//! What a learner holds of actors that it holds back: the bound on its memory.

use super::MEGABYTE;
use super::drive::{Crowd, Phase, Shared};
use crate::cluster::actor::Peer;
use crate::cluster::learner::Learner;
use crate::cluster::recording::Recording;
use crate::cluster::{Programs, client};
use crate::error::BenchError;
use crate::memory;
use crate::progress::Progress;
use crate::report::{Better, Row};
use cross_config::Config;
use cross_proto::v1;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Bytes by which memory moves at most when nothing more is taken in.
const STILL: u64 = 1 << 20;

/// Fills the buffer of the default configuration while training is paused, until every actor has as many fragments in flight
/// as it may, and compares what that takes with the fragments' bytes on the wire.
pub(super) async fn measure(
    programs: &Programs,
    config: &Config,
    actors: usize,
    recording: &Arc<Recording>,
    progress: Progress<'_>,
) -> Result<Row, BenchError> {
    let mut learner = Learner::start(&programs.learner, config).await?;
    let mut training = client::training(&learner.address).await?;
    training.pause(v1::PauseRequest {}).await.map_err(client::failed("Pause"))?;
    let held = fill(&learner, actors, recording).await;
    learner.server.alive()?;
    let (bytes, buffered) = held?;
    let waiting = (actors * config.actor.unacked_fragments) as u64;
    let wire = (waiting + buffered) as f64 * recording.wire_bytes();
    progress(&format!(
        "{actors} actors held back: {:.0} MB for {waiting} fragments that wait and {buffered} in the buffer",
        bytes as f64 / MEGABYTE
    ));
    let case = format!("learner, memory that holds back {actors} actors");
    let baseline = ("the same fragments on the wire", wire / MEGABYTE);
    Ok(Row::new(case, "MB", Better::Lower, bytes as f64 / MEGABYTE, baseline))
}

/// Bytes by which the learner has grown, and fragments in its buffer, once it holds every actor back.
async fn fill(
    learner: &Learner,
    actors: usize,
    recording: &Arc<Recording>,
) -> Result<(u64, u64), BenchError> {
    let pid = learner.server.pid();
    let mut crowd = Crowd::open(Peer::Learner, &learner.address, actors, recording).await?;
    let rest = memory::resident_of(pid)?;
    crowd.phase.send_replace(Phase::Warm);
    let held_back = |shared: &Shared| shared.held_back.load(Ordering::Relaxed);
    crowd.until("as far as the buffer lets them", held_back, actors).await?;
    // What was sent is not there yet: only when the learner has taken it in does its memory tell.
    let mut before = 0;
    loop {
        let now = memory::resident_of(pid)?;
        if now.abs_diff(before) < STILL {
            return Ok((now.saturating_sub(rest), crowd.shared.acknowledged.load(Ordering::Relaxed)));
        }
        before = now;
        crowd.settle().await?;
    }
}
