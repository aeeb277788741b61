//! The program itself: exit codes, sentences, learner.json, signals.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking, in their helpers too")]

use std::path::Path;
use std::process::{Command, Output, Stdio};

fn learner(run: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cross-learner"));
    command
        .arg("--run")
        .arg(run)
        .args(more)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn fails(command: &mut Command, code: i32, words: &[&str]) {
    let Output { status, stderr, stdout } = command.output().unwrap();
    let stderr = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(code), "{stderr}");
    assert!(stdout.is_empty());
    let last = stderr.split("error: ").last().unwrap();
    assert_ne!(last, stderr, "no error");
    for word in words {
        assert!(last.contains(word), "{word:?} is missing in {last:?}");
    }
    assert!(!stderr.contains("panicked"), "{stderr}");
}

#[test]
fn bad_input_is_one_sentence_and_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let config = folder.path().join("c.toml");
    let with_config = |text: &str, more: &[&str]| {
        std::fs::write(&config, text).unwrap();
        let mut command = learner(&run, more);
        command.arg("--config").arg(&config);
        command
    };
    fails(learner(&run, &["--config", "nowhere.toml"]).current_dir(folder.path()), 2, &["nowhere.toml"]);
    fails(&mut with_config("updatez = 3", &[]), 2, &["c.toml", "updatez"]);
    fails(&mut with_config("scenarios = [\"atlantis\"]", &[]), 2, &["atlantis"]);
    fails(&mut with_config("", &["--log", "cross=loudly"]), 2, &["--log", "filter"]);
    let json = ["--log", "cross=loudly", "--log-format", "json"];
    fails(&mut with_config("", &json), 2, &["--log", "filter"]);
    let exposed = ["--listen", "0.0.0.0:0"];
    fails(&mut with_config("", &exposed), 2, &["--listen", "0.0.0.0:0", "--insecure"]);
    assert!(!run.exists(), "nothing is touched before the options are found to be good");
    let usage = learner(&run, &["--port", "1"]).output().unwrap();
    assert_eq!(usage.status.code(), Some(2));
    let help = learner(&run, &["--help"]).output().unwrap();
    let text = String::from_utf8(help.stdout).unwrap();
    assert!(help.status.success() && text.contains("learner.json") && text.contains("Exit codes"), "{text}");
}

/// With a real network from the set-up.
mod with_a_network {
    use super::*;
    use std::io::{BufRead, BufReader};
    use std::process::Child;

    fn start(run: &Path, more: &[&str]) -> (Child, serde_json::Value, String) {
        let config = run.with_extension("toml");
        std::fs::write(&config, "updates = 3\n[model]\nhidden = 16\nlatent = 8\nheads = 2\n").unwrap();
        let mut child = learner(run, more).arg("--config").arg(&config).spawn().unwrap();
        let mut log = String::new();
        // What it logs later has no reader any more, which it must bear.
        for line in BufReader::new(child.stderr.take().unwrap()).lines() {
            let line = line.unwrap();
            log.push_str(&line);
            log.push('\n');
            if line.contains(" serving ") {
                break;
            }
        }
        let text = std::fs::read_to_string(run.join("learner.json"));
        let text = text.unwrap_or_else(|error| panic!("{error}: {log}"));
        (child, serde_json::from_str(&text).unwrap(), log)
    }

    fn terminate(mut child: Child) {
        let pid = rustix::process::Pid::from_child(&child);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
        assert!(child.wait().unwrap().success());
    }

    #[test]
    fn it_announces_itself_keeps_others_out_drains_and_resumes() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let (child, listening, _) = start(&run, &[]);
        assert_eq!(listening["pid"].as_u64(), Some(u64::from(child.id())));
        let config = run.with_extension("toml");
        let mut other = learner(&run, &["--resume"]);
        fails(other.arg("--config").arg(&config), 2, &["another learner", "run"]);
        terminate(child);
        assert!(!run.join("learner.json").exists());
        assert!(run.join("checkpoints/000000/metadata.json").exists());
        fails(learner(&run, &[]).arg("--config").arg(&config), 2, &["1 checkpoints", "--resume"]);

        let (child, again, log) = start(&run, &["--resume"]);
        assert_eq!(again["run_id"], listening["run_id"]);
        assert!(again["session_epoch"].as_u64() > listening["session_epoch"].as_u64());
        assert!(log.contains("resuming"), "{log}");
        terminate(child);

        // Of another model: refused by name.
        std::fs::write(&config, "[model]\nhidden = 32\n").unwrap();
        fails(learner(&run, &["--resume"]).arg("--config").arg(&config), 2, &["000000", "[model]"]);
        // Weights of another shape than their description says.
        let wider = cross_config::Config::from_file(&config).unwrap().compatibility_hash();
        let metadata = run.join("checkpoints/000000/metadata.json");
        let text = std::fs::read_to_string(&metadata).unwrap();
        let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
        value["compatibility_hash"] = wider.into();
        std::fs::write(&metadata, value.to_string()).unwrap();
        fails(learner(&run, &["--resume"]).arg("--config").arg(&config), 2, &["does not fit"]);
        // The only checkpoint damaged: a sentence with a remedy.
        std::fs::write(run.join("checkpoints/000000/optimizer.safetensors"), "torn").unwrap();
        fails(
            learner(&run, &["--resume"]).arg("--config").arg(&config),
            2,
            &["optimizer.safetensors", "backup"],
        );
    }
}
