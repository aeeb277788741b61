//! All targets.

#[cfg(feature = "checkpoints")]
mod checkpoints;
mod files;
mod traci;
mod wire;

use crate::Outcome;
use crate::limits::Limit;
use crate::mutate::{self, Mutator, text};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// A net of two crossings: a seed, and the network that fragments are of.
pub(crate) const TOWN: &str = include_str!("../../corpus/net/town");

/// Something that reads what others wrote.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name, also of its folder in `corpus/`.
    pub name: &'static str,
    /// What it reads, for people.
    pub reads: &'static str,
    /// Reads an input; panics where a promise is broken.
    pub run: fn(&[u8]) -> Outcome,
    /// Changes an input.
    pub mutate: Mutator,
    /// What an input may cost.
    pub limit: Limit,
    /// Longest input that is made.
    pub longest: usize,
    /// Inputs that our own writers make; the rest are files in the corpus.
    pub written: fn() -> Vec<Vec<u8>>,
}

fn none() -> Vec<Vec<u8>> {
    Vec::new()
}

/// Half a second of the processor is far beyond what any input of a few kilobytes needs.
const TIME: Duration = Duration::from_millis(500);

const fn limit(base: usize, factor: usize) -> Limit {
    Limit { base, factor, time: TIME }
}

/// Every target, in the order of the data's way.
pub const TARGETS: &[Target] = &[
    Target {
        name: "traci-values",
        reads: "one value of a TraCI answer",
        run: traci::values,
        mutate: mutate::traci::value,
        limit: limit(4 << 10, 64),
        longest: 1 << 10,
        written: none,
    },
    Target {
        name: "traci-replies",
        reads: "the answer to a TraCI message: statuses, values, subscriptions",
        run: traci::replies,
        mutate: mutate::traci::blocks,
        limit: limit(4 << 10, 64),
        longest: 1 << 10,
        written: traci::answers,
    },
    Target {
        name: "traci-stream",
        reads: "bytes from SUMO's socket up to a whole message, and the step's results in it",
        run: traci::stream,
        mutate: mutate::traci::blocks,
        // The least buffer is 16 KiB, and a declared length may ask for 1 MiB ahead.
        limit: limit(3 << 20, 64),
        longest: 1 << 10,
        written: traci::messages,
    },
    Target {
        name: "net",
        reads: "a SUMO net, and the intersections in it",
        run: files::net,
        mutate: text::xml,
        limit: limit(64 << 10, 64),
        longest: 8 << 10,
        written: none,
    },
    Target {
        name: "routes",
        reads: "a SUMO route or additional file: departures by the minute",
        run: files::routes,
        mutate: text::xml,
        limit: limit(16 << 10, 16),
        longest: 4 << 10,
        written: none,
    },
    Target {
        name: "trips",
        reads: "SUMO's trip output",
        run: files::trips,
        mutate: text::xml,
        limit: limit(16 << 10, 16),
        longest: 4 << 10,
        written: none,
    },
    Target {
        name: "scenario",
        reads: "scenario.toml",
        run: files::scenario,
        mutate: text::lines,
        // The parser keeps an event for each dot of a key and each bracket, and copies them while it grows.
        limit: limit(128 << 10, 512),
        longest: 2 << 10,
        written: none,
    },
    Target {
        name: "config",
        reads: "a run's configuration, TOML",
        run: files::config,
        mutate: text::lines,
        limit: limit(128 << 10, 512),
        longest: 4 << 10,
        written: none,
    },
    Target {
        name: "cityflow",
        reads: "CityFlow's roadnet and flow files",
        run: files::cityflow,
        mutate: cityflow,
        // Half a million vehicles are the most that a demand may have, and three lines can ask for them.
        limit: limit(64 << 20, 128),
        longest: 8 << 10,
        written: none,
    },
    Target {
        name: "report",
        reads: "an evaluation's report, JSON",
        run: files::report,
        mutate: text::json,
        limit: limit(64 << 10, 64),
        longest: 8 << 10,
        written: none,
    },
    Target {
        name: "fragment",
        reads: "a message of an actor's stream: protobuf, the check of every field, packed counts",
        run: wire::fragment,
        mutate: mutate::wire::fragment,
        limit: limit(16 << 10, 128),
        longest: 2 << 10,
        written: wire::fragments,
    },
    Target {
        name: "weights",
        reads: "the pieces of a snapshot, and the snapshot from them",
        run: wire::weights,
        mutate: weights,
        limit: limit(3 << 20, 64),
        longest: 1 << 10,
        written: wire::snapshots,
    },
    Target {
        name: "messages",
        reads: "all other messages of cross.v1, and the configuration that an actor is sent",
        run: wire::messages,
        mutate: text::json,
        limit: limit(128 << 10, 128),
        longest: 2 << 10,
        written: wire::others,
    },
    Target {
        name: "token",
        reads: "a file of tokens, and the header that carries one",
        run: wire::token,
        mutate: token,
        limit: limit(16 << 10, 64),
        longest: 512,
        written: none,
    },
    #[cfg(feature = "checkpoints")]
    Target {
        name: "safetensors",
        reads: "a policy or optimiser file: header, metadata, tensors by name",
        run: checkpoints::safetensors,
        mutate: mutate::wire::safetensors,
        limit: limit(64 << 10, 64),
        longest: 4 << 10,
        written: checkpoints::files,
    },
    #[cfg(feature = "checkpoints")]
    Target {
        name: "metadata",
        reads: "a checkpoint's metadata.json, and a line of metrics.jsonl",
        run: checkpoints::metadata,
        mutate: text::json,
        limit: limit(64 << 10, 64),
        longest: 8 << 10,
        written: checkpoints::descriptions,
    },
    #[cfg(feature = "checkpoints")]
    Target {
        name: "checkpoint",
        reads: "a run directory with a checkpoint: latest, metadata.json and both files",
        run: checkpoints::directory,
        mutate: checkpoints::mutate,
        limit: limit(128 << 10, 64),
        longest: 8 << 10,
        written: checkpoints::directories,
    },
];

fn cityflow(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    mutate::parts(input, most, rng, [text::json, text::json]);
}

fn weights(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    mutate::parts(input, most, rng, [mutate::bytes::mutate; 4]);
}

fn token(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    mutate::parts(input, most, rng, [text::lines, text::lines]);
}
