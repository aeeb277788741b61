//! What reaches the supervising loop from outside: signals, and the learner's own account of its progress.

use cross_proto::client::TrainingClient;
use cross_proto::v1::{GetStatusRequest, TrainingStatus, WatchProgressRequest};
use cross_support::client::ClientSecurity;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tokio_stream::StreamExt;

/// Between two looks at the status: the stream speaks only after an update, and a person wants to see more than that.
const POLL: Duration = Duration::from_secs(2);
/// Between two attempts to reach a learner that is restarting.
const RETRY: Duration = Duration::from_millis(500);
/// For a connection and for an answer.
const DEADLINE: Duration = Duration::from_secs(5);

/// One wish to stop may arrive several times: from whoever signals a whole group of processes and, through one of them
/// that passes it on, once more. What follows so soon is that, and not a second wish.
const ECHO: Duration = Duration::from_secs(1);

/// The newest news. Nothing queues: a status replaces the one before it.
#[derive(Debug, Default)]
struct News {
    status: Option<TrainingStatus>,
    stops: u32,
    last_stop: Option<Instant>,
}

impl News {
    /// A signal at `now` asks for a stop, unless it only echoes the one before.
    fn stop(&mut self, now: Instant) {
        if self.last_stop.is_some_and(|last| now.saturating_duration_since(last) < ECHO) {
            return;
        }
        self.last_stop = Some(now);
        self.stops += 1;
    }
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
    /// Takes over SIGINT, SIGTERM and, unless it was started to ignore it, SIGHUP from here on. Calls to the learner are
    /// made with `security`.
    pub(crate) fn start(security: ClientSecurity) -> std::io::Result<Self> {
        let inbox = Arc::new(Inbox::default());
        let (address, learner) = watch::channel(None);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        // Before the thread starts, so that no signal can slip through. A terminal that closes asks for an orderly end too.
        // Whoever ignores that, as nohup does, wants the run to survive it.
        let hang_up_counts =
            !ignores_hang_up(&std::fs::read_to_string("/proc/self/status").unwrap_or_default());
        let (interrupt, terminate, hang_up) = {
            let _inside = runtime.enter();
            (
                signal(SignalKind::interrupt())?,
                signal(SignalKind::terminate())?,
                if hang_up_counts { Some(signal(SignalKind::hangup())?) } else { None },
            )
        };
        let theirs = Arc::clone(&inbox);
        std::thread::Builder::new().name("watch".to_owned()).spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = listen(Some(interrupt), &theirs) => {}
                    () = listen(Some(terminate), &theirs) => {}
                    () = listen(hang_up, &theirs) => {}
                    () = follow(learner, &security, &theirs) => {}
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

/// Never ends where there is nothing to listen to.
async fn listen(signal: Option<tokio::signal::unix::Signal>, inbox: &Inbox) {
    let Some(mut signal) = signal else { return std::future::pending().await };
    while signal.recv().await.is_some() {
        inbox.put(|news| news.stop(Instant::now()));
    }
}

/// Whether a process with this `/proc/PID/status` ignores SIGHUP: `SigIgn` is a mask in hexadecimal, signal 1 lowest.
fn ignores_hang_up(status: &str) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}

/// Follows the learner through its restarts, until this process ends.
async fn follow(mut learner: watch::Receiver<Option<String>>, security: &ClientSecurity, inbox: &Inbox) {
    loop {
        let address = learner.borrow_and_update().clone();
        if let Some(address) = address {
            // A learner that is gone or restarting is the supervisor's business; here it only means to try again.
            let _ = follow_once(&address, security, inbox).await;
            tokio::time::sleep(RETRY).await;
        } else if learner.changed().await.is_err() {
            // The run is over; signals still count.
            return std::future::pending().await;
        }
    }
}

async fn follow_once(address: &str, security: &ClientSecurity, inbox: &Inbox) -> anyhow::Result<()> {
    // The learner that this program started, on loopback.
    let channel = security.endpoint(address, false)?.connect_timeout(DEADLINE).connect().await?;
    let mut client = TrainingClient::new(security.connection(channel));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_that_come_together_ask_for_one_stop() {
        let mut news = News::default();
        let start = Instant::now();
        for (milliseconds, stops) in [(0, 1), (0, 1), (999, 1), (1000, 2), (1500, 2), (60_000, 3)] {
            news.stop(start + Duration::from_millis(milliseconds));
            assert_eq!(news.stops, stops, "after {milliseconds} ms");
        }
    }

    #[test]
    fn what_nohup_ignores_is_left_alone() {
        let status = |mask: &str| format!("Name:\tcross\nSigBlk:\t0000000000000001\nSigIgn:\t{mask}\n");
        assert!(ignores_hang_up(&status("0000000000001001")));
        assert!(!ignores_hang_up(&status("0000000000001000")));
        assert!(!ignores_hang_up(""));
    }
}
