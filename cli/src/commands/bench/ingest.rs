//! `cross bench ingest`.

use super::recorded::{Recorded, clients};
use crate::failure::Outcome;
use clap::Args;
use cross_bench::{Progress, Report, ingest};

/// What one learner takes from one to a thousand actors, beside what tonic alone takes of the same bytes
///
/// Simulated actors, real gRPC clients with the actor's own bookkeeping, send the fragments of an episode that was recorded once
/// with SUMO to a real `cross-learner` process, as fast as it acknowledges them (two in flight each). Its training is paused
/// by Training.Pause and its buffer configured to hold all that is sent, so that every fragment is decoded, checked, admitted,
/// inserted and acknowledged as always, while no update takes processor time. With updates a learner takes what these consume,
/// and holds the rest back by leaving it without an acknowledgement: `cross bench update` tells how much that is, and the last
/// line here what memory it costs with the default buffer.
///
/// The baseline is a server of the same settings in a process of its own, which reads each message as bytes and acknowledges
/// it; a second one also keeps it, as the learner has to, in memory that the kernel clears first. The clients are the same, and run on the same cores: on a small machine they take most of the time on both sides, and
/// `server, CPU of a fragment` tells the servers apart.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross bench ingest                          1, 10, 100 and 1,000 actors
  cross bench ingest --actors 1000 --seconds 10 --fragments 20000
  cross bench ingest --actors 8 --seconds 1   a quick look
  cross bench ingest --json > ingest.json

How to read it:
  accepted decisions          of all intersections together; at least half of the bare stream that drops is the aim
  ... beside one that keeps   the same beside a bare stream that, like the learner here, keeps every message
  acknowledgement             from handing a fragment to its stream until the word comes back. Actors never pause here, so
                              that with many of them this is the length of the queue: two fragments each
  slowest over the median     1 is fair; an actor that got nothing would make it 0; at least 0.5 is the aim
  memory at rest              all actors connected, nothing sent; its peak holds all accepted fragments
  memory that holds back      default buffer, every actor with all the fragments in flight that it may have

An error, and no table, if a fragment is lost, acknowledged twice or not accepted, or if an actor is left out.
A thousand actors need some 2,300 open files: the soft limit is raised to the hard one (ulimit -Hn).")]
pub(crate) struct Ingest {
    /// Numbers of actors, one case each
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_values_t = [1, 10, 100, 1000], value_parser = clients)]
    actors: Vec<usize>,
    /// Seconds that count in each case, at most
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = seconds)]
    seconds: f64,
    /// Fragments after which a case ends before that, because the learner keeps them all
    #[arg(long, value_name = "N", default_value_t = 8000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    fragments: u64,
    #[command(flatten)]
    recorded: Recorded,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.1..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("it must be a number from 0.1 to 3600".to_owned()),
    }
}

impl Ingest {
    pub(super) fn run(&self, progress: Progress<'_>) -> Outcome<Report> {
        let options = ingest::Options {
            setup: self.recorded.setup()?,
            actors: self.actors.clone(),
            seconds: self.seconds,
            fragments: self.fragments,
        };
        Ok(ingest::run(&options, progress)?)
    }
}
