//! The coordinator: the one task that owns admission, and does what it commands.
//!
//! ```text
//!   services ── Request (bounded) ──> coordinator ── Work ──> trainer thread
//!      ^                                 │   ^                    │
//!      └── outboxes (bounded) ───────────┘   └────── Report ──────┘
//! ```
//! It never waits for anything but its two inputs: an actor that does not read its answers loses its stream.

mod outbox;
mod request;
mod status;

pub(crate) use outbox::Outbox;
pub(crate) use request::{Coordinator as Handle, Gone, JoinInfo, QUEUE as REQUEST_QUEUE, Request};

use crate::admission::{Admission, Command};
use crate::publish::Published;
use crate::telemetry::Telemetry;
use crate::trainer::{Report, Updated, Work};
use cross_model::ModelError;
use cross_proto::v1::{self, stream_fragments_response::Message};
use outbox::Outboxes;
use status::{Last, Rate, status};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

/// Failed updates in a row after which training makes no sense.
const MAX_FAILED_UPDATES: u32 = 3;

/// How often leases are looked at.
const TICK: Duration = Duration::from_secs(1);

/// Where the process is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Life {
    /// The model is being set up.
    Starting,
    /// Actors may join.
    Serving,
    /// The learner finishes what it must and takes nothing new.
    Draining,
}

/// How the learner's work ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// All updates are done and the last checkpoint is written.
    Complete,
    /// Asked to stop; the state is in a checkpoint.
    Drained,
    /// It could not go on; a sentence.
    Failed(String),
    /// The checkpoint or a scenario does not fit the model, so that starting again would end the same; a sentence.
    Unusable(String),
}

/// What the coordinator tells everybody.
#[derive(Debug)]
pub(crate) struct Channels {
    /// Where the process is in its life.
    pub(crate) life: watch::Sender<Life>,
    /// The state of training.
    pub(crate) status: watch::Sender<v1::TrainingStatus>,
    /// The newest weights.
    pub(crate) newest: watch::Sender<Option<Arc<Published>>>,
}

/// State of the task.
pub(crate) struct Coordinator {
    admission: Admission,
    outboxes: Outboxes,
    work: mpsc::Sender<Work>,
    telemetry: Telemetry,
    channels: Channels,
    run_id: String,
    started: Instant,
    last: Last,
    rate: Rate,
    sumo: String,
    checkpoint_waiters: Vec<oneshot::Sender<Result<String, String>>>,
    complete: bool,
    failed_updates: u32,
}

impl Coordinator {
    pub(crate) fn new(
        admission: Admission,
        run_id: String,
        latest_checkpoint: String,
        work: mpsc::Sender<Work>,
        telemetry: Telemetry,
        channels: Channels,
    ) -> Self {
        Self {
            admission,
            outboxes: Outboxes::default(),
            work,
            telemetry,
            channels,
            run_id,
            started: Instant::now(),
            last: Last { checkpoint: latest_checkpoint, ..Last::default() },
            rate: Rate::default(),
            sumo: String::new(),
            checkpoint_waiters: Vec::new(),
            complete: false,
            failed_updates: 0,
        }
    }

    /// Runs until training is complete, `drain` is cancelled and obeyed, or something fails; then says goodbye to the actors.
    pub(crate) async fn run(
        mut self,
        mut requests: mpsc::Receiver<Request>,
        mut reports: mpsc::Receiver<Report>,
        drain: CancellationToken,
    ) -> Ending {
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        self.show();
        let mut looked = self.now();
        let ending = loop {
            let ended = tokio::select! {
                Some(request) = requests.recv() => {
                    self.serve(request);
                    None
                }
                report = reports.recv() => match report {
                    Some(report) => self.heard(report),
                    None => Some(Ending::Failed(
                        "the trainer thread ended unexpectedly; its last words are above in the log".to_owned(),
                    )),
                },
                _ = tick.tick() => {
                    let now = self.now();
                    let late = now.saturating_sub(looked + TICK);
                    if late > TICK {
                        tracing::warn!(seconds = late.as_secs_f64(), "the learner stood still; leases are longer by that");
                        self.admission.stood_still(now, late);
                    }
                    looked = now;
                    let commands = self.admission.tick(now);
                    self.execute(commands);
                    self.show();
                    None
                }
                () = drain.cancelled(), if *self.channels.life.borrow() != Life::Draining => {
                    self.stop();
                    None
                }
            };
            if let Some(ending) = ended {
                break ending;
            }
        };
        self.channels.life.send_replace(Life::Draining);
        self.outboxes.goodbye(ending == Ending::Complete);
        self.show();
        ending
    }

    fn now(&self) -> Duration {
        self.started.elapsed()
    }

    /// Takes nothing new; the last checkpoint is written once no update is in progress.
    fn stop(&mut self) {
        let starting = *self.channels.life.borrow() == Life::Starting;
        self.channels.life.send_replace(Life::Draining);
        self.admission.stop();
        tracing::info!(updating = self.admission.is_updating(), "draining");
        if !self.admission.is_updating() && !starting {
            self.order(Work::Checkpoint { last: true });
        }
        self.show();
    }

    fn order(&self, work: Work) {
        // There is room: one update and one checkpoint of each kind at most are under way. If the thread has ended, the end
        // of its reports says so.
        if self.work.try_send(work).is_err() {
            tracing::error!("the trainer thread takes no work");
        }
    }

    /// A report of the trainer; gives the end if it is one.
    fn heard(&mut self, report: Report) -> Option<Ending> {
        let draining = *self.channels.life.borrow() == Life::Draining;
        match report {
            Report::Ready(_) if draining => {
                tracing::info!("asked to stop before the start was done");
                self.order(Work::Checkpoint { last: true });
            }
            Report::Ready(published) => {
                let policy_version = published.policy_version;
                self.publish(published);
                self.channels.life.send_replace(Life::Serving);
                tracing::info!(policy_version, updates = self.admission.progress().updates, "ready");
                if self.admission.is_complete() {
                    self.finish();
                }
            }
            Report::Unusable(error) => return Some(unusable(&error)),
            Report::Updated(updated) => {
                self.updated(*updated);
                if self.admission.is_complete() {
                    self.finish();
                } else if draining {
                    self.order(Work::Checkpoint { last: true });
                }
            }
            Report::UpdateFailed(error) => {
                self.telemetry.update_failed();
                self.failed_updates += 1;
                tracing::error!(
                    in_a_row = self.failed_updates,
                    "the update failed: {error}; its data is dropped"
                );
                if self.failed_updates >= MAX_FAILED_UPDATES {
                    // Counted and written down like the others, but no further round is taken.
                    self.admission.stop();
                    let _ = self.admission.update_failed();
                    return Some(Ending::Failed(format!(
                        "{MAX_FAILED_UPDATES} updates in a row failed: {error}"
                    )));
                }
                let commands = self.admission.update_failed();
                self.execute(commands);
                if draining {
                    self.order(Work::Checkpoint { last: true });
                }
            }
            Report::Checkpoint { result, last } => {
                if let Ok(id) = &result {
                    self.last.checkpoint.clone_from(id);
                }
                for waiter in self.checkpoint_waiters.drain(..) {
                    // Whoever asked may have gone.
                    let _ = waiter.send(result.clone());
                }
                self.show();
                return match (last, result) {
                    (false, _) => None,
                    (true, Err(error)) => {
                        Some(Ending::Failed(format!("the last checkpoint is missing: {error}")))
                    }
                    (true, Ok(_)) if self.complete => Some(Ending::Complete),
                    (true, Ok(_)) => Some(Ending::Drained),
                };
            }
        }
        self.show();
        None
    }

    fn updated(&mut self, updated: Updated) {
        self.failed_updates = 0;
        tracing::info!(
            update = self.admission.progress().updates,
            policy_version = updated.published.policy_version,
            seconds = updated.seconds,
            decisions = updated.stats.decisions,
            "update done"
        );
        self.last.seconds = updated.seconds;
        self.last.losses = updated.stats.losses;
        self.last.diagnostics = updated.stats.diagnostics;
        // Admission first: no actor may hold a version that it does not know. Acknowledgements last: they may name it.
        let commands = self.admission.updated(updated.published.policy_version);
        self.publish(updated.published);
        self.execute(commands);
    }

    fn publish(&self, published: Arc<Published>) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.telemetry.published(published.policy_version, now.as_secs_f64());
        self.channels.newest.send_replace(Some(published));
    }

    /// All updates are done: the last checkpoint, then the end.
    fn finish(&mut self) {
        self.complete = true;
        self.channels.life.send_replace(Life::Draining);
        self.order(Work::Checkpoint { last: true });
    }

    /// Does what admission commands.
    fn execute(&mut self, commands: Vec<Command>) {
        for command in commands {
            match command {
                Command::Acknowledge { stream, episode, sequence, outcome, min_policy_version } => {
                    let outcome = outbox::wire_outcome(outcome).into();
                    let ack = v1::Ack { episode, sequence, outcome, min_policy_version };
                    self.tell(stream, Message::Ack(ack));
                }
                Command::Assign { stream, assignment } => {
                    let scenario = self.admission.settings().scenarios[assignment.scenario].name.clone();
                    tracing::debug!(episode = assignment.episode, %scenario, "assigned");
                    let assignment = v1::EpisodeAssignment {
                        episode: assignment.episode,
                        scenario,
                        sumo_seed: assignment.sumo_seed,
                        action_seed: assignment.action_seed,
                        min_policy_version: assignment.min_policy_version,
                    };
                    self.tell(stream, Message::Assignment(assignment));
                }
                Command::Close { stream, reason } => {
                    tracing::info!(stream = stream.0, ?reason, "stream ended");
                    self.outboxes.close(stream, outbox::close_status(reason));
                }
                Command::Update(round) => {
                    let sumo = self.sumo.clone();
                    self.order(Work::Update { round: Box::new(round), sumo });
                }
            }
        }
        self.telemetry.observe(&self.admission);
    }

    fn tell(&mut self, stream: crate::admission::StreamId, message: Message) {
        if !self.outboxes.send(stream, message) {
            tracing::warn!(stream = stream.0, "an actor does not read its answers; its stream is ended");
            // The lease goes on, so nothing follows from this yet.
            let _ = self.admission.disconnected(stream);
        }
    }

    /// Publishes the status for people.
    fn show(&mut self) {
        self.telemetry.observe(&self.admission);
        let phase = if self.complete {
            v1::training_status::Phase::Complete
        } else if *self.channels.life.borrow() == Life::Draining {
            v1::training_status::Phase::Draining
        } else if self.admission.is_updating() {
            v1::training_status::Phase::Updating
        } else if self.admission.is_paused() {
            v1::training_status::Phase::Paused
        } else {
            v1::training_status::Phase::Collecting
        };
        let now = self.now();
        let rate = self.rate.per_second(now);
        self.channels.status.send_replace(status(
            &self.admission,
            &self.run_id,
            phase,
            &self.last,
            rate,
            now,
        ));
    }
}

/// What it means that the model cannot be set up.
fn unusable(error: &ModelError) -> Ending {
    match error {
        ModelError::Damaged { .. }
        | ModelError::Foreign { .. }
        | ModelError::Mismatch { .. }
        | ModelError::TooLarge { .. } => Ending::Unusable(error.to_string()),
        _ => Ending::Failed(error.to_string()),
    }
}
