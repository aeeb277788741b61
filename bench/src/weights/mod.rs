//! `cross bench weights`: how long a new version takes to reach the last of one to a thousand watchers, and what they cost the
//! learner, beside tonic's own server stream of the same bytes.
//!
//! ```text
//!   one simulated actor ── a round's data ──> cross-learner ── a real update ── new version ──> watchers
//!                                    Resume ─> bare server ── the same bytes, the next version ──> watchers
//! ```
//! The clock runs from the moment at which a server publishes, by its own account, until the last watcher has put the snapshot
//! together and checked it. Rounds are small, so that an update takes a moment; the networks, and so the snapshot, are of the
//! default size. What an update itself takes of processor and memory is measured without watchers first, and taken off.

mod crowd;
mod source;

use crate::cluster::recording::Recording;
use crate::cluster::sampler::Sampler;
use crate::cluster::{self, Setup, limits};
use crate::cost::cpu_of;
use crate::error::BenchError;
use crate::memory;
use crate::progress::Progress;
use crate::report::{Better, Report, Row, median};
use cross_config::Config;
use crowd::Crowd;
use source::Source;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

const BARE: &str = "tonic's server stream";
const MEGABYTE: f64 = 1e6;
const KILOBYTE: f64 = 1e3;
/// Steps of a round, and of the one fragment that fills it.
const ROUND_STEPS: u32 = 10;
/// Versions before anything is measured: what libtorch allocates once is then allocated.
const WARM_UP: u32 = 2;
/// Watchers from which on the processor time of one version is more than the kernel's clock ticks.
const MEASURABLE: usize = 100;
/// Least memory that is told from none.
const PAGE: f64 = 4096.0;
/// After which a server's memory is looked at with nothing going on.
const SETTLE: Duration = Duration::from_millis(500);

/// What to measure.
#[derive(Debug)]
pub struct Options {
    /// Programs, and the network of the recorded episode.
    pub setup: Setup,
    /// Watchers, one case after another.
    pub watchers: Vec<usize>,
    /// New versions in each case; medians count.
    pub versions: u32,
}

/// Measures.
///
/// # Errors
/// [`BenchError`] if a server fails, a watcher is left out, or a version is encoded more than once.
pub fn run(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    let most = options.watchers.iter().copied().max().unwrap_or(1);
    limits::raise(most)?;
    let config = config(&options.setup.name, most);
    config.validate()?;
    let recording = options.setup.record(&config, progress)?;
    let rows = cluster::run(measure(options, &config, &recording, progress))?;
    Ok(Report::new("weights", rows))
}

/// A learner that updates on every fragment, and has little else to do.
fn config(scenario: &str, watchers: usize) -> Config {
    let mut config = Config { scenarios: vec![scenario.to_owned()], updates: 1_000_000, ..Config::default() };
    config.ppo.round_steps = ROUND_STEPS;
    config.ppo.sequence_steps = ROUND_STEPS;
    config.actor.fragment_steps = ROUND_STEPS;
    config.learner.checkpoint_updates = 1_000_000;
    limits::configure(&mut config, watchers);
    config
}

async fn measure(
    options: &Options,
    config: &Config,
    recording: &Arc<Recording>,
    progress: Progress<'_>,
) -> Result<Vec<Row>, BenchError> {
    let mut rows = Vec::new();
    for &watchers in &options.watchers {
        let source = Source::learner(&options.setup.programs, config, recording).await?;
        let (ours, snapshot) = whole_case(source, watchers, options.versions).await?;
        progress(&format!("{watchers} watchers of {} bytes, the learner: {ours}", snapshot.len()));
        let source = Source::bare(&options.setup.programs, &snapshot).await?;
        let (bare, _) = whole_case(source, watchers, options.versions).await?;
        progress(&format!("{watchers} watchers, the bare server: {bare}"));
        compare(watchers, &ours, &bare, &mut rows);
    }
    Ok(rows)
}

/// What a case came to.
#[derive(Debug, Clone, Copy)]
struct Figures {
    /// From publication until the last watcher has it.
    seconds: f64,
    /// Seconds of CPU of the server for a version, more than without watchers; likewise below.
    cpu: f64,
    /// Bytes with all connected and nothing going on.
    idle: f64,
    /// Most bytes from the update on until the last watcher has it.
    sending: f64,
    /// Bytes after all have gone.
    after: f64,
    /// Encodings of a version.
    encodings: f64,
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [idle, sending, after] = [self.idle, self.sending, self.after].map(|bytes| bytes / MEGABYTE);
        write!(
            f,
            "{:.1} ms to the last; memory above that without watchers {idle:.1} MB at rest, {sending:.1} MB while sending, {after:.1} MB after; {:.0} encodings a version",
            self.seconds * 1e3,
            self.encodings
        )
    }
}

/// A case, and the server's end if it is that which went wrong.
async fn whole_case(
    mut source: Source,
    watchers: usize,
    versions: u32,
) -> Result<(Figures, Vec<u8>), BenchError> {
    let result = case(&mut source, watchers, versions).await;
    source.alive()?;
    result
}

async fn case(source: &mut Source, watchers: usize, versions: u32) -> Result<(Figures, Vec<u8>), BenchError> {
    let pid = source.pid();
    for _ in 0..WARM_UP {
        source.publish().await?;
    }
    let mut alone = Costs::default();
    for _ in 0..versions {
        alone.of_version(pid, source, None).await?;
    }
    tokio::time::sleep(SETTLE).await;
    let before = memory::resident_of(pid)?;
    let mut crowd = Crowd::open(source.address(), watchers);
    // The newest version comes at once to everybody.
    let _ = crowd.all_have(source.version).await?;
    tokio::time::sleep(SETTLE).await;
    let idle = memory::resident_of(pid)?;
    let encoded = source.encoded().await?;
    let mut watched = Costs::default();
    for _ in 0..versions {
        watched.of_version(pid, source, Some(&mut crowd)).await?;
    }
    let encodings = source.encoded().await? - encoded;
    if source.encodes_once() && encodings != u64::from(versions) {
        return Err(BenchError::Encodings { encoded: encodings, versions: versions.into() });
    }
    let snapshot = crowd.close();
    tokio::time::sleep(SETTLE).await;
    let after = memory::resident_of(pid)?;
    let figures = Figures {
        seconds: median(&watched.seconds),
        cpu: median(&watched.cpu) - median(&alone.cpu),
        idle: idle.saturating_sub(before) as f64,
        sending: watched.most.saturating_sub(alone.most) as f64,
        after: after.saturating_sub(before) as f64,
        encodings: encodings as f64 / f64::from(versions),
    };
    Ok((figures, snapshot))
}

/// What versions cost a server, each from its update on.
#[derive(Debug, Default)]
struct Costs {
    seconds: Vec<f64>,
    cpu: Vec<f64>,
    most: u64,
}

impl Costs {
    /// Measures one, until all who watch have it.
    async fn of_version(
        &mut self,
        pid: u32,
        source: &mut Source,
        crowd: Option<&mut Crowd>,
    ) -> Result<(), BenchError> {
        let (sampler, cpu) = (Sampler::start(pid)?, cpu_of(pid)?);
        source.publish().await?;
        if let Some(crowd) = crowd {
            let last = crowd.all_have(source.version).await?;
            self.seconds.push(last - source.published_at().await?);
        }
        self.cpu.push(cpu_of(pid)? - cpu);
        self.most = self.most.max(sampler.most());
        Ok(())
    }
}

fn compare(watchers: usize, ours: &Figures, bare: &Figures, rows: &mut Vec<Row>) {
    let all = watchers as f64;
    let plural = if watchers == 1 { "watcher" } else { "watchers" };
    let mut row = |what: &str, unit: &str, ours: f64, theirs: f64| {
        let case = format!("{what}, {watchers} {plural}");
        rows.push(Row::new(case, unit, Better::Lower, ours, (BARE, theirs)));
    };
    row("a version at the last", "ms", ours.seconds * 1e3, bare.seconds * 1e3);
    if watchers >= MEASURABLE {
        row("server, CPU of a version", "ms", ours.cpu * 1e3, bare.cpu * 1e3);
    }
    let kilobytes = |bytes: f64| bytes.max(PAGE) / KILOBYTE;
    row("server, memory of one at rest", "kB", kilobytes(ours.idle) / all, kilobytes(bare.idle) / all);
    row(
        "server, memory of one while sending",
        "kB",
        kilobytes(ours.sending) / all,
        kilobytes(bare.sending) / all,
    );
    row("server, memory left after they went", "kB", kilobytes(ours.after), kilobytes(bare.after));
    row("encodings of a version", "1", ours.encodings, bare.encodings);
}
