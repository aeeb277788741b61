//! Files that people write or get from others.

use crate::{Outcome, parts};
use cross_config::{Config, EnvConfig};
use cross_sim::evaluate::EvalReport;
use cross_sim::import::cityflow;
use cross_sim::layout::NetworkLayout;
use cross_sim::metrics::{EpisodeMetrics, TripTotals};
use cross_sim::net::Net;
use cross_sim::scenario::{Arrivals, check_definition};
use std::hint::black_box;
use std::path::Path;

/// How errors call the input.
const NAME: &str = "fuzzed.input";

/// A SUMO net, and the intersections in it.
pub(super) fn net(input: &[u8]) -> Outcome {
    match Net::parse(input, Path::new(NAME)) {
        Ok(net) => {
            let lanes = net.edges.iter().flat_map(|edge| &edge.lanes);
            assert!(lanes.clone().all(|lane| lane.length.is_finite() && lane.speed.is_finite()));
            let _ = black_box(NetworkLayout::fixed_signals(&net));
            match NetworkLayout::from_net(&net, &EnvConfig::default()) {
                Ok(layout) => {
                    let _ = black_box((layout.hash(), layout.lane_rows()));
                    assert!(
                        layout.intersections.iter().all(|at| at.phases.len() > 1 && !at.movements.is_empty())
                    );
                }
                Err(error) => sentence(&error.to_string()),
            }
            Outcome::Accepted
        }
        Err(error) => refused(&error.to_string()),
    }
}

/// A SUMO route or additional file.
pub(super) fn routes(input: &[u8]) -> Outcome {
    match Arrivals::parse(input, Path::new(NAME), 0, 7200) {
        Ok(arrivals) => {
            let sums = (arrivals.volume(), arrivals.mean(), arrivals.std(), arrivals.max(), arrivals.min());
            assert!(arrivals.per_minute.iter().all(|count| *count >= 0.0), "{sums:?}");
            Outcome::Accepted
        }
        Err(error) => refused(&error.to_string()),
    }
}

/// A `scenario.toml`, without the files that it names.
pub(super) fn scenario(input: &[u8]) -> Outcome {
    let Ok(text) = std::str::from_utf8(input) else { return Outcome::Refused };
    match check_definition(text, Path::new(NAME)) {
        Ok(()) => Outcome::Accepted,
        Err(error) => refused(&error.to_string()),
    }
}

/// CityFlow's road network and flows.
pub(super) fn cityflow(input: &[u8]) -> Outcome {
    let [roadnet, flow] = parts::split(input);
    match cityflow::check(roadnet, flow, 3600) {
        Ok(items) => {
            assert!(!items.is_empty());
            Outcome::Accepted
        }
        Err(error) => {
            sentence(&error.to_string());
            Outcome::Refused
        }
    }
}

/// A run's configuration, as TOML and as the JSON that actors get.
pub(super) fn config(input: &[u8]) -> Outcome {
    let Ok(text) = std::str::from_utf8(input) else { return Outcome::Refused };
    match Config::from_toml(text, NAME) {
        Ok(config) => {
            let _ = black_box((config.hash(), config.compatibility_hash(), config.env.steps_per_episode()));
            assert!(Config::from_json(&config.to_json(), NAME).is_ok_and(|again| again == config));
            assert!(Config::from_toml(&config.to_toml(), NAME).is_ok_and(|again| again == config));
            Outcome::Accepted
        }
        Err(error) => refused(&error.to_string()),
    }
}

/// SUMO's trip output.
pub(super) fn trips(input: &[u8]) -> Outcome {
    match TripTotals::parse(input, Path::new(NAME)) {
        Ok(totals) => {
            let seconds = cross_sim::metrics::SecondMeter::default();
            let episode = EpisodeMetrics::new(1, &seconds, &totals, 0.0);
            let _ = black_box(serde_json::to_string(&episode).is_ok());
            Outcome::Accepted
        }
        Err(error) => refused(&error.to_string()),
    }
}

/// The report of an evaluation.
pub(super) fn report(input: &[u8]) -> Outcome {
    let Ok(text) = std::str::from_utf8(input) else { return Outcome::Refused };
    match EvalReport::from_json(text) {
        Ok(report) => {
            assert!(EvalReport::from_json(&report.to_json()).is_ok_and(|again| again == report));
            Outcome::Accepted
        }
        Err(error) => {
            sentence(&error.to_string());
            Outcome::Refused
        }
    }
}

/// An error names the file.
fn refused(error: &str) -> Outcome {
    sentence(error);
    assert!(error.contains(NAME), "{error}");
    Outcome::Refused
}

fn sentence(error: &str) {
    assert!(!error.is_empty());
}
