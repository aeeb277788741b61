//! The programs under test, as `make build` leaves them.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

/// Skips the check that programs are newer than their sources: for testing an installed build.
const ALLOW_STALE: &str = "CROSS_TESTS_ALLOW_STALE";

/// Path of `cross`, `cross-learner` or `cross-actor` in the target directory of this test.
///
/// # Panics
/// When it is missing, or older than the sources it is made of: testing yesterday's program would prove nothing.
#[must_use]
pub fn binary(name: &str) -> PathBuf {
    // target/release/deps/some_test-0123 -> target/release/name
    let own = std::env::current_exe().unwrap();
    let path = own.ancestors().nth(2).unwrap().join(name);
    let Some(built) = modified(&path) else {
        panic!("{} is not there; run make build", path.display());
    };
    if std::env::var_os(ALLOW_STALE).is_none() {
        for source in sources(&path.with_extension("d")) {
            let newer = modified(&source).is_none_or(|changed| changed > built);
            assert!(!newer, "{} is older than {}; run make build", path.display(), source.display());
        }
    }
    path
}

/// A command of a program under test.
///
/// # Panics
/// As [`binary`].
#[must_use]
pub fn command(name: &str) -> Command {
    let mut command = Command::new(binary(name));
    without_own_variables(&mut command);
    command
}

/// Keeps from a program what the tester's own environment says to CROSS and to the clients of object stores: it would decide
/// where a test goes, or with whose credentials. What a test itself gives comes after this.
pub fn without_own_variables(command: &mut Command) {
    for (variable, _) in std::env::vars_os() {
        let name = variable.to_string_lossy();
        if ["AWS_", "GOOGLE_", "AZURE_", "CROSS_"].iter().any(|beginning| name.starts_with(beginning)) {
            command.env_remove(&variable);
        }
    }
}

fn modified(path: &Path) -> Option<SystemTime> {
    path.metadata().and_then(|metadata| metadata.modified()).ok()
}

/// The files that cargo says a program was made of: `program: file file ...`, blanks in names escaped.
fn sources(dependencies: &Path) -> Vec<PathBuf> {
    let text = std::fs::read_to_string(dependencies).unwrap_or_default();
    let (_, files) = text.split_once(": ").unwrap_or_default();
    let files = files.trim().replace("\\ ", "\0");
    files.split(' ').filter(|file| !file.is_empty()).map(|file| file.replace('\0', " ").into()).collect()
}
