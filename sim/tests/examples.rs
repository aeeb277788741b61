//! The examples work: each is compiled into this test and run on a small map.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

#[allow(dead_code, reason = "an example's main is its command line, which is not run here")]
#[path = "../examples/episode_time.rs"]
mod episode_time;
#[allow(dead_code, reason = "as above")]
#[path = "../examples/my_controller.rs"]
mod my_controller;

#[test]
fn a_controller_of_ones_own_stands_beside_the_built_in_ones() {
    let text = my_controller::compare("cologne1", 300).unwrap();
    let header = text.lines().find(|line| line.contains("longest-first")).unwrap_or_else(|| panic!("{text}"));
    assert!(header.contains("fixed-time") && header.contains("max-pressure-stopped"), "{text}");
    assert!(text.contains("cologne1") && text.contains("trip delay"), "{text}");
}

#[test]
fn the_time_of_an_episode_is_told() {
    let text = episode_time::times("cologne1", 2).unwrap();
    assert!(text.contains("by decision: ") && text.contains("by second: "), "{text}");
}
