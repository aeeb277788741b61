//! What `cross eval --json` prints: valid against the published schema, the same bytes each time, and the schema lets
//! nothing else pass.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

mod schema;

use cross_sim::evaluate::EvalReport;
use cross_tests::runs::Run;
use schema::Schema;
use serde_json::{Value, json};

fn eval_schema() -> Schema {
    Schema::parse(include_str!("../../schemas/eval.schema.json"))
}

#[test]
fn an_evaluation_is_valid_and_the_same_each_time() {
    let run = Run::new();
    let arguments = ["eval", "--scenario", "grid4x4", "--policy", "max-pressure", "--seeds", "3", "--json"];
    let first = run.call(&arguments);
    assert_eq!(first.code, Some(0), "{}", first.stderr);
    let document: Value = serde_json::from_str(&first.stdout).unwrap();
    assert_eq!(eval_schema().faults(&document), [""; 0]);
    assert_eq!(document["seeds"], json!([1, 2, 3]));
    assert_eq!(EvalReport::from_json(&first.stdout).unwrap().per_seed.len(), 3);
    let second = run.call(&arguments);
    assert!(first.stdout == second.stdout, "a second run printed other bytes");
}

/// A short evaluation with details.
fn detailed() -> Value {
    let run = Run::new();
    let (config, out) = (run.config().display().to_string(), run.config().with_file_name("report.json"));
    let file = out.display().to_string();
    let policy = ["eval", "--scenario", "cologne1", "--policy", "fixed-time", "--seeds", "2"];
    let finished = run.call(&[&policy[..], &["--config", &config, "--out", &file]].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    let report: Value = serde_json::from_str(&std::fs::read_to_string(out).unwrap()).unwrap();
    assert_eq!(report["details"]["seeds"].as_array().unwrap().len(), 2);
    report
}

/// Every place of a document, but of arrays only their first item: all are of one kind.
fn places(value: &Value, place: &str, found: &mut Vec<String>) {
    found.push(place.to_owned());
    match value {
        Value::Object(members) => {
            members.iter().for_each(|(name, member)| places(member, &format!("{place}/{name}"), found));
        }
        Value::Array(items) => {
            items.iter().take(1).for_each(|item| places(item, &format!("{place}/0"), found));
        }
        _ => {}
    }
}

#[test]
fn the_schema_lets_nothing_else_pass() {
    let schema = eval_schema();
    let good = detailed();
    assert_eq!(schema.faults(&good), [""; 0]);
    let mut found = Vec::new();
    places(&good, "", &mut found);
    assert!(found.len() > 150, "{found:?}");
    let fails = |document: &Value, what: &str| {
        assert!(!schema.faults(document).is_empty(), "{what} passed");
    };
    for place in &found {
        for wrong in [Value::Null, json!("a word"), json!(-7.5), json!({}), json!([[{}]]), json!(true)] {
            let mut document = good.clone();
            let value = document.pointer_mut(place).unwrap();
            let same_type = std::mem::discriminant(value) == std::mem::discriminant(&wrong);
            *value = wrong;
            // Another text, or another truth, is as good as the one before.
            if !same_type {
                fails(&document, &format!("{} at {place}", document.pointer(place).unwrap()));
            }
        }
        let mut document = good.clone();
        if let Some(object) = document.pointer_mut(place).unwrap().as_object_mut() {
            object.insert("surprise".to_owned(), json!(1));
            fails(&document, &format!("a surprise in {place}"));
        }
        let (parent, name) = place.rsplit_once('/').unwrap_or_default();
        let mut document = good.clone();
        let removed = document
            .pointer_mut(parent)
            .and_then(Value::as_object_mut)
            .and_then(|object| object.remove(name));
        if removed.is_some() && place != "/details" {
            fails(&document, &format!("a document without {place}"));
        }
    }
}

#[test]
fn values_out_of_their_range_are_faults() {
    let schema = eval_schema();
    let good = detailed();
    for (place, wrong) in [
        ("/format", json!(2)),
        ("/protocol/detection", json!("elsewhere")),
        ("/protocol/preset", json!("mine")),
        ("/protocol/net_hash", json!("0af7")),
        ("/protocol/interval_seconds", json!(0)),
        ("/protocol/reward_beyond", json!(1.5)),
        ("/seeds", json!([])),
        ("/seeds", json!([1, 1])),
        ("/seeds/0", json!(4_294_967_296_u64)),
        ("/metrics/co2/std", json!(-0.1)),
        ("/per_seed/0/vehicles/finished", json!(1.5)),
        ("/details/network/edges/0/shape/0", json!([1, 2, 3])),
    ] {
        let mut document = good.clone();
        *document.pointer_mut(place).unwrap() = wrong.clone();
        let faults = schema.faults(&document);
        assert!(!faults.is_empty(), "{wrong} at {place} passed");
    }
}
