//! Ties to the operating system: signals in, the parent's death, log lines out.

use crate::options::LogFormat;
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;
use tracing_subscriber::EnvFilter;

/// Sends log lines to stderr.
///
/// # Errors
/// The filter's own complaint.
pub fn log_to_stderr(format: LogFormat, filter: &str) -> Result<(), String> {
    let filter = EnvFilter::try_new(filter).map_err(|error| error.to_string())?;
    let builder =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(false);
    match format {
        LogFormat::Text => builder.with_target(false).try_init(),
        LogFormat::Json => builder.json().flatten_event(true).try_init(),
    }
    .map_err(|error| error.to_string())
}

/// Has the kernel send SIGTERM when the parent ends, however it ends; false if it has ended already.
///
/// `parent` is the parent's id as the parent knows it, or 0. Without it a parent that died before this call goes
/// unnoticed unless the orphan was adopted by process 1.
///
/// # Errors
/// What the kernel said.
pub fn die_with_parent(parent: u32) -> std::io::Result<bool> {
    set_parent_process_death_signal(Some(Signal::TERM))?;
    let now = getppid().map_or(0, |pid| pid.as_raw_nonzero().get().unsigned_abs());
    Ok(if parent == 0 { now > 1 } else { now == parent })
}

/// Cancels `stop` on SIGTERM or SIGINT. A second signal changes nothing: the grace period is short.
///
/// # Errors
/// The handlers could not be installed.
pub fn stop_on_signals(stop: CancellationToken) -> std::io::Result<()> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    tokio::spawn(async move {
        let name = tokio::select! {
            _ = terminate.recv() => "SIGTERM",
            _ = interrupt.recv() => "SIGINT",
        };
        tracing::info!(signal = name, "stopping");
        stop.cancel();
    });
    Ok(())
}
