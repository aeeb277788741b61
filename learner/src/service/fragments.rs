//! A fragment stream: checks what comes in and passes it on; answers come from the coordinator.

use super::{COME_AGAIN, Shared};
use crate::admission::{HelloRefusal, StreamId};
use crate::coordinator::{Gone, Outbox, Request};
use cross_proto::fragment::Checked;
use cross_proto::ids::ActorId;
use cross_proto::status::{self, Reason};
use cross_proto::v1::{self, stream_fragments_request::Message};
use cross_proto::{Violation, fragment};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::{Status, Streaming};

/// Time for the hello after a stream is opened.
const HELLO_TIMEOUT: Duration = Duration::from_secs(10);
/// Answers to a stream beyond its acknowledgements: an assignment, a goodbye, an error, and slack for duplicates.
const SPARE_ANSWERS: usize = 16;

/// Why an actor that leaves gives up its episode.
const SHUTDOWN: &str = "SHUTDOWN";

type Answer = Result<v1::StreamFragmentsResponse, Status>;

/// Opens a stream on its hello.
pub(super) async fn open(
    shared: &Shared,
    mut incoming: Streaming<v1::StreamFragmentsRequest>,
) -> Result<ReceiverStream<Answer>, Status> {
    let first = tokio::time::timeout(HELLO_TIMEOUT, incoming.message()).await;
    let hello = match first {
        Ok(message) => match message?.and_then(|request| request.message) {
            Some(Message::Hello(hello)) => hello,
            _ => return Err(unexpected("a stream begins with a hello")),
        },
        Err(_) => return Err(unexpected("no hello came after the stream was opened")),
    };
    let actor: String = ActorId::parse(&hello.actor_id, "hello.actor_id")?.into();
    let stream = shared.coordinator.new_stream();
    let (answers, outgoing) = mpsc::channel(shared.unacked_fragments + SPARE_ANSWERS);
    let stopped = CancellationToken::new();
    let outbox = Outbox::new(answers.clone(), stopped.clone());
    let opened = shared
        .coordinator
        .ask(|reply| Request::Open { stream, actor, epoch: hello.session_epoch, outbox, reply })
        .await?;
    opened.map_err(|refusal| match refusal {
        HelloRefusal::OldSession { .. } => status::error(Reason::OldSession, refusal.to_string()),
        HelloRefusal::NotJoined { .. } => status::error(Reason::NotJoined, refusal.to_string()),
    })?;
    let reader = Reader { shared: shared.clone(), stream };
    tokio::spawn(async move {
        let ended = tokio::select! {
            () = stopped.cancelled() => return,
            ended = reader.read(incoming) => ended,
        };
        reader.end(ended, answers).await;
    });
    Ok(ReceiverStream::new(outgoing))
}

struct Reader {
    shared: Shared,
    stream: StreamId,
}

/// How a stream's incoming direction ended.
enum Ended {
    /// The actor said that it leaves, then finished it.
    Left,
    /// The connection broke, or the stream ended without that word: a proxy that closes it, or a process that is gone, must
    /// not look like an actor that leaves, whose share is given to others at once.
    Broken,
    /// The actor broke a rule.
    Refused { status: Status, scenario: Option<usize> },
    /// The coordinator is gone.
    Gone,
}

impl From<Gone> for Ended {
    fn from(_: Gone) -> Self {
        Self::Gone
    }
}

impl Reader {
    async fn read(&self, mut incoming: Streaming<v1::StreamFragmentsRequest>) -> Ended {
        let mut leaving = false;
        loop {
            let message = match incoming.message().await {
                Ok(Some(request)) => request.message,
                Ok(None) if leaving => return Ended::Left,
                // Also how a cancelled request looks here.
                Ok(None) => return Ended::Broken,
                // What is too large or cannot be decoded is the actor's fault; everything else the connection's.
                Err(status) if status.code() == tonic::Code::OutOfRange => {
                    let status = status::message_too_large(self.shared.config.learner.max_message_bytes);
                    return Ended::Refused { status, scenario: None };
                }
                Err(status) if status.code() == tonic::Code::Internal => {
                    let status = unexpected(&format!("a message cannot be read: {}", status.message()));
                    return Ended::Refused { status, scenario: None };
                }
                Err(_) => return Ended::Broken,
            };
            match &message {
                Some(Message::EpisodeAborted(aborted)) => leaving = aborted.reason == SHUTDOWN,
                // It has thought better of it.
                Some(Message::EpisodeRequest(_)) => leaving = false,
                _ => {}
            }
            if let Err(ended) = self.pass_on(message).await {
                return ended;
            }
        }
    }

    async fn pass_on(&self, message: Option<Message>) -> Result<(), Ended> {
        let stream = self.stream;
        let refused = |status| Ended::Refused { status, scenario: None };
        let request = match message {
            Some(Message::Fragment(message)) => Request::Fragment(stream, Box::new(self.check(message)?)),
            Some(Message::EpisodeRequest(_)) => Request::Episode(stream),
            Some(Message::EpisodeAborted(aborted)) => {
                // Quoted in the log, so bounded.
                let reason = aborted.reason.chars().filter(|c| !c.is_control()).take(64).collect();
                Request::Aborted { stream, episode: aborted.episode, reason }
            }
            Some(Message::Heartbeat(_)) => Request::Heartbeat(stream),
            Some(Message::Hello(_)) => {
                return Err(refused(unexpected("a second hello came on the same stream")));
            }
            None => return Err(refused(unexpected("an empty message, or one of a later protocol"))),
        };
        Ok(self.shared.coordinator.send(request).await?)
    }

    fn check(&self, message: v1::Fragment) -> Result<Checked, Ended> {
        let specs = &self.shared.specs;
        let scenario = specs.iter().position(|spec| spec.scenario == message.scenario);
        let checked = match scenario {
            Some(index) => fragment::check(message, &specs[index]),
            None => {
                let names: Vec<&str> = specs.iter().map(|spec| spec.scenario.as_str()).collect();
                let problem = format!("is {:?}; this run trains on {}", message.scenario, names.join(", "));
                Err(Violation::new("fragment.scenario", problem))
            }
        };
        checked.map_err(|violation| Ended::Refused { status: status::invalid(&violation), scenario })
    }

    async fn end(&self, ended: Ended, answers: mpsc::Sender<Answer>) {
        let stream = self.stream;
        let request = match ended {
            Ended::Left => Request::Left(stream),
            Ended::Broken => Request::Disconnected(stream),
            Ended::Refused { status, scenario } => {
                let problem = status.message().to_owned();
                // If the actor does not read its answers it learns only that the stream is over.
                let _ = answers.try_send(Err(status));
                Request::Invalid { stream, scenario, problem }
            }
            Ended::Gone => {
                let _ = answers.try_send(Err(status::draining(COME_AGAIN)));
                return;
            }
        };
        // A coordinator that is gone has no bookkeeping to keep right.
        let _ = self.shared.coordinator.send(request).await;
    }
}

fn unexpected(problem: &str) -> Status {
    status::error(Reason::UnexpectedMessage, problem)
}
