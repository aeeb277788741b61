//! A campaign: one training run, one fault after another, and the end that every run has to come to.

use super::Broken;
use super::clock;
use super::inject::{Kind, afterwards, inject};
use super::plan::plan;
use super::report::{Report, Struck};
use super::world::{CONFIG, Setting, World};
use crate::binaries::binary;
use crate::processes;
use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Updates after the last fault: the target is set when it is over, since nobody can say before how far a run comes.
const UPDATES_AFTER: u64 = 20;
/// Throughput that is not back by then will not come back.
const NEVER: u64 = 90;

/// A minute, which is usual, is too long to wait for each SUMO that hangs.
const HUNG_SUMO: u64 = 5;
/// A short lease, so that pauses and cuts outlast it.
const LEARNER: &str = "device = \"cpu\"\nlease_seconds = 10\n";

/// What to do.
#[derive(Debug, Clone)]
pub struct Campaign {
    /// Decides everything about the faults.
    pub seed: u64,
    /// How many.
    pub faults: usize,
    /// Actors.
    pub actors: usize,
    /// Length of the longest faults, as a share of the longest of their kind.
    pub longest: f64,
    /// Updates from one checkpoint to the next.
    pub checkpoint_updates: u64,
    /// Only these kinds; all if empty. For the search for a cause.
    pub only: Vec<Kind>,
    /// Time without a fault at the beginning, to learn what is usual.
    pub warm_up: Duration,
    /// Time without a fault between two.
    pub rest: Duration,
    /// How many times longer than usual the suite waits before it calls something broken: 1 where time is the subject, more
    /// where the machine may have much else to do.
    pub patience: u32,
}

impl Campaign {
    /// Runs it; `tell` gets a line for each fault.
    ///
    /// # Errors
    /// What did not hold, with the ends of all logs, and the report of what was before.
    pub fn run(&self, mut tell: impl FnMut(&str)) -> Result<Report, Box<(Broken, String, Report)>> {
        let config = format!(
            "{CONFIG}sumo_timeout_seconds = {HUNG_SUMO}\n[learner]\ncheckpoint_updates = {}\n{LEARNER}",
            self.checkpoint_updates
        );
        let setting = Setting {
            actors: self.actors,
            updates: 1_000_000,
            config,
            instrumented: true,
            patience: self.patience,
        };
        let mut world = World::new(setting);
        let mut report = Report::new(self.seed, self.actors);
        let begun = Instant::now();
        let ended = self.strike(&mut world, &mut report, &mut tell).and_then(|()| {
            tell("no more faults; the run goes on to its target");
            finish(&mut world)
        });
        report.seconds = begun.elapsed().as_secs_f64();
        report.fragments = world.invariants.fragments();
        report.peaks = world.invariants.peaks();
        let marker = world.marker();
        let ended = ended.map(|updates| report.updates = updates);
        match ended {
            Ok(()) => {
                drop(world);
                clock::sweep();
                processes::assert_none_left(&marker);
                Ok(report)
            }
            Err(broken) => {
                let tails = world.tails(25);
                let kept = world.keep_logs();
                Err(Box::new((broken, format!("{tails}all logs: {}", kept.display()), report)))
            }
        }
    }

    fn strike(
        &self,
        world: &mut World,
        report: &mut Report,
        tell: &mut impl FnMut(&str),
    ) -> Result<(), Broken> {
        world.until("the first update", 120, |world| {
            world.status().is_some_and(|status| status.updates > 0).then_some(())
        })?;
        world.undisturbed(self.warm_up)?;
        let faults = plan(self.seed, self.faults, self.actors, self.longest);
        for (number, mut fault) in faults.into_iter().enumerate() {
            if !self.only.is_empty() {
                fault.kind = self.only[number % self.only.len()];
            }
            world.undisturbed(self.rest + fault.wait)?;
            let began = Instant::now();
            let over = inject(world, &fault)?;
            let lasted = over.since.saturating_duration_since(began);
            let recovery = world.recover(&over, NEVER)?;
            afterwards(world, &over)?;
            let struck = Struck { kind: fault.kind, lasted, recovery };
            tell(&format!(
                "{:>3} of {}  {:<48}  lasted {:>4.1} s, back after {:>4.1} s; {} decisions in 2 s are usual",
                number + 1,
                self.faults,
                fault.kind.what(),
                lasted.as_secs_f64(),
                recovery.as_secs_f64(),
                world.flow.usual()
            ));
            report.struck.push(struck);
        }
        Ok(())
    }
}

/// Has the run end as every run has to: its updates done, everybody gone with exit code 0, the last checkpoint sound.
fn finish(world: &mut World) -> Result<u64, Broken> {
    let now = world.until("a status", 30, |world| world.status().map(|status| status.updates))?;
    let target = now + UPDATES_AFTER;
    world.train_up_to(target);
    let lives = world.learner.lives();
    world.exits.clear();
    if !world.learner.signal(Signal::TERM) {
        return Err(Broken::new("training reaches its target", "the learner was not there to be told"));
    }
    world.until("the last learner", 60, |world| (world.learner.lives() > lives).then_some(()))?;
    world.learner.hold(true);
    for actor in &mut world.actors {
        actor.hold(true);
    }
    let count = world.actors.len() + 2;
    world.until("the end of the run", 240, |world| (world.exits.len() >= count).then_some(()))?;
    if let Some(exit) = world.exits.iter().find(|exit| exit.code != Some(0)) {
        return Err(Broken::new(
            "training reaches its target",
            format!("not every process ended well: {exit}"),
        ));
    }
    let run = world.run();
    world.invariants.look_at_checkpoints(&run)?;
    check_metrics(&run, target).map_err(|seen| Broken::new("training reaches its target", seen))?;
    verify(&run, target)?;
    Ok(target)
}

/// Updates in order, each at most once; a disk that was full may have swallowed some.
fn check_metrics(run: &Path, target: u64) -> Result<(), String> {
    let text = std::fs::read_to_string(run.join("metrics.jsonl")).map_err(|error| error.to_string())?;
    let mut last = 0;
    for line in text.lines() {
        let line: Value = serde_json::from_str(line).map_err(|error| format!("{error} in {line:?}"))?;
        let update = line["update"].as_u64().ok_or("a line of metrics.jsonl has no update")?;
        if update <= last {
            return Err(format!("update {update} comes after update {last} in metrics.jsonl"));
        }
        last = update;
    }
    if last == target {
        Ok(())
    } else {
        Err(format!("metrics.jsonl ends at update {last} instead of {target}"))
    }
}

/// As a person would.
fn verify(run: &Path, updates: u64) -> Result<(), Broken> {
    let output = Command::new(binary("cross"))
        .args(["checkpoint", "verify", &format!("{updates:06}"), "--run"])
        .arg(run)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    if output.status.success() {
        return Ok(());
    }
    Err(Broken::new("checkpoints loadable", String::from_utf8_lossy(&output.stderr).into_owned()))
}
