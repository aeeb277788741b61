//! The learner.
pub mod admission;
