//! `cross-actor`: the process around [`cross_actor::run`].

use clap::Parser;
use cross_actor::{Ending, Options, process};
use std::io::Write;
use std::process::ExitCode;
use tokio_util::sync::CancellationToken;

fn main() -> ExitCode {
    // Wrong usage ends here, with clap's words and exit code 2.
    let options = Options::parse();
    if let Err(problem) = process::log_to_stderr(options.log_format, &options.log) {
        return fail(2, format_args!("the option --log is not a filter: {problem}"));
    }
    // Two threads for I/O that is little; the work is done by the simulator thread.
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = match runtime {
        Ok(runtime) => runtime,
        Err(error) => return fail(1, format_args!("cannot start the I/O threads: {error}")),
    };
    let ended = runtime.block_on(async {
        let stop = CancellationToken::new();
        if let Err(error) = process::stop_on_signals(stop.clone()) {
            return fail(1, format_args!("cannot listen to signals: {error}"));
        }
        match cross_actor::run(options, stop).await {
            Ok(Ending::Complete) => {
                tracing::info!("training is complete");
                ExitCode::SUCCESS
            }
            Ok(Ending::Stopped) => {
                tracing::info!("stopped");
                ExitCode::SUCCESS
            }
            Err(error) => fail(error.exit_code(), format_args!("{error}")),
        }
    });
    // A simulator that is stuck in a call must not hold up the end; the kernel ends its SUMO with this process.
    runtime.shutdown_background();
    ended
}

/// The last line of stderr is the error, plain in either log format, for people and for whoever supervises this process.
fn fail(code: u8, message: std::fmt::Arguments<'_>) -> ExitCode {
    // A full disk must change neither the exit code nor how the process ends.
    let _ = writeln!(std::io::stderr(), "cross-actor: {message}");
    ExitCode::from(code)
}
