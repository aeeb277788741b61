//! TLS, client certificates and tokens between real processes: what belongs together works, and every misfit is refused
//! with a sentence that names the file to change.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_proto::client::TrainingClient;
use cross_proto::status::{self, Reason};
use cross_proto::v1::{GetStatusRequest, PauseRequest, ResumeRequest};
use cross_support::client::ClientSecurity;
use cross_support::options::{ClientOptions, TokenOption};
use cross_tests::binaries;
use cross_tests::certificates::{Authority, Pair, secret};
use cross_tests::processes::assert_none_left;
use cross_tests::runs::{Run, SMALL};
use cross_tests::wait;
use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

const TOKEN: &str = "a-token-that-must-not-be-seen-1234";
const OTHER: &str = "another-token-that-fits-nothing-99";

/// A program of a run, with the options of a test and none of the tester's own environment.
fn program(run: &Run, name: &str) -> Command {
    let mut command = binaries::command(name);
    command.env("CROSS_TEST_RUN", run.marker()).stdin(Stdio::null());
    command
}

fn learner(run: &Run) -> Command {
    std::fs::create_dir_all(run.path()).unwrap();
    let mut command = program(run, "cross-learner");
    command.arg("--config").arg(run.config()).arg("--run").arg(run.path());
    command
}

fn actor(run: &Run, address: &str) -> Command {
    let mut command = program(run, "cross-actor");
    command.args(["--learner", address, "--actor-id", "a", "--give-up-seconds", "20"]);
    command
}

/// Exit code 2, and one sentence at the end with all of these words and no secret.
fn assert_refused(command: &mut Command, words: &[&str]) {
    let Output { status, stderr, .. } = command.stderr(Stdio::piped()).output().unwrap();
    let said = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(2), "{said}");
    let sentence = said.lines().last().unwrap_or_default();
    for word in words {
        assert!(sentence.contains(word), "{word:?} is missing in: {sentence}");
    }
    assert!(!said.contains("panicked") && !said.contains(TOKEN) && !said.contains(OTHER), "{said}");
}

/// A learner that runs, its log in a file; stopped when dropped.
struct Learner<'a> {
    run: &'a Run,
    child: Child,
    port: u16,
}

impl<'a> Learner<'a> {
    fn start(run: &'a Run, options: &[(&str, &OsStr)]) -> Self {
        let mut command = learner(run);
        // Everything that anybody would ever log.
        command.args(["--log", "trace"]).stdout(Stdio::null());
        command.stderr(File::create(log(run, "learner")).unwrap());
        for (option, value) in options {
            command.arg(option).arg(value);
        }
        let mut learner = Self { run, child: command.spawn().unwrap(), port: 0 };
        let file = run.path().join("learner.json");
        learner.port = wait::until("learner.json", || {
            let ended = learner.child.try_wait().unwrap();
            assert!(ended.is_none(), "the learner ended: {}", last_lines(&log(run, "learner")));
            let value: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).ok()?).ok()?;
            value["grpc"].as_str()?.rsplit(':').next()?.parse().ok()
        });
        learner
    }

    fn at(&self, scheme: &str, host: &str) -> String {
        format!("{scheme}://{host}:{}", self.port)
    }
}

impl Drop for Learner<'_> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        assert_none_left(&self.run.marker());
    }
}

fn log(run: &Run, name: &str) -> PathBuf {
    run.config().with_file_name(format!("{name}.log"))
}

fn last_lines(file: &Path) -> String {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.lines().rev().take(5).collect::<Vec<_>>().join("\n")
}

/// A folder with an authority, its files, and a token.
struct Safe {
    folder: tempfile::TempDir,
    authority: Authority,
    ca: PathBuf,
    server: Pair,
    client: Pair,
    token: PathBuf,
}

impl Safe {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::new("the run's own");
        let ca = authority.file(folder.path(), "ca");
        let server = authority.issue(folder.path(), "server", &["localhost"]);
        let client = authority.issue(folder.path(), "client", &["actor"]);
        let token = folder.path().join("token");
        secret(&token, &format!("{TOKEN}\n"));
        Self { folder, authority, ca, server, client, token }
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn other_token(&self) -> PathBuf {
        let path = self.path().join("other-token");
        secret(&path, OTHER);
        path
    }
}

#[test]
fn only_an_address_that_keeps_strangers_out_may_be_open_to_them() {
    let run = Run::new();
    let safe = Safe::new();
    let open = |run: &Run| {
        let mut command = learner(run);
        command.args(["--listen", "0.0.0.0:0"]);
        command
    };
    assert_refused(&mut open(&run), &["--listen", "0.0.0.0:0", "--tls-cert", "--insecure"]);
    let words = ["--listen", "protection: token", "--tls-cert"];
    assert_refused(open(&run).arg("--token-file").arg(&safe.token), &words);
    let mut tls = open(&run);
    tls.arg("--tls-cert").arg(&safe.server.certificate).arg("--tls-key").arg(&safe.server.key);
    assert_refused(&mut tls, &["--listen", "protection: TLS)", "--token-file"]);
    assert_refused(learner(&run).args(["--metrics-listen", "0.0.0.0:0"]), &["--metrics-listen"]);
    assert_refused(
        actor(&run, "http://127.0.0.1:1").args(["--metrics-listen", "0.0.0.0:0"]),
        &["--insecure"],
    );

    // What everybody may read is no secret, and half a pair is none.
    let mut mismatch = learner(&run);
    mismatch.arg("--tls-cert").arg(&safe.server.certificate).arg("--tls-key").arg(&safe.client.key);
    assert_refused(&mut mismatch, &["client.key", "does not belong", "server.pem"]);
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(&safe.token, std::fs::Permissions::from_mode(0o644)).unwrap();
    assert_refused(learner(&run).arg("--token-file").arg(&safe.token), &["--token-file", "chmod o-rwx"]);
    assert_refused(learner(&run).env("CROSS_TOKEN", "too short"), &["CROSS_TOKEN", "characters"]);
    assert_none_left(&run.marker());
}

#[test]
fn an_actor_joins_over_mutual_tls_with_a_token_and_every_misfit_is_refused() {
    let run = Run::new();
    run.write_config(&format!("updates = 2\n{SMALL}"));
    let safe = Safe::new();
    // Open to other machines, which this much protection allows.
    let mut learner = Learner::start(
        &run,
        &[
            ("--listen", OsStr::new("0.0.0.0:0")),
            ("--tls-cert", safe.server.certificate.as_os_str()),
            ("--tls-key", safe.server.key.as_os_str()),
            ("--tls-client-ca", safe.ca.as_os_str()),
            ("--token-file", safe.token.as_os_str()),
        ],
    );
    let right = learner.at("https", "localhost");
    let with = |address: &str, ca: &Path, own: Option<&Pair>, token: Option<&Path>| {
        let mut command = actor(&run, address);
        command.arg("--tls-ca").arg(ca);
        if let Some(pair) = own {
            command.arg("--tls-cert").arg(&pair.certificate).arg("--tls-key").arg(&pair.key);
        }
        if let Some(token) = token {
            command.arg("--token-file").arg(token);
        }
        command
    };
    let (client, token) = (Some(&safe.client), Some(safe.token.as_path()));
    let stranger = Authority::new("somebody else");
    let foreign = stranger.file(safe.path(), "foreign");
    assert_refused(&mut with(&right, &foreign, client, token), &["not signed by", "--tls-ca", &right]);
    let by_number = learner.at("https", "127.0.0.1");
    assert_refused(&mut with(&by_number, &safe.ca, client, token), &["is for", "localhost", &by_number]);
    assert_refused(&mut with(&right, &safe.ca, None, token), &["--tls-cert and --tls-key", &right]);
    let outsider = stranger.issue(safe.path(), "outsider", &["actor"]);
    let words = ["does not accept the certificate", "--tls-client-ca"];
    assert_refused(&mut with(&right, &safe.ca, Some(&outsider), token), &words);
    let late = safe.authority.issue_until(safe.path(), "late", &["actor"], 2020);
    assert_refused(&mut with(&right, &safe.ca, Some(&late), token), &["--tls-cert", "expired"]);
    assert_refused(&mut with(&right, &safe.ca, client, None), &["asks for a token", "--token-file"]);
    let other = safe.other_token();
    assert_refused(&mut with(&right, &safe.ca, client, Some(&other)), &["the token is not the learner's"]);
    // Contradictions need no learner.
    assert_refused(&mut with(&learner.at("http", "localhost"), &safe.ca, client, token), &["https://"]);
    assert_refused(&mut actor(&run, &right), &["--tls-ca"]);
    let mut clear = actor(&run, "http://learner.example:7400");
    assert_refused(clear.arg("--token-file").arg(&safe.token), &["token", "--insecure"]);

    // And what fits trains to the end.
    let mut fits = with(&right, &safe.ca, client, token);
    fits.args(["--log", "trace"]).stdout(Stdio::null()).stderr(File::create(log(&run, "actor")).unwrap());
    let ended = fits.status().unwrap();
    assert_eq!(ended.code(), Some(0), "{}", last_lines(&log(&run, "actor")));
    let ended = wait::until("the end of the learner", || learner.child.try_wait().unwrap());
    assert_eq!(ended.code(), Some(0), "{}", last_lines(&log(&run, "learner")));
    assert_eq!(run.updates(), 2);
    let keys = [&safe.server.key, &safe.client.key].map(|key| std::fs::read_to_string(key).unwrap());
    let mut secrets = vec![TOKEN, OTHER];
    secrets.extend(keys.iter().map(|key| key.lines().nth(1).unwrap()));
    assert_nowhere(run.config().parent().unwrap(), &secrets);
}

#[test]
fn an_expired_certificate_and_a_wrong_scheme_are_named() {
    let run = Run::new();
    let safe = Safe::new();
    let late = safe.authority.issue_until(safe.path(), "late-server", &["localhost"], 2020);
    let options = [("--tls-cert", late.certificate.as_os_str()), ("--tls-key", late.key.as_os_str())];
    let learner = Learner::start(&run, &options);
    let mut command = actor(&run, &learner.at("https", "localhost"));
    assert_refused(command.arg("--tls-ca").arg(&safe.ca), &["has expired", "localhost"]);
    drop(learner);

    let run = Run::new();
    let learner = Learner::start(&run, &[]);
    let mut command = actor(&run, &learner.at("https", "localhost"));
    assert_refused(command.arg("--tls-ca").arg(&safe.ca), &["does not speak TLS", "http://"]);
}

/// Asserts that no file below a folder holds any of the secrets.
fn assert_nowhere(folder: &Path, secrets: &[&str]) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            assert_nowhere(&path, secrets);
            continue;
        }
        let bytes = std::fs::read(&path).unwrap();
        for secret in secrets {
            let found = bytes.windows(secret.len()).any(|window| window == secret.as_bytes());
            assert!(!found, "a secret is in {}", path.display());
        }
    }
}

#[tokio::test]
async fn a_local_run_takes_a_token_and_writes_it_nowhere() {
    let run = Run::new();
    let safe = Safe::new();
    // Variables that are meant for a cluster change nothing.
    let token = safe.token.display().to_string();
    let mut command =
        run.train(&["--updates", "6", "--actors", "1", "--eval-seeds", "0", "--token-file", &token]);
    command.env("CROSS_LOG", "trace").env("CROSS_TLS_CERT", &safe.server.certificate);
    let mut training = run.spawn(command);
    let _ = training.wait_for("cross-learner");
    let file = run.path().join("learner.json");
    let address = wait::until("learner.json", || {
        let value: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).ok()?).ok()?;
        Some(value["grpc"].as_str()?.to_owned())
    });
    let client = async |token: Option<&Path>| {
        let token = TokenOption { token_file: token.map(Path::to_owned) };
        let options = ClientOptions { token, ..ClientOptions::default() };
        let security = ClientSecurity::load(&options, None).unwrap();
        let channel = security.endpoint(&address, false).unwrap().connect().await.unwrap();
        TrainingClient::new(security.connection(channel))
    };
    let mut known = client(Some(&safe.token)).await;
    // So that the run does not end under the test.
    known.pause(PauseRequest {}).await.unwrap();
    let error = client(None).await.get_status(GetStatusRequest {}).await.unwrap_err();
    assert_eq!(status::reason(&error), Some(Reason::Unauthenticated), "{error:?}");
    known.get_status(GetStatusRequest {}).await.unwrap();
    known.resume(ResumeRequest {}).await.unwrap();
    let finished = training.wait();
    assert_eq!(finished.json()["updates"], 6);
    assert_nowhere(run.config().parent().unwrap(), &[TOKEN]);

    let run = Run::new();
    let mut command = run.train(&["--updates", "1", "--token-file", &token]);
    command.env("CROSS_TOKEN", TOKEN);
    run.spawn(command).wait().assert_refused(&["--token-file", "CROSS_TOKEN"]);
}
