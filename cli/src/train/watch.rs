//! What reaches the supervising loop from outside: signals, and the learner's own account of its progress.

use cross_proto::client::TrainingClient;
use cross_proto::v1::{GetStatusRequest, TrainingStatus, WatchProgressRequest};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tokio_stream::StreamExt;
use tonic::transport::Endpoint;

/// Between two looks at the status: the stream speaks only after an update, and a person wants to see more than that.
const POLL: Duration = Duration::from_secs(2);
/// Between two attempts to reach a learner that is restarting.
const RETRY: Duration = Duration::from_millis(500);
/// For a connection and for an answer.
const DEADLINE: Duration = Duration::from_secs(5);

/// The newest news. Nothing queues: a status replaces the one before it.
#[derive(Debug, Default)]
struct News {
    status: Option<TrainingStatus>,
    stops: u32,
}

#[derive(Debug, Default)]
struct Inbox {
    news: Mutex<News>,
    arrived: Condvar,
}

impl Inbox {
    fn lock(&self) -> MutexGuard<'_, News> {
        // News is whole after every assignment, so a panic elsewhere cannot have left it half written.
        self.news.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn put(&self, change: impl FnOnce(&mut News)) {
        change(&mut self.lock());
        self.arrived.notify_one();
    }
}

/// Listens on a thread of its own, with an asynchronous runtime that nothing else uses.
#[derive(Debug)]
pub(crate) struct Watch {
    inbox: Arc<Inbox>,
    address: watch::Sender<Option<String>>,
}

impl Watch {
    /// Takes over SIGINT, SIGTERM and SIGHUP from here on.
    pub(crate) fn start() -> std::io::Result<Self> {
        let inbox = Arc::new(Inbox::default());
        let (address, learner) = watch::channel(None);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        // Before the thread starts, so that no signal can slip through. A terminal that closes asks for an orderly end too.
        let (interrupt, terminate, hang_up) = {
            let _inside = runtime.enter();
            (
                signal(SignalKind::interrupt())?,
                signal(SignalKind::terminate())?,
                signal(SignalKind::hangup())?,
            )
        };
        let theirs = Arc::clone(&inbox);
        std::thread::Builder::new().name("watch".to_owned()).spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = listen(interrupt, &theirs) => {}
                    () = listen(terminate, &theirs) => {}
                    () = listen(hang_up, &theirs) => {}
                    () = follow(learner, &theirs) => {}
                }
            });
        })?;
        Ok(Self { inbox, address })
    }

    /// Follows the learner at `address` (`host:port`) from now on.
    pub(crate) fn learner_at(&self, address: &str) {
        self.address.send_replace(Some(address.to_owned()));
    }

    /// Waits for news, at most `patience`: the newest status if there is one, and how many stops were asked for since
    /// the last call.
    pub(crate) fn wait(&self, patience: Duration) -> (Option<TrainingStatus>, u32) {
        let news = self.inbox.lock();
        let (mut news, _) = self
            .inbox
            .arrived
            .wait_timeout_while(news, patience, |news| news.status.is_none() && news.stops == 0)
            .unwrap_or_else(PoisonError::into_inner);
        (news.status.take(), std::mem::take(&mut news.stops))
    }
}

async fn listen(mut signal: tokio::signal::unix::Signal, inbox: &Inbox) {
    while signal.recv().await.is_some() {
        inbox.put(|news| news.stops += 1);
    }
}

/// Follows the learner through its restarts, until this process ends.
async fn follow(mut learner: watch::Receiver<Option<String>>, inbox: &Inbox) {
    loop {
        let address = learner.borrow_and_update().clone();
        if let Some(address) = address {
            // A learner that is gone or restarting is the supervisor's business; here it only means to try again.
            let _ = follow_once(&address, inbox).await;
            tokio::time::sleep(RETRY).await;
        } else if learner.changed().await.is_err() {
            // The run is over; signals still count.
            return std::future::pending().await;
        }
    }
}

async fn follow_once(address: &str, inbox: &Inbox) -> anyhow::Result<()> {
    let channel =
        Endpoint::from_shared(format!("http://{address}"))?.connect_timeout(DEADLINE).connect().await?;
    let mut client = TrainingClient::new(channel);
    let mut updates = client.watch_progress(WatchProgressRequest {}).await?.into_inner();
    let mut poll = tokio::time::interval(POLL);
    loop {
        let status = tokio::select! {
            update = updates.next() => match update {
                Some(update) => update?.status,
                None => return Ok(()),
            },
            _ = poll.tick() => {
                tokio::time::timeout(DEADLINE, client.get_status(GetStatusRequest {})).await??.into_inner().status
            }
        };
        if let Some(status) = status {
            inbox.put(|news| news.status = Some(status));
        }
    }
}
