//! The SUMO process: finding it, starting it on a port of its own, watching it, and never leaving it behind.

mod listening;
mod locate;
mod output;
mod port;
mod process;
mod spawn;
mod start;

pub use locate::{LocateError, Origin, SumoHome};
pub(crate) use process::Process;
pub use start::{ExitReport, Sumo, SumoCommand};
