//! The loop of `cross train`: owns the processes, carries out what the supervisor decides, shows how it goes.

use super::backoff::Backoff;
use super::progress::Progress;
use super::run_dir::RunDir;
use super::supervise::{Cause, Command, Ending, Event, Limits, Supervisor};
use super::watch::Watch;
use crate::failure::{Failure, Outcome};
use cross_proto::v1::training_status::Phase;
use cross_support::child::{Process, sibling};
use std::ffi::OsString;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Between two looks at the processes.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// What a drain may take beyond the learner's own limit: the update in progress, and the checkpoint.
const DRAIN_MARGIN: Duration = Duration::from_secs(60);
/// How long actors may take to end once the learner has: a little beyond their own grace period.
const ACTOR_GRACE: Duration = Duration::from_secs(12);
/// How long the learner may take from its start until it serves: networks and the checkpoint are read by then.
const READY: Duration = Duration::from_secs(120);
/// Deaths of one process without any progress of the training that are too many.
const DEATHS_IN_VAIN: u32 = 5;

/// What every child is told, so that variables in the environment, meant for a cluster, change nothing here.
const SETTLED: [&str; 4] = ["--metrics-listen", "127.0.0.1:0", "--log-format", "text"];

/// What the loop needs to know.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) actors: usize,
    pub(crate) updates: u64,
    pub(crate) drain_seconds: u64,
    pub(crate) resume: bool,
    /// Where the learner copies checkpoints; empty for nowhere.
    pub(crate) checkpoint_url: String,
    pub(crate) sumo_home: PathBuf,
    /// File of the token that all calls carry. One from a variable reaches the processes by itself.
    pub(crate) token_file: Option<PathBuf>,
}

/// How training ended, when it did not fail.
#[derive(Debug)]
pub(crate) struct Trained {
    /// Stopped on request before the last update.
    pub(crate) interrupted: bool,
    /// Stopped on request when the last update was done or nearly so: complete, but nothing more is to be begun.
    pub(crate) stopped_at_the_end: bool,
    /// Ctrl-C twice: nothing was drained.
    pub(crate) killed: bool,
}

struct Cluster<'a> {
    run: &'a RunDir,
    plan: &'a Plan,
    learner_program: PathBuf,
    actor_program: PathBuf,
    learner: Option<Process>,
    /// `host:port` once the learner has served for the first time; it comes back there.
    address: Option<String>,
    learner_ready: bool,
    actors: Vec<Option<Process>>,
    /// What the learner, and the actor that ended last, had to say at their ends.
    learner_words: Option<String>,
    actor_words: Option<String>,
}

/// Trains until the updates are done, a stop is asked for, or it cannot go on.
///
/// Must be called from the main thread: the children die with the thread that starts them.
pub(crate) fn run(run: &RunDir, plan: &Plan, watch: &Watch, progress: &mut Progress) -> Outcome<Trained> {
    let mut supervisor = Supervisor::new(plan.actors, limits(plan));
    let mut cluster = Cluster {
        run,
        plan,
        learner_program: sibling("cross-learner")?,
        actor_program: sibling("cross-actor")?,
        learner: None,
        address: None,
        learner_ready: false,
        actors: (0..plan.actors).map(|_| None).collect(),
        learner_words: None,
        actor_words: None,
    };
    let started = Instant::now();
    let mut commands = supervisor.start();
    loop {
        if let Some(ending) = cluster.carry_out(commands, watch, progress)? {
            progress.finish();
            return cluster.conclude(ending);
        }
        let (status, stops) = watch.wait(LOOK_EVERY);
        let now = started.elapsed();
        commands = Vec::new();
        for _ in 0..stops {
            commands.extend(supervisor.handle(now, Event::StopAsked));
        }
        if let Some(status) = status {
            commands.extend(supervisor.handle(now, Event::Updates(status.updates)));
            if matches!(status.phase(), Phase::Draining | Phase::Complete) {
                commands.extend(supervisor.handle(now, Event::LearnerLeaving));
            }
            progress.show(&status, supervisor.actors_alive());
        }
        for event in cluster.look() {
            commands.extend(supervisor.handle(now, event));
        }
        commands.extend(supervisor.handle(now, Event::Tick));
    }
}

fn limits(plan: &Plan) -> Limits {
    Limits {
        learner: Backoff::new(Duration::from_millis(500), Duration::from_secs(10), 6),
        actor: Backoff::new(Duration::from_millis(500), Duration::from_secs(10), 6),
        in_vain: DEATHS_IN_VAIN,
        ready: READY,
        drain: Duration::from_secs(plan.drain_seconds) + DRAIN_MARGIN,
        actor_grace: ACTOR_GRACE,
    }
}

impl Cluster<'_> {
    /// What has happened to the processes since the last look.
    fn look(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        if let Some(exit) = self.learner.as_mut().and_then(Process::ended) {
            self.learner_words = self.learner.take().and_then(|learner| learner.last_words());
            self.learner_ready = false;
            let saved = self.updates_on_disk();
            events.push(Event::LearnerExited { exit, saved, complete: saved >= self.plan.updates });
        } else if !self.learner_ready && self.find_learner() {
            self.learner_ready = true;
            events.push(Event::LearnerReady);
        }
        for (actor, slot) in self.actors.iter_mut().enumerate() {
            if let Some(exit) = slot.as_mut().and_then(Process::ended) {
                self.actor_words = slot.take().and_then(|actor| actor.last_words());
                events.push(Event::ActorExited { actor, exit });
            }
        }
        events
    }

    /// Whether the learner that runs now has told where it listens; notes the address.
    fn find_learner(&mut self) -> bool {
        let Some(learner) = &self.learner else { return false };
        let Some(listening) = Listening::read(&self.run.learner_json()) else { return false };
        // A file that an earlier process left says nothing about this one.
        if listening.pid != learner.pid() {
            return false;
        }
        self.address = Some(listening.grpc.trim_start_matches("http://").to_owned());
        true
    }

    /// Does what the supervisor says; how it all ended, once it has.
    fn carry_out(
        &mut self,
        commands: Vec<Command>,
        watch: &Watch,
        progress: &Progress,
    ) -> Outcome<Option<Ending>> {
        for command in commands {
            match command {
                Command::StartLearner { again } => self.start_learner(again)?,
                Command::StartActor { actor } => {
                    if let Some(address) = self.address.clone() {
                        watch.learner_at(&address);
                        self.start_actor(actor, &address)?;
                    }
                }
                Command::StopLearner => {
                    if let Some(learner) = &self.learner {
                        learner.terminate();
                    }
                }
                Command::KillLearner => self.learner.iter().for_each(Process::kill),
                Command::StopActor { actor } => {
                    if let Some(Some(actor)) = self.actors.get(actor) {
                        actor.terminate();
                    }
                }
                Command::KillAll => {
                    self.actors.iter().flatten().chain(&self.learner).for_each(Process::kill);
                }
                Command::Tell(text) => progress.tell(&text),
                Command::Finish(ending) => return Ok(Some(ending)),
            }
        }
        Ok(None)
    }

    fn start_learner(&mut self, again: bool) -> Outcome<()> {
        let listen = self.address.clone().unwrap_or_else(|| "127.0.0.1:0".to_owned());
        let mut arguments: Vec<OsString> = vec![
            "--config".into(),
            self.run.config().into(),
            "--run".into(),
            self.run.path().into(),
            "--listen".into(),
            listen.into(),
        ];
        arguments.extend(self.settled());
        // Also where there is none, so that a variable, meant for a cluster, changes nothing.
        arguments.extend(["--checkpoints".into(), self.plan.checkpoint_url.clone().into()]);
        // A learner that died before its first checkpoint has nothing to go on from; what a store has, the learner finds out.
        let saved = self.run.has_checkpoints() || !self.plan.checkpoint_url.is_empty();
        if (self.plan.resume || again) && saved {
            arguments.push("--resume".into());
        }
        self.learner = Some(Process::start(&self.learner_program, &arguments, &self.run.log("learner"))?);
        Ok(())
    }

    fn start_actor(&mut self, actor: usize, address: &str) -> Outcome<()> {
        let name = format!("actor-{actor}");
        let mut arguments: Vec<OsString> = vec![
            "--learner".into(),
            format!("http://{address}").into(),
            "--actor-id".into(),
            name.clone().into(),
            "--sumo-home".into(),
            self.plan.sumo_home.clone().into(),
        ];
        arguments.extend(self.settled());
        let process = Process::start(&self.actor_program, &arguments, &self.run.log(&name))?;
        if let Some(slot) = self.actors.get_mut(actor) {
            *slot = Some(process);
        }
        Ok(())
    }

    /// What learner and actors are told alike.
    fn settled(&self) -> impl Iterator<Item = OsString> {
        let token = self.plan.token_file.iter().flat_map(|file| ["--token-file".into(), file.into()]);
        SETTLED.into_iter().map(OsString::from).chain(token)
    }

    /// Updates that the newest checkpoint holds.
    fn updates_on_disk(&self) -> u64 {
        self.run.newest_checkpoint().map_or(0, |(_, metadata)| metadata.updates)
    }

    /// The result, or the sentence that says why there is none.
    fn conclude(self, ending: Ending) -> Outcome<Trained> {
        let trained = Trained { interrupted: false, stopped_at_the_end: false, killed: false };
        let cause = match ending {
            Ending::Complete { stopped } => return Ok(Trained { stopped_at_the_end: stopped, ..trained }),
            Ending::Interrupted => return Ok(Trained { interrupted: true, ..trained }),
            Ending::Killed => return Ok(Trained { interrupted: true, killed: true, ..trained }),
            Ending::Failed(cause) => cause,
        };
        let resume = if self.run.has_checkpoints() {
            format!(
                "continue from its newest checkpoint with `cross train --resume --run {}`",
                self.run.path().display()
            )
        } else {
            "there is no checkpoint yet to continue from".to_owned()
        };
        let log = |process: &str| self.run.log(process).display().to_string();
        let words = |words: &Option<String>| match words {
            Some(words) => format!("{words}; "),
            None => String::new(),
        };
        let learner = words(&self.learner_words);
        let actor = words(&self.actor_words);
        Err(match cause {
            // The process has said all that is to say, in a sentence of its own.
            Cause::LearnerInput => Failure::input(
                self.learner_words
                    .clone()
                    .unwrap_or_else(|| format!("the learner refused its input; see {}", log("learner"))),
            ),
            Cause::ActorInput { actor } => Failure::input(self.actor_words.clone().unwrap_or_else(|| {
                format!("actor {actor} refused its input; see {}", log(&format!("actor-{actor}")))
            })),
            Cause::LearnerNeverReady(exit) => Failure::failed(format!(
                "the learner {exit} before it served: {learner}see {}",
                log("learner")
            )),
            Cause::LearnerNeverServed { seconds } => Failure::failed(format!(
                "the learner did not serve within {seconds} s of its start and was killed: {learner}see {}",
                log("learner")
            )),
            Cause::LearnerInVain { exit, deaths } => Failure::failed(format!(
                "the learner {exit}, its {deaths}th end without a checkpoint that goes further: {learner}see {}",
                log("learner")
            )),
            Cause::DrainFailed(exit) => Failure::failed(format!(
                "the learner {exit} when it was to stop, without all that it was to save: {learner}{resume}, and see {}",
                log("learner")
            )),
            Cause::LearnerRestarts { exit, per_minute } => Failure::failed(format!(
                "the learner {exit}, after {per_minute} restarts within a minute: {learner}see {}",
                log("learner")
            )),
            Cause::ActorRestarts { actor: number, exit, per_minute } => Failure::failed(format!(
                "every actor died {} times within a minute, the last one, actor {number}, {exit}: {actor}see {}",
                per_minute + 1,
                log(&format!("actor-{number}"))
            )),
            Cause::ActorsInVain { actor: number, exit, deaths } => Failure::failed(format!(
                "every actor keeps dying and no update gets done; the last one, actor {number}, {exit}, \
                 its {deaths}th end since the last update: {actor}see {}",
                log(&format!("actor-{number}"))
            )),
            Cause::Hung => Failure::failed(format!(
                "the learner did not finish its drain and was killed; {resume}, and see {}",
                log("learner")
            )),
        })
    }
}

/// What the learner writes once it serves.
#[derive(Debug, serde::Deserialize)]
struct Listening {
    pid: u32,
    /// `host:port` of the gRPC services.
    grpc: String,
}

impl Listening {
    fn read(path: &std::path::Path) -> Option<Self> {
        serde_json::from_slice(&std::fs::read(path).ok()?).ok()
    }
}
