//! The SUMO installation that a command uses.

use crate::failure::{OrBadInput, Outcome};
use clap::Args;
use cross_traci::sumo::SumoHome;
use std::path::PathBuf;

/// The option that says where SUMO is.
#[derive(Debug, Clone, Args)]
pub(crate) struct SumoOption {
    /// SUMO's installation folder, the one with bin/sumo in it
    ///
    /// Without it: $SUMO_HOME, then .deps/sumo/sumo beside or above this program or the current folder, then PATH.
    #[arg(long, value_name = "DIR")]
    pub(crate) sumo_home: Option<PathBuf>,
}

impl SumoOption {
    /// Finds it.
    pub(crate) fn locate(&self) -> Outcome<SumoHome> {
        SumoHome::locate(self.sumo_home.as_deref()).or_bad_input()
    }
}
