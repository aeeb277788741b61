//! What services ask of the coordinator.

use super::{Coordinator as Task, Outbox};
use crate::admission::{HelloRefusal, JoinRefusal, StreamId};
use cross_proto::fragment::Checked;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::{mpsc, oneshot};

/// Requests that may queue; senders wait beyond that, which is how a flood of fragments slows its actors down.
pub(crate) const QUEUE: usize = 64;

/// An actor that asks for admission.
#[derive(Debug, Clone)]
pub(crate) struct JoinInfo {
    pub(crate) actor: String,
    pub(crate) host: String,
    pub(crate) scenarios: Vec<String>,
    pub(crate) sumo: String,
}

/// One request. Those without an answer are answered, if at all, through the stream's outbox.
#[derive(Debug)]
pub(crate) enum Request {
    Join(JoinInfo, oneshot::Sender<Result<(), JoinRefusal>>),
    Open {
        stream: StreamId,
        actor: String,
        epoch: u64,
        outbox: Outbox,
        reply: oneshot::Sender<Result<(), HelloRefusal>>,
    },
    Episode(StreamId),
    Aborted {
        stream: StreamId,
        episode: u64,
        reason: String,
    },
    Heartbeat(StreamId),
    Fragment(StreamId, Box<Checked>),
    Invalid {
        stream: StreamId,
        scenario: Option<usize>,
        problem: String,
    },
    Left(StreamId),
    Disconnected(StreamId),
    Pause(oneshot::Sender<()>),
    Resume(oneshot::Sender<()>),
    Checkpoint(oneshot::Sender<Result<String, String>>),
}

/// The coordinator is gone: the learner has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Gone;

/// The services' end of the queue.
#[derive(Debug, Clone)]
pub(crate) struct Coordinator {
    requests: mpsc::Sender<Request>,
    next_stream: Arc<AtomicU64>,
}

impl Coordinator {
    pub(crate) fn new(requests: mpsc::Sender<Request>) -> Self {
        Self { requests, next_stream: Arc::new(AtomicU64::new(1)) }
    }

    /// Queues a request without an answer.
    pub(crate) async fn send(&self, request: Request) -> Result<(), Gone> {
        self.requests.send(request).await.map_err(|_| Gone)
    }

    /// Queues a request and waits for its answer.
    pub(crate) async fn ask<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<T>) -> Request,
    ) -> Result<T, Gone> {
        let (reply, answer) = oneshot::channel();
        self.send(request(reply)).await?;
        answer.await.map_err(|_| Gone)
    }

    /// An id for a new stream.
    pub(crate) fn new_stream(&self) -> StreamId {
        StreamId(self.next_stream.fetch_add(1, Ordering::Relaxed))
    }
}

impl Task {
    /// Serves one request. Answers go unheard if whoever asked has gone, which is nobody's fault.
    pub(super) fn serve(&mut self, request: Request) {
        let now = self.now();
        let shown = !matches!(request, Request::Fragment(..) | Request::Heartbeat(_));
        let commands = match request {
            Request::Join(join, reply) => match self.admission.join(now, &join.actor, &join.scenarios) {
                Ok(commands) => {
                    tracing::info!(actor = %join.actor, host = %join.host, sumo = %join.sumo, "actor joined");
                    self.sumo = join.sumo;
                    let _ = reply.send(Ok(()));
                    commands
                }
                Err(refusal) => {
                    tracing::warn!(actor = %join.actor, host = %join.host, "actor refused: {refusal}");
                    let _ = reply.send(Err(refusal));
                    Vec::new()
                }
            },
            Request::Open { stream, actor, epoch, outbox, reply } => {
                match self.admission.hello(now, stream, &actor, epoch) {
                    Ok(commands) => {
                        self.outboxes.open(stream, outbox);
                        let _ = reply.send(Ok(()));
                        commands
                    }
                    Err(refusal) => {
                        let _ = reply.send(Err(refusal));
                        Vec::new()
                    }
                }
            }
            Request::Episode(stream) => self.admission.request_episode(now, stream),
            Request::Aborted { stream, episode, reason } => {
                tracing::warn!(stream = stream.0, episode, reason, "episode aborted by its actor");
                self.admission.abort_episode(now, stream, episode)
            }
            Request::Heartbeat(stream) => self.admission.heartbeat(now, stream),
            Request::Fragment(stream, fragment) => {
                self.rate.add(now, fragment.actions.len() as u64);
                self.admission.offer(now, stream, *fragment)
            }
            Request::Invalid { stream, scenario, problem } => {
                tracing::warn!(stream = stream.0, "fragment refused: {problem}");
                self.outboxes.forget(stream);
                self.admission.invalid(stream, scenario)
            }
            Request::Left(stream) => {
                self.outboxes.forget(stream);
                self.admission.left(stream)
            }
            Request::Disconnected(stream) => {
                self.outboxes.forget(stream);
                self.admission.disconnected(stream)
            }
            Request::Pause(reply) => {
                self.admission.pause();
                let _ = reply.send(());
                Vec::new()
            }
            Request::Resume(reply) => {
                let commands = self.admission.resume();
                let _ = reply.send(());
                commands
            }
            Request::Checkpoint(reply) => {
                self.checkpoint_waiters.push(reply);
                if self.checkpoint_waiters.len() == 1 {
                    self.order(crate::trainer::Work::Checkpoint { last: false });
                }
                Vec::new()
            }
        };
        self.execute(commands);
        if shown {
            self.show();
        }
    }
}
