//! Files as SUMO and CROSS write them, damaged: whatever is in them, reading ends with a value or a sentence.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cross_config::EnvConfig;
use cross_sim::controller::RuleBased;
use cross_sim::env::{Env, EnvOptions};
use cross_sim::evaluate::{EvalReport, Setting, evaluate_seeds};
use cross_sim::layout::NetworkLayout;
use cross_sim::metrics::{Metric, TripTotals};
use cross_sim::net::Net;
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use proptest::prelude::*;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::LazyLock;

const NAME: &str = "damaged";

fn scenario() -> Scenario {
    Scenario::load("cologne1").expect("set-up fetched the maps")
}

/// A minute of traffic with SUMO's emissions device.
static TRIPS: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let home = SumoHome::locate(None).expect("set-up installed SUMO");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trips.xml");
    let options = EnvOptions {
        tripinfo: Some(path.clone()),
        extra_args: ["--device.emissions.probability", "1"].map(str::to_owned).to_vec(),
        ..EnvOptions::new(EnvConfig { episode_seconds: 60, ..EnvConfig::default() })
    };
    let mut env = Env::new(&home, &scenario(), options).unwrap();
    env.reset(1).unwrap();
    for _ in 0..6 {
        env.step(&[0]).unwrap();
    }
    env.finish().unwrap();
    std::fs::read(path).unwrap()
});

static NET: LazyLock<Vec<u8>> = LazyLock::new(|| std::fs::read(scenario().net).unwrap());

static REPORT: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let (home, scenario) = (SumoHome::locate(None).expect("set-up installed SUMO"), scenario());
    let env = EnvConfig { episode_seconds: 60, ..EnvConfig::default() };
    let setting = Setting { details: true, ..Setting::new(&home, &scenario, &env) };
    let make = || Ok(RuleBased::FixedTime.controller(scenario.reference.max_pressure));
    let report = evaluate_seeds(&setting, "fixed-time", &make, &[1], 1, &|_| ControlFlow::Continue(()));
    report.unwrap().to_json().into_bytes()
});

/// Some bytes taken out, others put in, perhaps the end cut off.
fn damaged(good: &'static [u8]) -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..12),
        prop::sample::select(vec![
            "\"",
            "<",
            "/>",
            "-1",
            "1e999",
            "NaN",
            "99999999999999999999",
            ",",
            ",,",
            " ",
            "null",
            "{",
            "]",
            "&#0;",
            "<tripinfo ",
            "</emissions>",
            "shape=\"1\"",
        ])
        .prop_map(|text| text.as_bytes().to_vec()),
    ];
    let edit = (any::<prop::sample::Index>(), 0..40_usize, piece);
    (prop::collection::vec(edit, 1..6), prop::option::of(any::<prop::sample::Index>())).prop_map(
        move |(edits, cut)| {
            let mut bytes = good.to_vec();
            for (at, removed, inserted) in edits {
                let at = at.index(bytes.len() + 1);
                let end = (at + removed).min(bytes.len());
                bytes.splice(at..end, inserted);
            }
            if let Some(cut) = cut {
                bytes.truncate(cut.index(bytes.len() + 1));
            }
            bytes
        },
    )
}

/// Digits exchanged for others and for what stands beside digits: the file stays well-formed, its numbers do not.
fn renumbered(good: &'static [u8]) -> impl Strategy<Value = Vec<u8>> {
    let digits: Vec<usize> =
        good.iter().enumerate().filter(|(_, byte)| byte.is_ascii_digit()).map(|(at, _)| at).collect();
    let letters = prop::sample::select(b"0123456789-.e,".to_vec());
    prop::collection::vec((prop::sample::select(digits), letters), 1..10).prop_map(move |edits| {
        let mut bytes = good.to_vec();
        for (at, letter) in edits {
            bytes[at] = letter;
        }
        bytes
    })
}

fn any_bytes() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), 0..300)
}

proptest! {
    #[test]
    fn trip_outputs(bytes in prop_oneof![damaged(&TRIPS), renumbered(&TRIPS), any_bytes()]) {
        match TripTotals::parse(bytes.as_slice(), Path::new(NAME)) {
            Ok(totals) => prop_assert!(totals.trip_time().mean.is_finite() && totals.co2().std.is_finite()),
            Err(error) => prop_assert!(error.to_string().contains(NAME), "{error}"),
        }
    }

    #[test]
    fn nets(bytes in prop_oneof![damaged(&NET), renumbered(&NET), any_bytes()]) {
        match Net::parse(bytes.as_slice(), Path::new(NAME)) {
            Ok(net) => {
                let numbers = net.edges.iter().flat_map(|edge| &edge.lanes).flat_map(|lane| lane.shape.iter().flatten());
                prop_assert!(numbers.into_iter().all(|number| number.is_finite()));
                let _ = NetworkLayout::from_net(&net, &EnvConfig::default());
            }
            Err(error) => prop_assert!(error.to_string().contains(NAME), "{error}"),
        }
    }

    #[test]
    fn reports(bytes in prop_oneof![damaged(&REPORT), renumbered(&REPORT), any_bytes()]) {
        let Ok(text) = String::from_utf8(bytes) else { return Ok(()) };
        if let Ok(report) = EvalReport::from_json(&text) {
            // What was accepted reads back the same.
            prop_assert!(report.get(Metric::Co2).mean.is_finite());
            prop_assert_eq!(EvalReport::from_json(&report.to_json()).unwrap(), report);
        }
    }
}

#[test]
fn the_files_as_they_were_are_read() {
    let totals = TripTotals::parse(TRIPS.as_slice(), Path::new(NAME)).unwrap();
    assert!(totals.unfinished() > 5 && totals.co2().mean > 1.0);
    let net = Net::parse(NET.as_slice(), Path::new(NAME)).unwrap();
    assert!(net.edges.iter().flat_map(|edge| &edge.lanes).all(|lane| lane.shape.len() >= 2));
    let report = EvalReport::from_json(std::str::from_utf8(&REPORT).unwrap()).unwrap();
    assert_eq!(report.to_json().as_bytes(), REPORT.as_slice());
    assert!(report.details.is_some());
}
