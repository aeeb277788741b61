//! `docs/grpc.md` types what works and shows what is printed.
//!
//! `CROSS_REGENERATE=1 cargo test --release -p cross-tests --test grpc_page` writes the outputs anew from a real run.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::certificates::{Authority, secret};
use cross_tests::grpcurl::{LearnerAlone, find};
use cross_tests::page::{self, Part};
use cross_tests::processes::assert_none_left;
use cross_tests::runs::Run;
use rustix::process::Signal;
use std::ffi::OsStr;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

/// As the page calls the learner with TLS.
const SECURE: &str = "learner:7400";

/// Keys whose content depends on the moment: fragments may have been dropped, or not.
const FREE: [&str; 1] = ["dropped"];

fn checkout() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// A learner behind TLS, client certificates and a token, whose files have the names of the page.
fn secure(run: &Run, folder: &Path) -> LearnerAlone {
    let authority = Authority::new("the page's own");
    let ca = authority.file(folder, "authority");
    let server = authority.issue(folder, "server", &["localhost"]);
    let _ = authority.issue(folder, "actor", &["actor"]);
    std::fs::rename(&ca, folder.join("ca.pem")).unwrap();
    let token = folder.join("token");
    secret(&token, "a-token-for-this-page-1234\n");
    let ca = folder.join("ca.pem");
    LearnerAlone::start(
        run,
        &[
            ("--listen", OsStr::new("127.0.0.1:0")),
            ("--tls-cert", server.certificate.as_os_str()),
            ("--tls-key", server.key.as_os_str()),
            ("--tls-client-ca", ca.as_os_str()),
            ("--token-file", token.as_os_str()),
        ],
    )
}

/// The folder in which the commands of the page are typed.
fn desk(run: &Run) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("runs")).unwrap();
    symlink(run.path(), folder.path().join("runs/example")).unwrap();
    symlink(checkout().join("proto"), folder.path().join("proto")).unwrap();
    folder
}

/// What sets a variable for the commands after it.
fn is_assignment(typed: &str) -> bool {
    let name = typed.trim_start_matches("export ").split('=').next().unwrap_or_default();
    !name.is_empty() && name.chars().all(|c| c.is_ascii_uppercase() || c == '_')
}

#[test]
fn every_command_of_the_page_prints_what_the_page_shows() {
    let Some(grpcurl) = find() else { return };
    let (run, other) = (Run::new(), Run::new());
    let mut training = run.start(&["--scenario", "grid4x4", "--updates", "100000", "--actors", "1"]);
    let desk = desk(&run);
    let learner = secure(&other, desk.path());
    let secure = format!("localhost:{}", learner.port);
    // More checkpoints than a page of two, and a value for everything.
    training.wait_for_updates(4);

    let file = checkout().join("docs/grpc.md");
    let shown = std::fs::read_to_string(&file).unwrap();
    let mut parts = page::parse(&shown);
    let path = std::env::var("PATH").unwrap();
    let path = format!("{}:{path}", grpcurl.parent().map(PathBuf::from).unwrap().display());
    let (mut before, mut commands, mut wrong) = (String::new(), 0, Vec::new());
    for part in &mut parts {
        let Part::Command { typed, output } = part else { continue };
        let printed = page::run(desk.path(), &path, &before, &typed.replace(SECURE, &secure));
        let printed = page::abridged(&printed.replace(&secure, SECURE));
        if let Err(problem) = page::compare(output, &printed, &FREE) {
            wrong.push(format!("$ {typed}\n{problem}"));
        }
        *output = printed;
        if is_assignment(typed) {
            before.push_str(typed);
            before.push('\n');
        }
        commands += 1;
    }
    drop(learner);
    training.send(Signal::INT);
    assert_eq!(training.wait().code, Some(0));
    assert_none_left(&run.marker());
    assert_none_left(&other.marker());

    assert!(commands > 20, "only {commands} commands were found");
    assert_eq!(page::render(&page::parse(&shown)), shown);
    if std::env::var_os("CROSS_REGENERATE").is_some() {
        std::fs::write(&file, page::render(&parts)).unwrap();
    } else {
        assert!(
            wrong.is_empty(),
            "docs/grpc.md shows what is no longer so; write it anew with \
             CROSS_REGENERATE=1 cargo test --release -p cross-tests --test grpc_page\n{}",
            wrong.join("\n")
        );
    }
}
