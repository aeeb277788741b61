//! Every call that a person makes, by a real grpcurl on a real run.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::certificates::{Authority, secret};
use cross_tests::grpcurl::{Answer, Grpcurl, LearnerAlone, address, find};
use cross_tests::processes::assert_none_left;
use cross_tests::runs::Run;
use cross_tests::wait;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::ffi::OsStr;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

const SERVICES: [&str; 6] = [
    "cross.v1.Checkpoints",
    "cross.v1.Learner",
    "cross.v1.Training",
    "grpc.health.v1.Health",
    "grpc.reflection.v1.ServerReflection",
    "grpc.reflection.v1alpha.ServerReflection",
];

fn proto() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join("proto")
}

/// The first detail of a type, decoded.
fn detail<'a>(status: &'a Value, kind: &str) -> &'a Value {
    let details = status["details"].as_array().unwrap();
    let wanted = format!("type.googleapis.com/google.rpc.{kind}");
    let found = details.iter().find(|detail| detail["@type"] == wanted.as_str());
    found.unwrap_or_else(|| panic!("no {kind} in {status}"))
}

fn assert_refused(status: &Value, code: i64, reason: &str) {
    assert_eq!(status["code"], code, "{status}");
    let info = detail(status, "ErrorInfo");
    assert_eq!((&info["reason"], &info["domain"]), (&json!(reason), &json!("cross.v1")), "{status}");
}

/// What `base64` of coreutils makes of a text.
fn decoded(text: &str) -> Vec<u8> {
    let mut base64 =
        Command::new("base64").arg("-d").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut input = base64.stdin.take().unwrap();
    let text = text.to_owned();
    // On a thread: its output fills a pipe before all of its input is written.
    let writer = std::thread::spawn(move || input.write_all(text.as_bytes()).unwrap());
    let output = base64.wait_with_output().unwrap();
    writer.join().unwrap();
    assert!(output.status.success());
    output.stdout
}

fn updates(status: &Value) -> u64 {
    status["status"]["updates"].as_str().map_or(0, |updates| updates.parse().unwrap())
}

/// What reflection tells, by which grpcurl knows everything else.
fn assert_described(grpcurl: &Grpcurl) {
    assert_eq!(grpcurl.run(&[], &["list"]).lines(), SERVICES);
    let methods = grpcurl.run(&[], &["list", "cross.v1.Training"]);
    let expected = ["CheckpointNow", "GetStatus", "Pause", "Resume", "WatchProgress"];
    assert_eq!(methods.lines(), expected.map(|method| format!("cross.v1.Training.{method}")));
    for service in SERVICES {
        let said = grpcurl.run(&[], &["describe", service]);
        assert!(said.text().starts_with(&format!("{service} is a service:\n")), "{}", said.stdout);
    }
    // With comments, whatever it is.
    for (symbol, words) in [
        ("cross.v1.Checkpoints.ListCheckpoints", "// Newest first."),
        ("cross.v1.TrainingStatus", "// Updates after which training is complete."),
        ("cross.v1.TrainingStatus.Phase", "// Until Resume."),
        ("cross.v1.StreamFragmentsRequest", "// Asks for the next episode to simulate."),
        ("google.rpc.ErrorInfo", "string reason = 1;"),
        ("google.protobuf.Timestamp", "int64 seconds = 1;"),
    ] {
        let said = grpcurl.run(&[], &["describe", symbol]);
        assert!(said.text().contains(words), "{symbol}: {}", said.stdout);
    }
    let said = grpcurl.run(&["-msg-template"], &["describe", "cross.v1.ListCheckpointsRequest"]);
    assert!(said.text().contains("\"pageSize\": 0"), "{}", said.stdout);
    let said = grpcurl.run(&[], &["describe", "cross.v1.Nothing"]);
    assert_eq!(said.code, Some(1));
    assert!(said.stderr.contains("Symbol not found: cross.v1.Nothing"), "{}", said.stderr);
}

fn assert_checkpoints_served(grpcurl: &Grpcurl, run: &Run) {
    let mut on_disk: Vec<String> = std::fs::read_dir(run.path().join("checkpoints"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.bytes().all(|byte| byte.is_ascii_digit()))
        .collect();
    on_disk.sort_unstable_by(|a, b| b.cmp(a));
    assert!(on_disk.len() >= 3, "{on_disk:?}");
    let (mut listed, mut token) = (Vec::new(), String::new());
    loop {
        let request = json!({"page_size": 2, "page_token": token});
        let page = grpcurl.ask(&request, "cross.v1.Checkpoints/ListCheckpoints");
        let checkpoints = page["checkpoints"].as_array().unwrap();
        assert!((1..=2).contains(&checkpoints.len()));
        listed.extend(checkpoints.iter().map(|checkpoint| checkpoint["id"].as_str().unwrap().to_owned()));
        match page["nextPageToken"].as_str() {
            Some(next) => token = next.to_owned(),
            None => break,
        }
    }
    assert_eq!(listed, on_disk);
    let all = grpcurl.call("cross.v1.Checkpoints/ListCheckpoints");
    assert_eq!(all["checkpoints"].as_array().unwrap().len(), on_disk.len());

    let file = std::fs::read(run.newest_checkpoint().join("model.safetensors")).unwrap();
    let found = grpcurl.ask(&json!({"id": "latest"}), "cross.v1.Checkpoints/GetCheckpoint");
    assert_eq!(found["checkpoint"]["id"], on_disk[0]);
    assert_eq!(found["checkpoint"]["modelBytes"], file.len().to_string());
    let config: Value = serde_json::from_str(found["checkpoint"]["configJson"].as_str().unwrap()).unwrap();
    assert_eq!(config["env"]["episode_seconds"], 200);
    // The header of a safetensors file is JSON, after its length.
    let header = u64::from_le_bytes(file[..8].try_into().unwrap());
    let header: Value = serde_json::from_slice(&file[8..8 + usize::try_from(header).unwrap()]).unwrap();
    let tensors = found["tensors"].as_array().unwrap();
    assert_eq!(
        tensors.len(),
        header.as_object().unwrap().keys().filter(|key| *key != "__metadata__").count()
    );
    for tensor in tensors {
        let shape: Vec<u64> = tensor["shape"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|size| size.as_str().unwrap().parse().unwrap())
            .collect();
        let own = &header[tensor["name"].as_str().unwrap()];
        assert_eq!((&json!(shape), &tensor["dtype"]), (&own["shape"], &own["dtype"]), "{tensor}");
    }

    for id in &on_disk {
        let answer = grpcurl
            .run(&["-d", &json!({"id": id}).to_string()], &["cross.v1.Checkpoints/DownloadCheckpoint"]);
        let mut bytes = Vec::new();
        for chunk in cross_tests::grpcurl::messages(answer.text()) {
            assert_eq!(chunk["offset"].as_str().unwrap_or("0"), bytes.len().to_string());
            bytes.extend(decoded(chunk["chunk"].as_str().unwrap()));
            assert_eq!(
                decoded(chunk["sha256"].as_str().unwrap_or_default()).is_empty(),
                chunk["sha256"].is_null()
            );
        }
        let file = run.path().join("checkpoints").join(id).join("model.safetensors");
        assert!(bytes == std::fs::read(file).unwrap(), "checkpoint {id} came with other bytes");
    }
}

/// Every error is a sentence, a reason, and what there is to say in particular; nothing is left encoded.
fn assert_errors_are_decoded(grpcurl: &Grpcurl) {
    const NOT_FOUND: i64 = 5;
    const INVALID: i64 = 3;
    for method in ["GetCheckpoint", "DownloadCheckpoint"] {
        let method = format!("cross.v1.Checkpoints/{method}");
        let status = grpcurl.refusal(&json!({"id": "999999"}), &method);
        assert_refused(&status, NOT_FOUND, "CHECKPOINT_NOT_FOUND");
        assert_eq!(detail(&status, "ErrorInfo")["metadata"]["id"], "999999");
        assert_refused(&grpcurl.refusal(&json!({"id": "../.."}), &method), NOT_FOUND, "CHECKPOINT_NOT_FOUND");
    }
    let status = grpcurl.refusal(&json!({"page_token": "x"}), "cross.v1.Checkpoints/ListCheckpoints");
    assert_refused(&status, INVALID, "INVALID_FIELD");
    assert_eq!(detail(&status, "BadRequest")["fieldViolations"][0]["field"], "page_token");
    let status = grpcurl.refusal(&json!({"actor_id": "no name"}), "cross.v1.Learner/WatchWeights");
    assert_refused(&status, INVALID, "INVALID_FIELD");
    let status = grpcurl.refusal(&json!({"actor_id": "a"}), "cross.v1.Learner/Join");
    assert_refused(&status, 9, "PROTOCOL_MISMATCH");
    let status = grpcurl.refusal(&json!({"heartbeat": {}}), "cross.v1.Learner/StreamFragments");
    assert_refused(&status, INVALID, "UNEXPECTED_MESSAGE");
    let status = grpcurl.refusal(&json!({"service": "cross.v1.Nothing"}), "grpc.health.v1.Health/Check");
    assert_refused(&status, NOT_FOUND, "UNKNOWN_SERVICE");

    // As a person sees it without -format-error.
    let request = json!({"id": "999999"}).to_string();
    let Answer { stdout, stderr, .. } =
        grpcurl.run(&["-d", &request], &["cross.v1.Checkpoints/GetCheckpoint"]);
    assert!(stderr.contains("Message: there is no checkpoint \"999999\""), "{stderr}");
    assert!(stderr.contains("\"CHECKPOINT_NOT_FOUND\"") && !stderr.contains("@value"), "{stdout}{stderr}");
    // What is no field of the message grpcurl knows itself.
    let answer = grpcurl.run(&["-d", "{\"page_tokn\": \"x\"}"], &["cross.v1.Checkpoints/ListCheckpoints"]);
    assert_eq!(answer.code, Some(1));
    assert!(answer.stderr.contains("no known field named page_tokn"), "{}", answer.stderr);
}

#[test]
fn grpcurl_makes_every_call_that_a_person_makes() {
    let Some(program) = find() else { return };
    let run = Run::new();
    let mut training = run.start(&["--scenario", "grid4x4", "--updates", "100000", "--actors", "1"]);
    training.wait_for_updates(3);
    let address = address(&run).unwrap();
    let grpcurl = Grpcurl::new(&program, &["-plaintext"], &address);
    assert_described(&grpcurl);

    let training_status = || grpcurl.call("cross.v1.Training/GetStatus");
    assert_eq!(grpcurl.call("cross.v1.Training/Pause"), json!({}));
    // The update in progress ends first.
    let paused = wait::until("the pause", || {
        let status = training_status();
        (status["status"]["phase"] == "PHASE_PAUSED").then_some(status)
    });
    let at = updates(&paused);
    assert!(at >= 3 && paused["status"]["losses"]["actor_total"].is_number(), "{paused}");
    assert_eq!(paused["status"]["scenarios"][0]["name"], "grid4x4");
    let id = format!("{at:06}");
    assert_eq!(grpcurl.call("cross.v1.Training/CheckpointNow"), json!({"id": id}));
    assert_eq!(run.newest_checkpoint().file_name(), Some(OsStr::new(&id)));
    assert_checkpoints_served(&grpcurl, &run);
    assert_errors_are_decoded(&grpcurl);
    assert_eq!(updates(&training_status()), at, "updates went on in spite of the pause");

    let out = run.path().with_file_name("progress");
    let progress = grpcurl.start(out, &json!({}), "cross.v1.Training/WatchProgress");
    let first = progress.wait_for("the present status", |seen| seen.first().cloned());
    assert_eq!((updates(&first), &first["status"]["phase"]), (at, &json!("PHASE_PAUSED")));
    assert_eq!(grpcurl.call("cross.v1.Training/Resume"), json!({}));
    let seen = progress.wait_for("two updates", |seen| {
        seen.iter().any(|status| updates(status) >= at + 2).then(|| seen.to_vec())
    });
    let seen: Vec<u64> = seen.iter().map(updates).collect();
    // The newest wins: a slow reader may miss some.
    assert!(seen.is_sorted(), "updates were shown out of order: {seen:?}");
    drop(progress);

    let health = |service: &str| grpcurl.ask(&json!({"service": service}), "grpc.health.v1.Health/Check");
    for service in ["", "cross.v1.Learner", "cross.v1.Checkpoints", "cross.v1.Training"] {
        assert_eq!(health(service), json!({"status": "SERVING"}), "{service:?}");
    }
    let watch = |name: &str, service: &str| {
        let out = run.path().with_file_name(name);
        grpcurl.start(out, &json!({"service": service}), "grpc.health.v1.Health/Watch")
    };
    let mut watches = [watch("whole", ""), watch("one", "cross.v1.Training")];
    for watch in &watches {
        watch.wait_for("health", |seen| (seen == [json!({"status": "SERVING"})]).then_some(()));
    }
    let unknown = watch("unknown", "cross.v1.Nothing");
    unknown.wait_for("health", |seen| (seen == [json!({"status": "SERVICE_UNKNOWN"})]).then_some(()));
    training.send(Signal::INT);
    // The watchers hear of the drain before the learner is gone.
    for watch in &mut watches {
        let _ = watch.ended();
        let last = watch.messages().pop();
        assert_eq!(last, Some(json!({"status": "NOT_SERVING"})));
    }
    assert_eq!(training.wait().code, Some(0));
    assert_none_left(&run.marker());
}

#[test]
fn grpcurl_calls_a_learner_that_keeps_strangers_out() {
    let Some(program) = find() else { return };
    const TOKEN: &str = "a-token-that-grpcurl-sends-1234";
    let run = Run::new();
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::new("the run's own");
    let ca = authority.file(folder.path(), "ca");
    let server = authority.issue(folder.path(), "server", &["localhost"]);
    let client = authority.issue(folder.path(), "client", &["a person"]);
    let token = folder.path().join("token");
    secret(&token, &format!("{TOKEN}\n"));
    let learner = LearnerAlone::start(
        &run,
        &[
            ("--listen", OsStr::new("127.0.0.1:0")),
            ("--tls-cert", server.certificate.as_os_str()),
            ("--tls-key", server.key.as_os_str()),
            ("--tls-client-ca", ca.as_os_str()),
            ("--token-file", token.as_os_str()),
        ],
    );
    let at = format!("localhost:{}", learner.port);
    let (ca, bearer) = (ca.display().to_string(), format!("authorization: Bearer {TOKEN}"));
    let (certificate, key) = (client.certificate.display().to_string(), client.key.display().to_string());
    let tls = ["-cacert", &ca, "-cert", &certificate, "-key", &key, "-connect-timeout", "60"];
    let with_token = Grpcurl::new(&program, &[&tls[..], &["-H", &bearer]].concat(), &at);
    assert_eq!(with_token.run(&[], &["list"]).lines(), SERVICES);
    assert_eq!(with_token.call("grpc.health.v1.Health/Check"), json!({"status": "SERVING"}));
    let status = with_token.refusal(&json!({"id": "latest"}), "cross.v1.Checkpoints/GetCheckpoint");
    assert_refused(&status, 5, "CHECKPOINT_NOT_FOUND");

    // Reflection, too, is for those with the token alone.
    let without = Grpcurl::new(&program, &tls, &at);
    let answer = without.run(&[], &["list"]);
    assert_eq!((answer.code, answer.stdout.as_str()), (Some(1), ""));
    assert!(
        answer.stderr.contains("Unauthenticated desc = the learner asks for a token"),
        "{}",
        answer.stderr
    );
    // And without a certificate there is no connection at all.
    let options = ["-cacert", &ca, "-H", &bearer, "-connect-timeout", "2"];
    let answer = Grpcurl::new(&program, &options, &at).run(&[], &["list"]);
    assert_eq!((answer.code, answer.stdout.as_str()), (Some(1), ""));
    drop(learner);
    assert_none_left(&run.marker());
}

#[test]
fn the_shipped_schema_serves_grpcurl_without_a_learner() {
    let Some(program) = find() else { return };
    let run = |options: &[&str], words: &[&str]| {
        Answer::from(Command::new(&program).args(options).args(words).output().unwrap())
    };
    let protoset = proto().join("src/generated/cross.v1.bin").display().to_string();
    let sources = proto().join("proto").display().to_string();
    let from_sources = ["learner", "checkpoints", "training"].map(|name| format!("cross/v1/{name}.proto"));
    let from_sources = from_sources.iter().flat_map(|file| ["-proto", file]);
    let from_sources: Vec<&str> = ["-import-path", &sources].into_iter().chain(from_sources).collect();
    for options in [vec!["-protoset", &protoset], from_sources] {
        assert_eq!(run(&options, &["list"]).lines(), SERVICES[..3]);
        let said = run(&options, &["describe", "cross.v1.Checkpoint"]);
        assert!(said.text().contains(".google.protobuf.Timestamp created = 2;"), "{}", said.stdout);
        assert!(said.text().contains("// Agent-decisions trained on."), "{}", said.stdout);
    }
}
