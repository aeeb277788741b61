//! Evaluations made up for tests.

use cross_sim::evaluate::EvalReport;
use cross_sim::metrics::Metric;
use serde_json::{Map, Value, json};

/// An evaluation with details in which every metric of a seed is that seed's number.
pub(super) fn report(scenario: &str, policy: &str, seeds: &[u32]) -> EvalReport {
    scaled(scenario, policy, seeds, 1.0)
}

/// The same with every mean times a factor.
pub(super) fn scaled(scenario: &str, policy: &str, seeds: &[u32], factor: f64) -> EvalReport {
    serde_json::from_value(document(scenario, policy, seeds, factor)).unwrap()
}

/// The same with a changed member of its protocol.
pub(super) fn with_protocol(scenario: &str, policy: &str, member: &str, value: Value) -> EvalReport {
    let mut document = document(scenario, policy, &[1], 1.0);
    document["protocol"][member] = value;
    serde_json::from_value(document).unwrap()
}

fn document(scenario: &str, policy: &str, seeds: &[u32], factor: f64) -> Value {
    let mean = factor * seeds.iter().map(|&seed| f64::from(seed)).sum::<f64>() / seeds.len().max(1) as f64;
    json!({
        "format": 1, "scenario": scenario, "policy": policy, "controller": policy, "seeds": seeds,
        "protocol": {
            "preset": "paper", "interval_seconds": 10, "yellow_seconds": 3, "begin_seconds": 0, "episode_seconds": 3600,
            "detection": "default", "reward_range_metres": 50.0, "time_to_teleport_seconds": -1.0, "depart_speed": "0",
            "depart_lane": "first", "sumo_version": "1.28.0", "net_hash": "aaaaaaaaaaaaaaaa", "demand_hash": "bbbb",
            "layout_hash": "cccc",
        },
        "metrics": metrics(|| json!({ "mean": mean, "std": 0.5, "std_between_seeds": 1.0 })),
        "vehicles": { "finished": 8.0, "unfinished": 2.0, "never_inserted": 0.0, "teleports": 0.0 },
        "episode_return": -mean, "gridlocked_seeds": [],
        "per_seed": seeds.iter().map(|&seed| json!({
            "seed": seed, "metrics": metrics(|| json!({ "mean": factor * f64::from(seed), "std": 0.5 })),
            "vehicles": { "finished": 8, "unfinished": 2, "never_inserted": 0, "teleports": 0 },
            "episode_return": -f64::from(seed), "gridlock": false,
        })).collect::<Vec<_>>(),
        "details": {
            "network": {
                "edges": [{ "id": "in", "lanes": 2, "shape": [[0.0, 0.0], [100.0, 0.0]] }],
                "signals": [{ "id": "J0", "x": 100.0, "y": 0.0 }],
            },
            "seeds": seeds.iter().map(|&seed| json!({
                "seed": seed,
                "series": {
                    "interval_seconds": 10, "queue_length": [0.0, seed, 1.0, 0.5, 0.2, 0.1], "speed": [0.0, 5.0, 6.0, 7.0, 8.0, 9.0],
                    "running": [1.0, 2.0, 3.0, 2.0, 2.0, 1.0], "waiting_to_enter": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                    "arrived": [0, 0, 2, 2, 2, 2],
                },
                "trips": {
                    "finished": { "trip_time": [20.0, 30.0], "trip_delay": [1.0, 2.0] },
                    "unfinished": { "trip_time": [55.0], "trip_delay": [9.0] }, "never_inserted": [],
                },
                "intersections": [{
                    "id": "J0", "queue_length": seed, "stopped": 1.0, "vehicles": 2.0,
                    "roads": [{ "edge": "in", "queue_length": 0.5 }],
                }],
            })).collect::<Vec<_>>(),
        },
    })
}

fn metrics(value: impl Fn() -> Value) -> Value {
    Value::Object(Metric::ALL.iter().map(|metric| (metric.key().to_owned(), value())).collect::<Map<_, _>>())
}
