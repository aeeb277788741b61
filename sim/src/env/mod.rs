//! The environment: one SUMO process, decisions in, observations and rewards out.

mod observer;

pub use observer::{SecondObserver, SecondView};
