//! What the suite needs of the machine.

use crate::packages;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Programs and the Debian packages that bring them.
const PROGRAMS: [(&str, &str); 5] = [
    ("ip", "iproute2"),
    ("tc", "iproute2"),
    ("iptables", "iptables"),
    ("nsenter", "util-linux"),
    ("setpriv", "util-linux"),
];

/// Why the suite cannot run here, and the remedy; nothing if it can.
#[must_use]
pub fn missing() -> Option<String> {
    if !rustix::process::geteuid().is_root() {
        return Some("network namespaces, packet filters and mounts need root; run it as root".to_owned());
    }
    for (name, package) in PROGRAMS {
        if packages::find(name).is_none() {
            return Some(format!("{name} was not found; install it with: apt-get install {package}"));
        }
    }
    if faketime().is_none() {
        return Some("libfaketime was not found; install it with: apt-get install faketime".to_owned());
    }
    // Root of a container may have no right to any of it.
    let allowed = Command::new("unshare")
        .args(["--net", "--mount", "iptables", "-L", "-n"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    if !allowed.is_ok_and(|status| status.success()) {
        return Some(
            "this root may not make network namespaces; run it outside the container, or in a privileged one"
                .to_owned(),
        );
    }
    None
}

/// The library that gives a process a clock of its own.
pub(super) fn faketime() -> Option<PathBuf> {
    let folders = std::fs::read_dir("/usr/lib").ok()?.flatten().map(|entry| entry.path());
    folders.map(|folder| folder.join("faketime/libfaketimeMT.so.1")).find(|library| library.is_file())
}

/// Runs a command of the system to its end.
///
/// # Panics
/// With what it said if it fails: the suite cannot go on without it.
pub(super) fn run(program: &str, arguments: &[&str]) {
    let output = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|error| panic!("cannot run {program}: {error}"));
    assert!(
        output.status.success(),
        "{program} {}: {}",
        arguments.join(" "),
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Runs a command whose failure means that there was nothing to do.
pub(super) fn try_run(program: &str, arguments: &[&str]) -> bool {
    Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}
