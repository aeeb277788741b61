//! Checkpoints in an object store: a real S3 server, real training, real kills.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::binaries;
use cross_tests::processes::assert_none_left;
use cross_tests::runs::{Background, Finished, Run, assert_same_metrics, same_bytes};
use cross_tests::s3::{self, BUCKET, S3, SECRET};
use cross_tests::tools::Tools;
use cross_tests::{http, wait};
use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;

const URL: &str = "s3://cross/runs/a";
const PLACE: &str = "runs/a";

fn start<'a>(run: &'a Run, store: &S3, arguments: &[&str]) -> Background<'a> {
    let mut command = run.train(arguments);
    command.envs(store.environment());
    run.spawn(command)
}

fn call(run: &Run, store: &S3, arguments: &[&str]) -> Finished {
    let mut command = run.cross(arguments);
    command.envs(store.environment());
    run.spawn(command).wait()
}

/// The id that `latest` in the store names.
fn latest(store: &S3) -> Option<String> {
    let text = store.get(&format!("{PLACE}/checkpoints/latest"))?;
    Some(String::from_utf8(text).unwrap().trim().to_owned())
}

/// All that the run directory and the last command's output hold.
fn assert_no_secret(folder: &Path) {
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            assert_no_secret(&path);
        } else {
            let bytes = std::fs::read(&path).unwrap();
            let found = bytes.windows(SECRET.len()).any(|part| part == SECRET.as_bytes());
            assert!(!found, "a secret is in {}", path.display());
        }
    }
}

#[test]
fn a_run_that_lost_its_disk_goes_on_from_the_store_bit_for_bit() {
    let Some(tools) = Tools::find() else { return };
    let whole = Run::new();
    let arguments = ["--serial", "--seed", "5", "--updates", "8", "--eval-seeds", "0"];
    let _ = whole.finish(&arguments).json();

    let (run, store) = (Run::new(), S3::start(&tools));
    let mut command = run.train(&[&arguments[..], &["--checkpoints", URL]].concat());
    command.envs(store.environment()).env("CROSS_LOG", "debug");
    let mut training = run.spawn(command);
    wait::until("a second copy", || latest(&store).filter(|id| id.as_str() >= "000002"));
    training.kill_one("cross-learner");
    training.send(Signal::KILL);
    let _ = training.wait();
    assert_none_left(&run.marker());
    assert_no_secret(Path::new(&run.marker()));
    std::fs::remove_dir_all(run.path().join("checkpoints")).unwrap();

    // The URL is in the run's configuration; the secrets are not.
    let resumed = start(&run, &store, &["--resume", "--eval-seeds", "0"]).wait().json();
    assert_eq!(resumed["updates"], 8);
    assert_same_metrics(&run, &whole);
    for file in ["model.safetensors", "optimizer.safetensors"] {
        let of = |run: &Run| run.newest_checkpoint().join(file);
        assert!(same_bytes(&of(&run), &of(&whole)), "{file} differs");
        let copy = store.get(&format!("{PLACE}/checkpoints/000008/{file}")).unwrap();
        assert!(copy == std::fs::read(of(&run)).unwrap(), "the copy of {file} differs");
    }

    the_commands_read_the_store(&run, &store);
}

fn the_commands_read_the_store(run: &Run, store: &S3) {
    let list = call(run, store, &["checkpoint", "list", "--run", URL, "--json"]).json();
    let newest = &list["checkpoints"][0];
    assert_eq!((&newest["id"], &newest["latest"]), (&Value::from("000008"), &Value::from(true)), "{list}");
    assert_eq!(newest["path"], format!("{URL}/checkpoints/000008"));
    // Five are kept there as here.
    assert_eq!(list["checkpoints"].as_array().unwrap().len(), 5, "{list}");
    let show = call(run, store, &["checkpoint", "show", "latest", "--run", URL, "--json"]).json();
    assert_eq!(show["metadata"]["updates"], 8);
    assert!(show["tensors"].as_array().unwrap().len() > 10);
    let verified =
        call(run, store, &["checkpoint", "verify", &format!("{URL}/checkpoints/000007"), "--json"]);
    assert_eq!(verified.json()["ok"], true);
    let out = run.path().join("policy.safetensors");
    let export = ["checkpoint", "export", "latest", "--run", URL, "--out", out.to_str().unwrap()];
    assert_eq!(call(run, store, &export).code, Some(0));
    assert!(same_bytes(&out, &run.newest_checkpoint().join("model.safetensors")));
    let eval = ["eval", "--scenario", "grid4x4", "--policy", URL, "--seeds", "1", "--json"];
    assert_eq!(call(run, store, &eval).json()["policy"], URL);

    // A store that lost an object is noticed, by everybody who reads.
    store.remove(&format!("{PLACE}/checkpoints/000008/model.safetensors"));
    call(run, store, &["checkpoint", "verify", "latest", "--run", URL]).assert_refused(&[
        URL,
        "000008",
        "model.safetensors",
    ]);
    call(run, store, &eval).assert_refused(&[URL, "000008", "model.safetensors"]);
    call(run, store, &["checkpoint", "show", "000099", "--run", URL]).assert_refused(&["000099", URL]);
    let missing = "s3://nobody/runs/a";
    call(run, store, &["checkpoint", "list", "--run", missing]).assert_refused(&[missing, "no such bucket"]);
}

/// Failed tries by reason, from the learner's own metrics.
fn failures(run: &Run, reason: &str) -> Option<f64> {
    let file: Value = serde_json::from_slice(&std::fs::read(run.path().join("learner.json")).ok()?).ok()?;
    let text = http::get(file["metrics"].as_str()?, "/metrics")?;
    let name = format!("cross_learner_checkpoint_upload_failures_total{{reason=\"{reason}\"}} ");
    text.lines().find_map(|line| line.strip_prefix(&name))?.parse().ok()
}

#[test]
fn a_store_that_is_down_stops_nothing_and_gets_its_copies_once_it_is_back() {
    let Some(tools) = Tools::find() else { return };
    let (run, store) = (Run::new(), S3::start(&tools));
    let address = store.address().to_owned();
    let arguments = ["--updates", "100000", "--actors", "1", "--eval-seeds", "0"];
    let mut training = start(&run, &store, &[&arguments[..], &["--checkpoints", URL]].concat());
    wait::until("a copy", || latest(&store));
    drop(store);
    wait::until("failures that are counted", || failures(&run, "unreachable").filter(|count| *count >= 1.0));
    let before = run.updates();
    training.wait_for_updates(before + 3);

    // Back, and empty. The try that was under way may still bring the checkpoint that it began with; a new one follows.
    let store = S3::start_at(&tools, &address, false);
    let of_later = |id: &String| id.parse::<u64>().unwrap() > before;
    let id = wait::until("a later copy in the new store", || latest(&store).filter(of_later));
    assert!(store.get(&format!("{PLACE}/checkpoints/{id}/metadata.json")).is_some());
    drop(store);

    // It is down at the end: the run ends all the same, and says what is missing where.
    training.send(Signal::INT);
    let ended = training.wait();
    assert_eq!(ended.code, Some(1), "{}", ended.stderr);
    ended.assert_sentence(&["in the run directory", URL, "--resume"]);
    assert_none_left(&run.marker());
    let done = run.updates();
    assert_eq!(run.newest_checkpoint().file_name().unwrap().to_str().unwrap(), format!("{done:06}"));

    // And the next start makes up for it, even if there is nothing left to train.
    let store = S3::start_at(&tools, &address, false);
    let updates = done.to_string();
    let resumed =
        start(&run, &store, &["--resume", "--updates", &updates, "--eval-seeds", "0"]).wait().json();
    assert_eq!(resumed["updates"], done);
    assert_eq!(latest(&store), Some(format!("{done:06}")));
}

#[test]
fn what_is_wrong_with_a_store_is_one_sentence_with_its_remedy() {
    let Some(tools) = Tools::find() else { return };
    let run = Run::new();
    let (open, closed) = (S3::start(&tools), S3::start_closed(&tools));
    // Nobody listens on the port of a connection's near end, and as long as there is the connection nobody else gets it.
    let far_end = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let near_end = std::net::TcpStream::connect(far_end.local_addr().unwrap()).unwrap();
    let nobody = near_end.local_addr().unwrap().to_string();
    let learner = |environment: Vec<(&'static str, String)>, url: &str, more: &[&str]| {
        let mut command = binaries::command("cross-learner");
        command.arg("--config").arg(run.config()).arg("--run").arg(run.path()).args(["--checkpoints", url]);
        let output = command.args(more).envs(environment).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(!text.contains(SECRET) && !text.contains("panicked"), "{text}");
        (output.status.code(), text.lines().last().unwrap_or_default().to_owned())
    };
    let without_keys = vec![
        ("AWS_METADATA_ENDPOINT", format!("http://{nobody}")),
        ("AWS_ENDPOINT_URL", format!("http://{nobody}")),
        ("AWS_ALLOW_HTTP", "true".to_owned()),
    ];
    let mut line_break = open.environment();
    line_break.push(("AWS_SESSION_TOKEN", format!("{SECRET}\n")));
    let mut no_address = open.environment();
    no_address.push(("AWS_ENDPOINT_URL", "nonsense".to_owned()));
    let absent = format!("s3://{BUCKET}-absent/a");
    let secret_url = format!("s3://key:{SECRET}@{BUCKET}/a");
    for (environment, url, code, parts) in [
        (open.environment(), absent.as_str(), 2, &[absent.as_str(), "no such bucket", "create it"][..]),
        (closed.environment(), URL, 2, &[URL, "refuses these credentials", "InvalidAccessKeyId"]),
        (without_keys, URL, 2, &[URL, "no credentials", "AWS_ACCESS_KEY_ID"]),
        (line_break, URL, 2, &[URL, "AWS_SESSION_TOKEN", "line break"]),
        (no_address, URL, 2, &[URL, "AWS_ENDPOINT_URL", "no address"]),
        (s3::environment(&nobody), URL, 1, &[URL, "cannot be reached"]),
        (open.environment(), secret_url.as_str(), 2, &["learner.checkpoint_url", "password"]),
        (open.environment(), "http://x/y", 2, &["learner.checkpoint_url", "s3://BUCKET"]),
    ] {
        for more in [&[][..], &["--resume"]] {
            let (got, sentence) = learner(environment.clone(), url, more);
            assert_eq!(got, Some(code), "{url}: {sentence}");
            assert!(sentence.starts_with("error: ") && !sentence.contains('<'), "{sentence}");
            for part in parts {
                assert!(sentence.contains(part), "{part:?} is not in {sentence:?}");
            }
        }
    }
    assert!(!run.path().join("checkpoints").exists(), "nothing began");
    for url in [
        secret_url.clone(),
        format!("{secret_url}/checkpoints/000001"),
        format!("{secret_url}/p.safetensors"),
    ] {
        let out = run.path().join("out.safetensors");
        for arguments in [
            &["checkpoint", "list", "--run", &url][..],
            &["checkpoint", "show", &url],
            &["checkpoint", "verify", "latest", "--run", &url],
            &["checkpoint", "export", &url, "--out", out.to_str().unwrap()],
            &["eval", "--scenario", "grid4x4", "--policy", &url, "--seeds", "1"],
        ] {
            let refused = call(&run, &open, arguments);
            refused.assert_refused(&["password"]);
            assert!(!refused.stderr.contains(SECRET), "{arguments:?}: {}", refused.stderr);
        }
    }
}

/// A store that takes connections and never answers: a stop does not wait for it.
#[test]
fn a_stop_while_a_store_is_asked_is_a_stop() {
    let run = Run::new();
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let mut command = binaries::command("cross-learner");
    command.arg("--config").arg(run.config()).arg("--run").arg(run.path()).args([
        "--checkpoints",
        URL,
        "--resume",
    ]);
    command.envs(s3::environment(&silent.local_addr().unwrap().to_string()));
    let learner = run.spawn(command);
    silent.set_nonblocking(true).unwrap();
    let _question = wait::until("a question to the store", || silent.accept().ok());
    learner.send(Signal::TERM);
    let stopped = learner.wait();
    assert_eq!(stopped.code, Some(0), "{}", stopped.stderr);
    assert!(stopped.stderr.contains("stopped before anything began"), "{}", stopped.stderr);
}
