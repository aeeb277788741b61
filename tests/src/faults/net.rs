//! The cluster's network: a namespace for the learner, one for each actor, and a cable between the learner and each.
//!
//! Nothing of it touches the machine's own network. Cables are cut by dropping packets without a word, pulled out, answered
//! with resets, or made slow, all by the kernel.

use super::tools::{run, try_run};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::fs::File;
use std::os::fd::AsFd;

/// Names of namespaces begin with this and the process id of their maker.
const PREFIX: &str = "cross-faults-";

/// Which packets a cut takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Direction {
    /// Both ways.
    Both,
    /// What the learner sends.
    FromLearner,
    /// What the actor sends.
    ToLearner,
}

/// The namespaces and cables; gone when dropped.
#[derive(Debug)]
pub(super) struct Net {
    prefix: String,
    actors: usize,
}

impl Net {
    /// Makes namespaces and cables for so many actors.
    pub(super) fn new(actors: usize) -> Self {
        sweep();
        let net = Self { prefix: format!("{PREFIX}{}-", std::process::id()), actors };
        let learner = net.learner();
        run("ip", &["netns", "add", &learner]);
        run("ip", &["-n", &learner, "link", "set", "lo", "up"]);
        for n in 0..actors {
            let (actor, cable) = (net.actor(n), cable(n));
            run("ip", &["netns", "add", &actor]);
            run("ip", &["-n", &actor, "link", "set", "lo", "up"]);
            run(
                "ip",
                &[
                    "-n", &learner, "link", "add", &cable, "type", "veth", "peer", "name", "learner",
                    "netns", &actor,
                ],
            );
            for (space, end, host) in [(&learner, cable.as_str(), 1), (&actor, "learner", 2)] {
                run("ip", &["-n", space, "address", "add", &format!("10.77.{n}.{host}/30"), "dev", end]);
                run("ip", &["-n", space, "link", "set", end, "up"]);
            }
        }
        net
    }

    /// The learner's namespace.
    pub(super) fn learner(&self) -> String {
        format!("{}learner", self.prefix)
    }

    /// An actor's namespace.
    pub(super) fn actor(&self, n: usize) -> String {
        format!("{}actor{n}", self.prefix)
    }

    /// The learner's address, as an actor sees it.
    pub(super) fn learner_address(n: usize) -> String {
        format!("10.77.{n}.1")
    }

    /// Moves the calling thread, and the threads that it starts later, into the learner's namespace: what it says to the
    /// learner then stays on loopback, whatever happens to the cables.
    pub(super) fn enter(&self) {
        let file = File::open(format!("/run/netns/{}", self.learner())).unwrap();
        move_into_link_name_space(file.as_fd(), Some(LinkNameSpaceType::Network)).unwrap();
    }

    /// Has packets of a cable disappear.
    pub(super) fn cut(&self, n: usize, direction: Direction) {
        if direction != Direction::FromLearner {
            self.filter(&["-I", "INPUT", "-i", &cable(n), "-j", "DROP"]);
        }
        if direction != Direction::ToLearner {
            self.filter(&["-I", "OUTPUT", "-o", &cable(n), "-j", "DROP"]);
        }
    }

    /// Answers every packet of an actor with a reset.
    pub(super) fn reset(&self, n: usize) {
        self.filter(&[
            "-I",
            "INPUT",
            "-i",
            &cable(n),
            "-p",
            "tcp",
            "-j",
            "REJECT",
            "--reject-with",
            "tcp-reset",
        ]);
    }

    /// Ends every cut and reset.
    pub(super) fn heal(&self) {
        self.filter(&["-F"]);
    }

    fn filter(&self, arguments: &[&str]) {
        let learner = self.learner();
        let mut whole = vec!["netns", "exec", &learner, "iptables", "-w"];
        whole.extend(arguments);
        run("ip", &whole);
    }

    /// Pulls a cable out, or puts it back.
    pub(super) fn plug(&self, n: usize, up: bool) {
        let state = if up { "up" } else { "down" };
        run("ip", &["-n", &self.actor(n), "link", "set", "learner", state]);
    }

    /// Limits a cable to so many kilobits a second each way; what does not fit waits, and beyond 400 ms is lost.
    pub(super) fn slow(&self, n: usize, kilobits: u32) {
        let rate = format!("{kilobits}kbit");
        for (space, end) in [(self.learner(), cable(n)), (self.actor(n), "learner".to_owned())] {
            run(
                "tc",
                &[
                    "-n", &space, "qdisc", "replace", "dev", &end, "root", "tbf", "rate", &rate, "burst",
                    "4kb", "latency", "400ms",
                ],
            );
        }
    }

    /// Takes a limit away.
    pub(super) fn quick(&self, n: usize) {
        for (space, end) in [(self.learner(), cable(n)), (self.actor(n), "learner".to_owned())] {
            run("tc", &["-n", &space, "qdisc", "del", "dev", &end, "root"]);
        }
    }
}

impl Drop for Net {
    fn drop(&mut self) {
        for n in 0..self.actors {
            try_run("ip", &["netns", "del", &self.actor(n)]);
        }
        try_run("ip", &["netns", "del", &self.learner()]);
    }
}

/// Name of the learner's end of a cable.
fn cable(n: usize) -> String {
    format!("actor{n}")
}

/// Removes namespaces whose maker was killed before it could.
fn sweep() {
    for entry in std::fs::read_dir("/run/netns").into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let maker = name.strip_prefix(PREFIX).and_then(|rest| rest.split('-').next()?.parse::<u32>().ok());
        if maker.is_some_and(|pid| !std::path::Path::new(&format!("/proc/{pid}")).exists()) {
            try_run("ip", &["netns", "del", &name]);
        }
    }
}
