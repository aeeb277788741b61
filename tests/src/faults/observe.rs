//! What is seen of a cluster from outside: the status that anybody may ask for, and the process table.

use crate::processes::{self, Found};
use cross_proto::client::TrainingClient;
use cross_proto::v1::{GetStatusRequest, TrainingStatus};
use std::time::Duration;
use tonic::transport::{Channel, Endpoint};

/// How long the learner may take to answer; one that is stopped or gone does not.
const PATIENCE: Duration = Duration::from_millis(300);

/// Asks a learner how training goes.
pub(super) struct Watch {
    runtime: tokio::runtime::Runtime,
    client: TrainingClient<Channel>,
}

impl Watch {
    /// Of the learner at an address; it need not be there yet.
    pub(super) fn new(address: &str) -> Self {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let endpoint = Endpoint::from_shared(format!("http://{address}")).unwrap();
        let channel = {
            let _context = runtime.enter();
            endpoint.connect_timeout(PATIENCE).connect_lazy()
        };
        Self { runtime, client: TrainingClient::new(channel) }
    }

    /// The status, if the learner answers.
    pub(super) fn status(&mut self) -> Option<TrainingStatus> {
        let asked =
            async { tokio::time::timeout(PATIENCE, self.client.get_status(GetStatusRequest {})).await };
        self.runtime.block_on(asked).ok()?.ok()?.into_inner().status
    }

    /// Runs something else that talks to the learner.
    pub(super) fn block_on<F: Future>(&self, future: F) -> F::Output {
        self.runtime.block_on(future)
    }
}

/// A process of the cluster.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seen {
    /// Process id and arguments.
    pub found: Found,
    /// Its parent.
    pub parent: i32,
    /// Resident memory, KiB.
    pub resident: u64,
    /// Open files.
    pub files: usize,
    /// Threads.
    pub threads: u64,
}

/// The cluster's processes; one that ends meanwhile is left out.
#[must_use]
pub fn processes(marker: &str) -> Vec<Seen> {
    processes::marked(marker).into_iter().filter_map(seen).collect()
}

fn seen(found: Found) -> Option<Seen> {
    let folder = format!("/proc/{}", found.pid);
    let status = std::fs::read_to_string(format!("{folder}/status")).ok()?;
    let number = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next()?.parse::<u64>().ok()
    };
    Some(Seen {
        parent: i32::try_from(number("PPid:")?).ok()?,
        resident: number("VmRSS:")?,
        threads: number("Threads:")?,
        files: std::fs::read_dir(format!("{folder}/fd")).ok()?.count(),
        found,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_can_be_seen() {
        let own = i32::try_from(std::process::id()).unwrap();
        let seen = seen(Found { pid: own, arguments: Vec::new() }).unwrap();
        assert!(seen.resident > 0 && seen.files > 2 && seen.threads > 0 && seen.parent > 0, "{seen:?}");
    }
}
