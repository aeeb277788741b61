//! `cross bench weights`.

use super::recorded::{Recorded, clients};
use crate::failure::Outcome;
use clap::Args;
use cross_bench::{Progress, Report, weights};

/// How long new weights take to reach the last of one to a thousand watchers, beside tonic's own server stream
///
/// A real `cross-learner` process makes real updates, on fragments that one simulated actor sends it: small ones, so that they
/// take a moment, of networks of the default size. Every watcher is a real gRPC client that puts the snapshot together and
/// checks its SHA-256. The baseline is a server in a process of its own that sends the same bytes as messages which tonic
/// encodes for each stream.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross bench weights                            1, 10, 100 and 1,000 watchers
  cross bench weights --watchers 1000 --versions 10
  cross bench weights --watchers 8 --versions 2  a quick look
  cross bench weights --json > weights.json

How to read it:
  a version at the last       from publication, by the server's own clock, until the last watcher has checked the snapshot;
                              the watchers share the machine with the server and take most of it
  CPU of a version            the server's, more than the same update takes with nobody watching
  memory of one               the server's resident memory above that without watchers, divided by them. The kernel's socket
                              buffers are in neither figure
  encodings of a version      ours from the metric cross_learner_snapshots_encoded_total; an error if it is not one

A thousand watchers need some 2,300 open files: the soft limit is raised to the hard one (ulimit -Hn).")]
pub(crate) struct Weights {
    /// Numbers of watchers, one case each
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_values_t = [1, 10, 100, 1000], value_parser = clients)]
    watchers: Vec<usize>,
    /// New versions in each case, whose medians count
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    versions: u32,
    #[command(flatten)]
    recorded: Recorded,
}

impl Weights {
    pub(super) fn run(&self, progress: Progress<'_>) -> Outcome<Report> {
        let options = weights::Options {
            setup: self.recorded.setup()?,
            watchers: self.watchers.clone(),
            versions: self.versions,
        };
        Ok(weights::run(&options, progress)?)
    }
}
