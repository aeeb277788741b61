//! The programs under test, as `make build` leaves them.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Skips the check that programs are newer than the sources: for testing an installed build.
const ALLOW_STALE: &str = "CROSS_TESTS_ALLOW_STALE";

/// Crates that end up in the programs.
const CRATES: [&str; 8] = ["config", "traci", "sim", "proto", "model", "actor", "learner", "cli"];

/// Path of `cross`, `cross-learner` or `cross-actor` in the target directory of this test.
///
/// # Panics
/// When it is missing, or older than the sources it is made of: testing yesterday's program would prove nothing.
#[must_use]
pub fn binary(name: &str) -> PathBuf {
    // target/release/deps/some_test-0123 -> target/release/name
    let own = std::env::current_exe().unwrap();
    let path = own.ancestors().nth(2).unwrap().join(name);
    let Ok(built) = path.metadata().and_then(|metadata| metadata.modified()) else {
        panic!("{} is not there; run make build", path.display());
    };
    if std::env::var_os(ALLOW_STALE).is_none() {
        let (newest, file) = newest_source();
        assert!(built >= newest, "{} is older than {}; run make build", path.display(), file.display());
    }
    path
}

/// The folder of the whole project.
#[must_use]
pub fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn newest_source() -> (SystemTime, PathBuf) {
    let mut newest = (SystemTime::UNIX_EPOCH, PathBuf::new());
    for name in CRATES {
        visit(&project().join(name).join("src"), &mut newest);
    }
    newest
}

fn visit(directory: &Path, newest: &mut (SystemTime, PathBuf)) {
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            visit(&path, newest);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let modified = path.metadata().unwrap().modified().unwrap();
            if modified > newest.0 {
                *newest = (modified, path);
            }
        }
    }
}
