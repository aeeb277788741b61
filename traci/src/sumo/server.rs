//! A SUMO for a client that is not of this crate.

use super::SumoHome;
use super::launch::{Words, launch, on_free_port};
use super::port::PortReservation;
use super::process::Process;
use super::start::{ExitReport, SumoCommand, ended};
use crate::error::TraciError;
use std::sync::Arc;
use std::time::Duration;

/// A SUMO that waits on a port for somebody else's client, to compare clients or to try one.
///
/// It is started, watched and ended as a [`Sumo`](super::Sumo) is: it cannot outlive this process, and dropping it kills
/// it.
#[derive(Debug)]
pub struct SumoServer {
    process: Arc<Process>,
    port: u16,
}

impl SumoServer {
    /// Starts SUMO and waits, at most `timeout`, until it listens. Where the system does not tell who listens (elsewhere than
    /// on Linux) it does not wait, and the client may have to try again. SUMO loads its files once the client is connected;
    /// what is wrong with them is told by [`wait`](Self::wait), not to the client.
    ///
    /// # Errors
    /// [`TraciError::Spawn`] with what SUMO printed if it cannot be started or ends before it listens,
    /// [`TraciError::Timeout`].
    pub fn start(home: &SumoHome, command: &SumoCommand, timeout: Duration) -> Result<Self, TraciError> {
        let words = Words { binary: home.binary("sumo"), timeout };
        on_free_port(home, timeout, &mut PortReservation::new, |port, left| {
            let (process, ()) = launch(command.command(home, port), port, left, &words, |_, _| Some(()))?;
            Ok(Self { process, port })
        })
    }

    /// The port it listens on, on every address of this machine. It takes one client.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// SUMO's process id.
    pub fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// Waits until SUMO has ended, as it does when its client closes the connection, and reaps it; after `timeout` kills
    /// it.
    ///
    /// # Errors
    /// [`TraciError::Crashed`] if SUMO ended with anything but success, [`TraciError::Timeout`] if it had to be killed.
    /// SUMO has ended in every case.
    pub fn wait(self, timeout: Duration) -> Result<ExitReport, TraciError> {
        ended(&self.process, timeout, timeout)
    }
}

impl Drop for SumoServer {
    fn drop(&mut self) {
        self.process.kill();
    }
}
