//! A real Prometheus on a real run: what the dashboards and the alert rules ask is there to be answered.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::processes::assert_none_left;
use cross_tests::prometheus::{Prometheus, selectors};
use cross_tests::runs::Run;
use cross_tests::{http, packages, wait};
use rustix::process::Signal;
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn deploy() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join("deploy")
}

/// A query of a dashboard: where it stands, and what it asks.
struct Asked {
    place: String,
    query: String,
}

/// Every query of every panel and variable of every dashboard, with all values for the variables.
fn dashboard_queries() -> Vec<Asked> {
    let mut asked = Vec::new();
    for entry in std::fs::read_dir(deploy().join("grafana/dashboards")).unwrap() {
        let path = entry.unwrap().path();
        let board: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let title = board["title"].as_str().unwrap();
        let mut names = Vec::new();
        for variable in board["templating"]["list"].as_array().unwrap() {
            names.push(format!("${}", variable["name"].as_str().unwrap()));
            let definition = variable["definition"].as_str().unwrap();
            for query in selectors(definition) {
                asked.push(Asked { place: format!("{title}, variable {}", names.last().unwrap()), query });
            }
        }
        for panel in board["panels"].as_array().unwrap() {
            for target in panel["targets"].as_array().into_iter().flatten() {
                let query = target["expr"].as_str().unwrap().to_owned();
                let query = names.iter().fold(query, |query, name| query.replace(name.as_str(), ".*"));
                asked.push(Asked { place: format!("{title}, panel {}", panel["title"]), query });
            }
        }
    }
    asked
}

/// The query on which Kubernetes scales actors, as prometheus-adapter would ask it of this run's.
fn busy_ratio() -> String {
    let rules = std::fs::read_to_string(deploy().join("kubernetes/prometheus-adapter.yaml")).unwrap();
    let (_, query) = rules.split_once("metricsQuery: >-").unwrap();
    query.replace("<<.GroupBy>>", "instance").replace("<<.LabelMatchers>>", "job=\"cross-actor\"")
}

/// Feeds a text to `promtool check metrics`, which knows the naming rules and the format.
fn assert_good_exposition(promtool: &Path, program: &str, exposition: &str) {
    let mut check = Command::new(promtool)
        .args(["check", "metrics"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    check.stdin.take().unwrap().write_all(exposition.as_bytes()).unwrap();
    let said = check.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&said.stderr).into_owned() + &String::from_utf8_lossy(&said.stdout);
    assert!(said.status.success(), "{program}: {text}");
}

/// The address behind `/metrics` of the run's first actor, from its log.
fn actor_metrics(run: &Run) -> Option<String> {
    let log = std::fs::read_to_string(run.path().join("logs/actor-0.log")).ok()?;
    let (_, rest) = log.split_once("metrics at http://")?;
    Some(rest.split_once('/')?.0.to_owned())
}

#[test]
fn every_query_of_dashboards_and_alerts_is_answered_by_a_real_run() {
    let found = (packages::program("prometheus", "prometheus"), packages::program("promtool", "prometheus"));
    let (Some(prometheus), Some(promtool)) = found else { return };

    let run = Run::new();
    let mut training = run.start(&["--scenario", "grid4x4", "--updates", "100000", "--actors", "1"]);
    training.wait_for_updates(1);
    let file: Value =
        serde_json::from_slice(&std::fs::read(run.path().join("learner.json")).unwrap()).unwrap();
    let learner = file["metrics"].as_str().unwrap().to_owned();
    let actor = wait::until("the actor's address", || actor_metrics(&run));
    for (program, address) in [("learner", &learner), ("actor", &actor)] {
        let exposition = http::get(address, "/metrics").unwrap();
        assert!(exposition.contains("cross_build_info"), "{program}: {exposition}");
        assert_good_exposition(&promtool, program, &exposition);
    }

    let rules = deploy().join("prometheus/alerts.yml");
    let jobs = [("cross-learner", learner.as_str()), ("cross-actor", actor.as_str())];
    let server = Prometheus::start(&prometheus, &run, &jobs, &rules);
    // Rates need a few scrapes, and an episode must have ended in between.
    let scrapes = "min(count_over_time(up[1m])) >= 4";
    wait::until("some scrapes", || server.query(scrapes).ok().filter(|found| !found.is_empty()));
    training.wait_for_updates(run.updates() + 2);

    assert!(
        server.query("cross_no_such_metric").unwrap().is_empty(),
        "a metric that nobody exports has no data"
    );
    let busy = server.query(&busy_ratio()).unwrap();
    let value: f64 = busy[0]["value"][1].as_str().unwrap().parse().unwrap();
    assert!((0.0..=1.0).contains(&value), "actors of Kubernetes are scaled on a share, not on {value}");

    let queries = dashboard_queries();
    assert!(queries.len() > 40, "only {} queries were found", queries.len());
    let mut unanswered = Vec::new();
    for asked in &queries {
        // A gauge of the newest episode may still be on its way when the first query asks for it.
        match wait::for_seconds(20, || server.query(&asked.query).map(|found| !found.is_empty())) {
            Ok(true) => {}
            Ok(false) => unanswered.push(format!("{}: no data for {}", asked.place, asked.query)),
            Err(error) => unanswered.push(format!("{}: {error}", asked.place)),
        }
    }
    assert!(unanswered.is_empty(), "{}", unanswered.join("\n"));

    let rules = wait::until("the rules' first evaluation", || {
        let rules = server.rules();
        (!rules.is_empty() && rules.iter().all(|rule| rule["health"] != "unknown")).then_some(rules)
    });
    for rule in &rules {
        let name = rule["name"].as_str().unwrap();
        assert_eq!(rule["health"], "ok", "{name}: {}", rule["lastError"]);
        assert_eq!(rule["state"], "inactive", "{name} is about to fire on a healthy run");
        let asked = selectors(rule["query"].as_str().unwrap());
        assert!(!asked.is_empty(), "{name} asks for nothing of ours");
        for query in asked {
            assert!(!server.query(&query).unwrap().is_empty(), "{name}: no data for {query}");
        }
    }
    println!("{} queries of dashboards and {} alert rules answered", queries.len(), rules.len());

    training.send(Signal::INT);
    drop(server);
    assert_eq!(training.wait().code, Some(0));
    assert_none_left(&run.marker());
}

#[test]
fn the_shipped_prometheus_configuration_is_valid() {
    let Some(promtool) = packages::program("promtool", "prometheus") else { return };
    let config = deploy().join("prometheus/prometheus.yml");
    let check = Command::new(promtool).args(["check", "config"]).arg(config).output().unwrap();
    assert!(check.status.success(), "{}", String::from_utf8_lossy(&check.stderr));
}

/// Series made up for each alert, in `alerts_test.yml`: it fires, and on healthy series it does not.
#[test]
fn every_alert_fires_when_it_should() {
    let Some(promtool) = packages::program("promtool", "prometheus") else { return };
    let cases = deploy().join("prometheus/alerts_test.yml");
    let text = std::fs::read_to_string(&cases).unwrap();
    for alert in alerts() {
        assert!(text.contains(&format!("alertname: {alert}\n")), "{alert} is tested by nothing");
    }
    let check = Command::new(promtool).args(["test", "rules"]).arg(cases).output().unwrap();
    let said = [check.stdout, check.stderr].concat();
    assert!(check.status.success(), "{}", String::from_utf8_lossy(&said));
}

fn alerts() -> Vec<String> {
    let rules = std::fs::read_to_string(deploy().join("prometheus/alerts.yml")).unwrap();
    rules.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).map(str::to_owned).collect()
}

#[test]
fn every_alert_is_explained_with_its_remedy() {
    let page = std::fs::read_to_string(deploy().parent().unwrap().join("docs/operations.md")).unwrap();
    let alerts = alerts();
    assert!(alerts.len() >= 10, "{alerts:?}");
    for alert in alerts {
        assert!(page.contains(&format!("`{alert}`")), "docs/operations.md does not explain {alert}");
    }
}
