//! One file per command.

pub(crate) mod baselines;
pub(crate) mod bench;
pub(crate) mod checkpoint;
pub(crate) mod doctor;
pub(crate) mod eval;
mod publish;
pub(crate) mod report;
pub(crate) mod results;
pub(crate) mod scenario;
pub(crate) mod train;
