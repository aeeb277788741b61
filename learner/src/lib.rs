//! The learner.
pub mod admission;
pub mod checkpoint;
mod files;
