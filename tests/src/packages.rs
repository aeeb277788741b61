//! Programs of the system that some tests need and the set-up does not bring.

use std::io::Write as _;
use std::path::PathBuf;

/// Set by `.ci/run`: there, a test that cannot run is a failure.
pub const REQUIRE: &str = "CROSS_TESTS_REQUIRE_PACKAGES";

/// Finds a program on PATH; says what was skipped and how to get it if it is not there.
///
/// # Panics
/// When it is missing and [`REQUIRE`] is set.
#[must_use]
pub fn program(name: &str, package: &str) -> Option<PathBuf> {
    program_or(name, &format!("install it with: apt-get install {package}"))
}

/// As [`program`], for one that is no package of the system; `remedy` says where it comes from.
///
/// # Panics
/// As [`program`].
#[must_use]
pub fn program_or(name: &str, remedy: &str) -> Option<PathBuf> {
    let found = find(name);
    if found.is_none() {
        skipped(&format!("{name} was not found; {remedy}"));
    }
    found
}

/// Finds a program on PATH.
#[must_use]
pub fn find(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).map(|folder| folder.join(name)).find(|file| file.is_file())
}

/// Names a test that cannot run here, with the reason and the remedy.
///
/// # Panics
/// When [`REQUIRE`] is set.
pub fn skipped(reason: &str) {
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    assert!(std::env::var_os(REQUIRE).is_none(), "{test} cannot run: {reason}");
    // Not by a macro that prints: what those write is shown of failed tests alone.
    let _ = writeln!(std::io::stderr(), "skipped {test}: {reason}");
}
