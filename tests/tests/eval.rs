//! `cross eval`: protocols, files, programs of SUMO's, and what it refuses.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::runs::{Finished, Run, SMALL};
use serde_json::Value;
use std::path::Path;

/// `cross eval` in episodes of 300 s with further arguments.
fn eval(run: &Run, arguments: &[&str]) -> Finished {
    run.write_config(&seconds(300));
    let config = run.config().display().to_string();
    run.call(&[&["eval", "--seeds", "2", "--config", &config], arguments].concat())
}

/// A configuration of small episodes.
fn seconds(seconds: u32) -> String {
    SMALL.replace("episode_seconds = 200", &format!("episode_seconds = {seconds}"))
}

fn json(run: &Run, arguments: &[&str]) -> Value {
    eval(run, &[arguments, &["--json"]].concat()).json()
}

#[test]
fn programs_of_sumos_are_policies_like_any_other() {
    let run = Run::new();
    let mut delays = Vec::new();
    for policy in ["own-program", "actuated", "delay-based"] {
        let report = json(&run, &["--scenario", "cologne1", "--policy", policy]);
        assert_eq!((&report["policy"], &report["controller"]), (&policy.into(), &policy.into()));
        assert_eq!(report["seeds"], serde_json::json!([1, 2]));
        delays.push(report["metrics"]["trip_delay"]["mean"].as_f64().unwrap());
    }
    assert!(delays[0] != delays[1] && delays[1] != delays[2], "{delays:?}");
}

#[test]
fn a_preset_sets_what_it_says_and_is_named_beside_the_result() {
    let run = Run::new();
    let of = |scenario: &str, preset: &[&str]| {
        let policy = ["--scenario", scenario, "--policy", "fixed-time"];
        let report = json(&run, &[&policy, preset].concat());
        let protocol = &report["protocol"];
        let values = ["preset", "interval_seconds", "yellow_seconds", "time_to_teleport_seconds"];
        (values.map(|key| protocol[key].to_string()).join(" "), report["metrics"].clone())
    };
    let (default, same) = of("arterial4x4", &[]);
    assert_eq!(default, "\"paper\" 10 3 -1.0");
    assert_eq!(of("arterial4x4", &["--protocol", "paper"]), (default, same.clone()));
    let (resco, other) = of("arterial4x4", &["--protocol", "resco"]);
    assert_eq!(resco, "\"resco\" 5 2 -1.0");
    assert_ne!(same, other, "the times do change the traffic");
    assert_eq!(of("cologne1", &["--protocol", "unicorn"]).0, "\"unicorn\" 15 5 -1.0");
    assert_eq!(of("grid5x5", &["--protocol", "unicorn"]).0, "\"unicorn\" 10 3 300.0");
    // A configuration of one's own is no preset.
    let config = run.config().with_file_name("own.toml");
    std::fs::write(&config, seconds(300).replace("[env]", "[env]\ndecision_seconds = 20")).unwrap();
    let config = config.display().to_string();
    let arguments =
        ["eval", "--scenario", "cologne1", "--policy", "random", "--seeds", "1", "--config", &config];
    assert_eq!(run.call(&[&arguments[..], &["--json"]].concat()).json()["protocol"]["preset"], "custom");
    let text =
        eval(&run, &["--scenario", "arterial4x4", "--policy", "fixed-time", "--protocol", "resco"]).stdout;
    assert!(text.contains("resco") && text.contains("every 5 s with 2 s"), "{text}");
}

#[test]
fn a_policy_is_refused_where_it_did_not_train() {
    let run = Run::new();
    run.write_config(SMALL);
    let _ = run.finish(&["--updates", "1", "--actors", "1", "--eval-seeds", "0"]).json();
    let policy = run.path().display().to_string();
    let eval = |scenario: &str, protocol: &str| {
        let arguments = ["eval", "--scenario", scenario, "--policy", &policy, "--seeds", "1", "--json"];
        run.call(&[&arguments[..], &["--protocol", protocol]].concat())
    };
    let trained_for = ["10 s with 3 s", "5 s with 2 s", "env.decision_seconds = 5"];
    eval("arterial4x4", "resco").assert_refused(&trained_for);
    // RESCO's times are those of the training on this map.
    let report = eval("grid4x4", "resco").json();
    assert_eq!(report["protocol"]["preset"], "resco");
    assert_eq!(report["metrics"], eval("grid4x4", "paper").json()["metrics"]);
}

/// Cells of a table whose cells hold no commas and no quotes.
fn cells(file: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(file).unwrap();
    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

#[test]
fn the_csv_file_has_every_figure_of_the_report() {
    let run = Run::new();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("result.csv");
    let csv = file.display().to_string();
    let report = json(&run, &["--scenario", "cologne1", "--policy", "max-pressure", "--csv", &csv]);
    let table = cells(&file);
    assert_eq!(
        table[0].join(" "),
        "scenario policy controller protocol seed metric unit mean std std_between_seeds"
    );
    let row = |seed: &str, metric: &str| {
        let rows: Vec<_> = table.iter().filter(|row| row[4] == seed && row[5] == metric).collect();
        assert_eq!(rows.len(), 1, "{seed} {metric}");
        rows[0].clone()
    };
    let number = |cell: &String| cell.parse::<f64>().unwrap();
    let metrics = report["metrics"].as_object().unwrap();
    for (metric, over_seeds) in metrics {
        let all = row("all", metric);
        for (cell, key) in [(7, "mean"), (8, "std"), (9, "std_between_seeds")] {
            assert_eq!(number(&all[cell]), over_seeds[key].as_f64().unwrap(), "{metric} {key}");
        }
        for (index, seed) in ["1", "2"].into_iter().enumerate() {
            let one = row(seed, metric);
            let figures = &report["per_seed"][index]["metrics"][metric];
            assert_eq!(number(&one[7]), figures["mean"].as_f64().unwrap(), "{metric} of seed {seed}");
            assert_eq!(one[9], "", "one seed has no spread");
        }
    }
    assert_eq!(row("all", "trip_delay")[..4], ["cologne1", "max-pressure", "max-pressure-all", "paper"]);
    for count in ["finished", "unfinished", "never_inserted", "teleports"] {
        let expected = report["vehicles"][count].as_f64().unwrap();
        assert!((number(&row("all", count)[7]) - expected).abs() < 1e-9, "{count}");
    }
    assert_eq!(
        number(&row("1", "episode_return")[7]),
        report["per_seed"][0]["episode_return"].as_f64().unwrap()
    );
    assert_eq!(row("2", "gridlock")[7], "0");
    assert_eq!(table.len(), 1 + 3 * (metrics.len() + 6));
    assert!(table.iter().all(|row| row.len() == 10 && !row.iter().any(|cell| cell == "NaN")));
}

#[test]
fn the_report_file_has_the_details_that_the_printed_one_lacks() {
    let run = Run::new();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("result.json");
    let out = file.display().to_string();
    let printed = json(&run, &["--scenario", "cologne1", "--policy", "greedy", "--out", &out]);
    let mut written: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
    let details = written.as_object_mut().unwrap().remove("details").unwrap();
    assert_eq!(details["seeds"].as_array().unwrap().len(), 2);
    assert_eq!(written, printed);
    assert_eq!(
        printed,
        json(&run, &["--scenario", "cologne1", "--policy", "greedy"]),
        "details cost nothing"
    );
}

#[test]
fn what_cannot_work_is_refused_before_the_first_episode() {
    let run = Run::new();
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path().display().to_string();
    let nowhere = folder.path().join("no/such/folder/x").display().to_string();
    let twice = folder.path().join("x").display().to_string();
    let base = ["--scenario", "cologne1", "--policy", "fixed-time"];
    let refused = |more: &[&str], parts: &[&str]| eval(&run, &[&base, more].concat()).assert_refused(parts);
    refused(&["--csv", &nowhere], &["no/such/folder", "does not exist"]);
    refused(&["--out", &nowhere], &["no/such/folder", "does not exist"]);
    refused(&["--csv", &here], &[&here, "folder"]);
    refused(&["--csv", &twice, "--out", &twice], &["--csv", "--out"]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "a refused command leaves nothing");

    let unknown = eval(&run, &[&base[..], &["--protocol", "nature"]].concat());
    assert_eq!((unknown.code, unknown.stdout.as_str()), (Some(2), ""));
    assert!(
        unknown.stderr.contains("nature") && unknown.stderr.contains("paper, resco, unicorn"),
        "{}",
        unknown.stderr
    );
    eval(&run, &["--scenario", "cologne1", "--policy", "actuatd"]).assert_refused(&[
        "actuatd",
        "actuated",
        "own-program",
    ]);

    // 310 s are no whole number of intervals of 15 s, and an unknown town is like no benchmark.
    run.write_config(&seconds(310));
    let config = run.config().display().to_string();
    let arguments = [&["eval", "--config", &config, "--protocol", "unicorn"], &base[..]].concat();
    run.call(&arguments).assert_refused(&["unicorn", "310", "15"]);
    let scenario =
        cross_tests::scenarios::with_net(folder.path(), "town", &cross_tests::scenarios::junction(4, 2));
    let scenario = scenario.display().to_string();
    let arguments = ["--scenario", &scenario, "--policy", "fixed-time", "--protocol", "unicorn"];
    eval(&run, &arguments).assert_refused(&["unicorn", "benchmark", "scenario.toml"]);
}

#[test]
fn the_long_help_defines_every_metric_of_a_report() {
    let run = Run::new();
    let help = run.call(&["eval", "--help"]).stdout;
    let report = json(&run, &["--scenario", "cologne1", "--policy", "random"]);
    for metric in report["metrics"].as_object().unwrap().keys() {
        assert!(help.contains(&format!("\n  {metric} (")), "{metric} is not in\n{help}");
    }
    assert!(help.contains("from tripinfo waitingTime") && help.contains("delay-based"), "{help}");
}
