//! How the cluster's processes are started: each in its network namespace, by its own clock, with a log of its own.

use super::clock::Clock;
use super::net::Net;
use super::world::actor_name;
use crate::binaries::binary;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Port of the learner, in its own namespace.
pub(super) const PORT: u16 = 7400;
/// Port of the relay through which the last actor speaks.
pub(super) const RELAY_PORT: u16 = 7500;

/// The log of a process.
pub(super) fn log(root: &Path, name: &str) -> PathBuf {
    root.join("logs").join(format!("{name}.log"))
}

/// How processes are started.
#[derive(Clone)]
pub(super) struct Launch {
    /// Folder of everything.
    pub root: PathBuf,
    /// What marks the processes.
    pub marker: String,
    /// Whether they write their journals and go by clocks that can be set.
    pub instrumented: bool,
}

impl Launch {
    pub(super) fn learner(&self, space: String, clock: Clock) -> impl FnMut() -> Command + 'static {
        let Self { root, marker, instrumented } = self.clone();
        move || {
            let mut command = enter(&space, "cross-learner");
            command.arg("--config").arg(root.join("config.toml")).arg("--run").arg(root.join("disk/run"));
            command.arg("--resume").args(["--insecure", "--listen", &format!("0.0.0.0:{PORT}")]);
            common(&mut command, &root, &marker, "learner");
            if instrumented {
                command.args(["--log-format", "json", "--log", "info,cross_learner::fragments=debug"]);
                clock.apply(&mut command);
            }
            command
        }
    }

    pub(super) fn actor(
        &self,
        net: &Net,
        n: usize,
        port: u16,
        name: &str,
        clock: Clock,
    ) -> impl FnMut() -> Command + 'static {
        let Self { root, marker, instrumented } = self.clone();
        let (space, name) = (net.actor(n), name.to_owned());
        move || {
            let mut command = enter(&space, "cross-actor");
            let address = Net::learner_address(n);
            command.args(["--learner", &format!("http://{address}:{port}"), "--actor-id", &actor_name(n)]);
            common(&mut command, &root, &marker, &name);
            if instrumented {
                command.args(["--log-format", "json", "--log", "info,cross_actor::fragments=debug"]);
                clock.apply(&mut command);
            }
            command
        }
    }
}

/// A program in a namespace, which the kernel ends with whoever started it: a suite that is killed leaves nothing.
fn enter(space: &str, program: &str) -> Command {
    let mut command = Command::new("nsenter");
    command.arg(format!("--net=/run/netns/{space}"));
    command.args(["setpriv", "--pdeathsig", "KILL"]).arg(binary(program));
    command
}

fn common(command: &mut Command, root: &Path, marker: &str, name: &str) {
    let log = File::options().create(true).append(true).open(log(root, name)).unwrap();
    command.env("CROSS_TEST_RUN", marker).env("TMPDIR", root.join("tmp"));
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
}
