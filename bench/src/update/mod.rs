//! `cross bench update`: a PPO update as it runs beside the same update in plain padded form, what a decision costs in
//! rounds of different size, and how much memory an update takes.

pub mod data;
mod export;

pub use export::export;

use crate::cost::measured;
use crate::error::BenchError;
use crate::memory;
use crate::plain::PlainLearner;
use crate::progress::Progress;
use crate::report::{Better, Report, Row, median};
use cross_config::{ComputeDevice, Config, Detection, Gfe};
use cross_model::{ModelError, Trainer};
use cross_sim::trajectory::Fragment;
use data::Named;

/// The paper's algorithm: 6 epochs, one episode of each network.
const PAPER: &str = include_str!("../../../configs/paper.toml");
/// Decisions of an agent in an episode.
const STEPS: u32 = 360;
const MEGABYTE: f64 = 1e6;
/// Sizes of rounds whose cost per decision is compared: (episodes, steps) on the 25 intersections of grid5x5.
const ROUNDS: [(u64, u32); 3] = [(1, 40), (1, 400), (10, 400)];

/// What to measure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Options {
    /// Repetitions of each side.
    pub repeats: u32,
    /// Epochs of an update.
    pub epochs: u32,
    /// Forms of feature extraction.
    pub forms: Vec<Gfe>,
}

/// Measures.
///
/// # Errors
/// [`BenchError`] if the configuration or the data cannot be learned from.
pub fn run(options: &Options, progress: Progress<'_>) -> Result<Report, BenchError> {
    cross_model::set_single_threaded();
    let mut rows = Vec::new();
    for &form in &options.forms {
        compare(form, options, progress, &mut rows)?;
    }
    for &form in &options.forms {
        scale(form, progress, &mut rows)?;
    }
    Ok(Report::new("update", rows))
}

/// The configuration that is measured: the paper's algorithm with one form of features.
///
/// # Errors
/// As [`Config::from_toml`], which the project's own file does not give.
pub fn config(form: Gfe, epochs: u32) -> Result<Config, BenchError> {
    let mut config = Config::from_toml(PAPER, "configs/paper.toml")?;
    config.model.gfe = form;
    if form == Gfe::Movement {
        config.env.detection = Detection::Default;
    }
    config.ppo.epochs = epochs;
    config.learner.device = ComputeDevice::Cpu;
    Ok(config)
}

/// Ours and the plain form by turns, on one episode of each of the three networks.
fn compare(
    form: Gfe,
    options: &Options,
    progress: Progress<'_>,
    rows: &mut Vec<Row>,
) -> Result<(), BenchError> {
    let config = config(form, options.epochs)?;
    let networks = data::layouts(&config.env, &|line| progress(line));
    let agents: usize = networks.iter().map(|(_, layout)| layout.agents()).sum();
    let fragments = data::episodes(&networks, &config, STEPS, 1);
    let name = name(form);
    let mut trainer = Trainer::new(&config, networks.clone())?;
    let mut plain = PlainLearner::new(&config, networks, &trainer.snapshot()?)?;
    let (mut ours, mut theirs, mut peaks) = (Vec::new(), Vec::new(), Vec::new());
    for repeat in 1..=options.repeats {
        let seconds = timed(|| trainer.update(&fragments).map(drop))?;
        // The first ever in this process: later ones find memory that the plain form has left behind.
        if repeat == 1 {
            peaks.push(memory::peak()? as f64 / MEGABYTE);
        }
        progress(&format!("{name}: {repeat} of {}: ours {seconds:.1} s", options.repeats));
        ours.push(seconds);
        let seconds = timed(|| plain.update(&fragments, options.epochs))?;
        if repeat == 1 {
            peaks.push(memory::peak()? as f64 / MEGABYTE);
        }
        progress(&format!("{name}: {repeat} of {}: plain {seconds:.1} s", options.repeats));
        theirs.push(seconds);
    }
    let case = format!("update, {name}, T={STEPS}, N={agents}, {} epochs", options.epochs);
    let baseline = "the same in plain padded form";
    rows.push(Row::new(&case, "CPU s", Better::Lower, median(&ours), (baseline, median(&theirs))));
    let case = format!("its peak memory, {name}");
    rows.push(Row::new(case, "MB", Better::Lower, peaks[0], (baseline, peaks[1])));
    Ok(())
}

/// Seconds of processor time that something took. All of it runs on this thread, so on an idle machine the clock shows the
/// same; other programs disturb this figure less.
fn timed(work: impl FnOnce() -> Result<(), ModelError>) -> Result<f64, BenchError> {
    Ok(measured(|| Ok(work()?))?.1.own_cpu)
}

/// What a decision costs in rounds of 1,000, 10,000 and 100,000, and what memory they take.
fn scale(form: Gfe, progress: Progress<'_>, rows: &mut Vec<Row>) -> Result<(), BenchError> {
    let config = config(form, 1)?;
    let networks: Vec<Named> = data::layouts(&config.env, &|line| progress(line)).split_off(2);
    let mut first = None;
    for (episodes, steps) in ROUNDS {
        let fragments: Vec<Fragment> =
            (0..episodes).flat_map(|number| data::episodes(&networks, &config, steps, number)).collect();
        let decisions = fragments.iter().map(|fragment| fragment.actions.len()).sum::<usize>();
        let mut trainer = Trainer::new(&config, networks.clone())?;
        memory::reset_peak();
        let repeats = (20_000 / decisions).clamp(1, 9);
        let seconds = timed(|| (0..repeats).try_for_each(|_| trainer.update(&fragments).map(drop)))?;
        let cost = seconds * 1e6 / (repeats * decisions) as f64;
        let peak = memory::peak()? as f64 / MEGABYTE;
        progress(&format!("{}: {decisions} decisions: {cost:.0} us each, peak {peak:.0} MB", name(form)));
        let (first_cost, first_peak) = *first.get_or_insert((cost, peak));
        let case = format!("a decision among {decisions}, {}, 1 epoch", name(form));
        rows.push(Row::new(case, "CPU us", Better::Lower, cost, ("a decision among 1000", first_cost)));
        let case = format!("peak memory of {decisions} decisions, {}", name(form));
        rows.push(Row::new(case, "MB", Better::Lower, peak, ("with 1000 decisions", first_peak)));
    }
    Ok(())
}

fn name(form: Gfe) -> &'static str {
    match form {
        Gfe::Paper => "paper",
        Gfe::Movement => "movement",
    }
}
