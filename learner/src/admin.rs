//! What the learner tells on its admin port.

use crate::coordinator::Life;
use crate::telemetry::Telemetry;
use cross_support::admin::Subject;
use tokio::sync::watch;

/// The learner as its admin port shows it.
#[derive(Clone)]
pub(crate) struct Admin {
    pub(crate) telemetry: Telemetry,
    pub(crate) life: watch::Receiver<Life>,
}

impl Subject for Admin {
    fn metrics(&self) -> String {
        self.telemetry.render()
    }

    fn ready(&self) -> Result<(), &'static str> {
        match *self.life.borrow() {
            Life::Serving => Ok(()),
            Life::Starting => Err("starting"),
            Life::Draining => Err("draining"),
        }
    }
}
