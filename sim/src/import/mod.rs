//! Scenarios from other simulators' files.

pub mod cityflow;
