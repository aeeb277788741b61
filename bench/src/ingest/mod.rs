//! `cross bench ingest`: what one learner takes from one to a thousand actors, beside what tonic alone takes of the same bytes.
//!
//! ```text
//!   simulated actors ── recorded fragments ──> cross-learner: decode, check, admit, insert, acknowledge
//!                  ├─── the same, ───────────> bare server: read, acknowledge
//!                  └─── the same, ───────────> bare server: read, keep, acknowledge
//! ```
//! Training is paused by `Training.Pause`, and the buffer is configured to hold all that is sent: an accepted fragment is then
//! one that was checked, inserted and acknowledged, and no update takes processor time or holds actors back. With updates, a
//! learner takes what these consume and holds the rest back; what that costs in memory is measured after, with the buffer of
//! the default configuration. What is kept needs new memory, which the kernel clears; a server that drops what it has read
//! uses the same pages again and again. So there are two baselines: one drops, and one keeps, as the learner has to.

mod drive;
mod held;
mod tally;

use crate::cluster::actor::Peer;
use crate::cluster::bare::{BareServer, Fragments};
use crate::cluster::learner::Learner;
use crate::cluster::recording::Recording;
use crate::cluster::{self, Setup, client, limits};
use crate::error::BenchError;
use crate::progress::Progress;
use crate::report::{Better, Report, Row};
use cross_config::Config;
use cross_proto::v1;
use drive::Load;
use std::sync::Arc;
use tally::Figures;

const BARE: &str = "a bare tonic stream";
const KEEPING: &str = "a bare tonic stream that keeps them";
const MEGABYTE: f64 = 1e6;
/// Most bytes of a fragment that an intersection and decision should cost.
const WIRE_AIM: f64 = 64.0;
/// Steps of a round while nothing is trained, the most that can be configured; the buffer holds as many rounds as are needed.
const ROUND_STEPS: u32 = 1_000_000;

/// What to measure.
#[derive(Debug)]
pub struct Options {
    /// Programs, and the network of the recorded episode.
    pub setup: Setup,
    /// Actors, one case after another.
    pub actors: Vec<usize>,
    /// Seconds in which acknowledgements count, at most.
    pub seconds: f64,
    /// Fragments after which a case ends before that: the learner keeps them all.
    pub fragments: u64,
}

/// Measures.
///
/// # Errors
/// [`BenchError`] if a server fails, or if the learner does not accept and acknowledge every fragment exactly once.
pub fn run(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    let most = options.actors.iter().copied().max().unwrap_or(1);
    limits::raise(most)?;
    let mut config = Config { scenarios: vec![options.setup.name.clone()], ..Config::default() };
    limits::configure(&mut config, most);
    let recording = options.setup.record(&config, progress)?;
    progress(&format!(
        "a fragment has {:.0} bytes on the wire, {:.1} a decision",
        recording.wire_bytes(),
        recording.wire_bytes() / recording.decisions()
    ));
    let rows = cluster::run(measure(options, &config, &recording, progress))?;
    Ok(Report::new("ingest", rows))
}

async fn measure(
    options: &Options,
    config: &Config,
    recording: &Arc<Recording>,
    progress: Progress<'_>,
) -> Result<Vec<Row>, BenchError> {
    let per_decision = recording.wire_bytes() / recording.decisions();
    let case = format!("bytes of a decision on the wire, {}", options.setup.scenario.name);
    let mut rows = vec![Row::new(case, "B", Better::Lower, per_decision, ("the aim", WIRE_AIM))];
    for &actors in &options.actors {
        let load = Load { actors, seconds: options.seconds, fragments: options.fragments, recording };
        let ours = by_learner(options, &roomy(config, &load), &load).await?;
        progress(&format!("{actors} actors, the learner: {ours}"));
        let bare = by_bare_server(options, &load, Fragments::Dropped).await?;
        progress(&format!("{actors} actors, the bare server: {bare}"));
        let keeping = by_bare_server(options, &load, Fragments::Kept).await?;
        progress(&format!("{actors} actors, the bare server, keeping all: {keeping}"));
        compare(actors, &ours, (&bare, &keeping), &mut rows);
    }
    if let Some(&most) = options.actors.iter().max() {
        rows.push(held::measure(&options.setup.programs, config, most, recording, progress).await?);
    }
    Ok(rows)
}

/// The configuration with a buffer that holds all that a case sends.
fn roomy(config: &Config, load: &Load<'_>) -> Config {
    let mut config = config.clone();
    let steps = load.most_fragments() * u64::from(config.actor.fragment_steps);
    config.ppo.round_steps = ROUND_STEPS;
    let rounds = steps.div_ceil(u64::from(ROUND_STEPS)) + 1;
    config.learner.buffered_rounds = u32::try_from(rounds).unwrap_or(u32::MAX);
    config
}

async fn by_learner(options: &Options, config: &Config, load: &Load<'_>) -> Result<Figures, BenchError> {
    config.validate()?;
    let mut learner = Learner::start(&options.setup.programs.learner, config).await?;
    let mut training = client::training(&learner.address).await?;
    training.pause(v1::PauseRequest {}).await.map_err(client::failed("Pause"))?;
    let figures = drive::run(Peer::Learner, &learner.address, learner.server.pid(), load).await;
    learner.server.alive()?;
    let figures = figures?;
    let series = format!(
        "cross_learner_fragments_total{{scenario=\"{}\",outcome=\"accepted\"}}",
        options.setup.scenario.name
    );
    let counted = learner.metric(&series).await? as u64;
    let (sent, acknowledged) = (figures.sent, figures.acknowledged);
    if sent != acknowledged || acknowledged != counted {
        return Err(BenchError::Miscounted { sent, acknowledged, counted });
    }
    Ok(figures)
}

async fn by_bare_server(
    options: &Options,
    load: &Load<'_>,
    fragments: Fragments,
) -> Result<Figures, BenchError> {
    let mut bare = BareServer::start(&options.setup.programs, b"no weights", fragments).await?;
    let figures = drive::run(Peer::Bare, &bare.address, bare.server.pid(), load).await;
    bare.server.alive()?;
    let figures = figures?;
    if fragments == Fragments::Kept {
        let mut training = client::training(&bare.address).await?;
        let status =
            training.get_status(v1::GetStatusRequest {}).await.map_err(client::failed("GetStatus"))?;
        let counted = status.into_inner().status.map_or(0, |status| status.episodes);
        if counted != figures.acknowledged {
            return Err(BenchError::Miscounted {
                sent: figures.sent,
                acknowledged: figures.acknowledged,
                counted,
            });
        }
    }
    Ok(figures)
}

fn compare(actors: usize, ours: &Figures, (bare, keeping): (&Figures, &Figures), rows: &mut Vec<Row>) {
    let plural = if actors == 1 { "actor" } else { "actors" };
    let case = |what: &str| format!("{what}, {actors} {plural}");
    let mut row = |what: &str, unit: &str, better, of: fn(&Figures) -> f64| {
        rows.push(Row::new(case(what), unit, better, of(ours), (BARE, of(bare))));
    };
    row("accepted decisions", "1/s", Better::Higher, |f| f.decisions_per_second);
    row("acknowledgement, median", "ms", Better::Lower, |f| f.median_ms);
    row("acknowledgement, 99 of 100", "ms", Better::Lower, |f| f.high_ms);
    row("slowest actor over the median one", "1", Better::Higher, |f| f.fairness);
    row("server, CPU of a fragment", "us", Better::Lower, |f| f.cpu_us);
    row("server, memory at rest", "MB", Better::Lower, |f| f.rest as f64 / MEGABYTE);
    row("server, peak memory", "MB", Better::Lower, |f| f.peak as f64 / MEGABYTE);
    let mut row = |what: &str, unit: &str, better, of: fn(&Figures) -> f64| {
        let case = case(&format!("{what} beside one that keeps"));
        rows.push(Row::new(case, unit, better, of(ours), (KEEPING, of(keeping))));
    };
    row("accepted decisions", "1/s", Better::Higher, |f| f.decisions_per_second);
    row("server, CPU of a fragment", "us", Better::Lower, |f| f.cpu_us);
    row("server, peak memory", "MB", Better::Lower, |f| f.peak as f64 / MEGABYTE);
}
