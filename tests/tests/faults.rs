//! A short campaign of the fault suite, every kind of fault once; `make faults` runs the long one.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::faults::campaign::Campaign;
use cross_tests::faults::inject::Kind;
use cross_tests::faults::tools;
use cross_tests::packages::skipped;
use std::time::Duration;

#[test]
fn training_survives_every_kind_of_fault_and_no_invariant_breaks() {
    if let Some(problem) = tools::missing() {
        return skipped(&problem);
    }
    let campaign = Campaign {
        seed: 1,
        faults: Kind::ALL.len(),
        actors: 3,
        longest: 0.25,
        checkpoint_updates: 2,
        only: Vec::new(),
        warm_up: Duration::from_secs(4),
        rest: Duration::ZERO,
        // The machine may be of any size and have other things to do.
        patience: 4,
    };
    let mut told = String::new();
    let result = campaign.run(|line| told.push_str(&format!("{line}\n")));
    match result {
        // How soon throughput is back depends on what else the machine does: `make faults` looks at that.
        Ok(report) => assert_eq!(report.struck.len(), Kind::ALL.len()),
        Err(failed) => {
            let (broken, logs, report) = *failed;
            panic!("seed {}: {broken}\n{told}\n{logs}", report.seed);
        }
    }
}
