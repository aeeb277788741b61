//! An update on one episode of each of three networks (T=360, N=57) stays under 2 GB, measured by the kernel in a process
//! that does nothing else.

#![allow(missing_docs, clippy::unwrap_used, reason = "a test says by failing what went wrong")]

use cross_bench::{memory, update};
use cross_config::Gfe;
use cross_model::Trainer;
use std::process::Command;

/// Which form a child process measures; without it the test below does nothing.
const FORM: &str = "CROSS_BENCH_MEMORY_FORM";
const LIMIT: u64 = 2_000_000_000;

#[test]
fn an_update_of_the_three_networks_stays_below_two_gigabytes() {
    for form in ["paper", "movement"] {
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--ignored", "--exact", "--nocapture", "one_update_in_a_process_of_its_own"])
            .env(FORM, form)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
        let peak = text.lines().find_map(|line| line.split_once("peak bytes: ")).map(|(_, peak)| peak);
        let peak: u64 = peak.and_then(|peak| peak.trim().parse().ok()).expect(&text);
        println!("{form}: {:.0} MB", peak as f64 / 1e6);
        assert!(peak < LIMIT, "{form}: {peak} bytes");
        assert!(peak > LIMIT / 100, "{form}: {peak} bytes are too few for libtorch alone");
    }
}

#[test]
#[ignore = "the other test runs it in a process of its own"]
fn one_update_in_a_process_of_its_own() {
    let Ok(form) = std::env::var(FORM) else { return };
    let form = if form == "paper" { Gfe::Paper } else { Gfe::Movement };
    cross_model::set_single_threaded();
    // Memory does not depend on the number of epochs, which repeat the same minibatches.
    let config = update::config(form, 1).unwrap();
    let networks = update::data::made_up_layouts();
    let fragments = update::data::episodes(&networks, &config, 360, 1);
    let mut trainer = Trainer::new(&config, networks).unwrap();
    let stats = trainer.update(&fragments).unwrap();
    assert_eq!(stats.decisions, 360 * 57);
    println!("peak bytes: {}", memory::peak().unwrap());
}
