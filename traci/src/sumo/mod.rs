//! The SUMO process: finding it, starting it on a port of its own, watching it, and never leaving it behind.
//!
//! ```text
//!   locate     where is SUMO?            option, SUMO_HOME, make build, PATH
//!   port       a free port, held while SUMO starts
//!   environment  without the owner's secrets
//!   spawn      fork, on a thread that never ends; the kernel kills the child when this process dies
//!   listening  does that very child listen on that port?
//!   launch     all of it, again on another port if that one was taken
//!   start      then the handshake        server     or somebody else's client
//!   process    wait, kill, reap          output   the last lines it printed
//! ```
//!
//! # No orphans
//! Three things hold together. A [`Sumo`] that is dropped, in a panic too, kills and reaps its process. If the owner
//! dies without dropping anything, the kernel kills SUMO (`PR_SET_PDEATHSIG`). If the owner dies between the fork and
//! that request, the child notices that it has another parent and ends itself before it becomes SUMO.
//!
//! The kernel's promise hangs on the thread that forked, not on the process: were SUMO forked on a runtime's worker that
//! retires after some idle seconds, SUMO would die with it. So one thread forks for the whole process and lives as
//! long; a [`Sumo`] may be started on any thread and used on another.
//!
//! Elsewhere than on Linux there is no such promise, and a `SIGKILL` of the owner leaves SUMO until it notices that its
//! connection is gone, at the end of the current command.

mod environment;
mod launch;
mod listening;
mod locate;
mod output;
mod port;
mod process;
mod server;
mod spawn;
mod start;

pub use locate::{LocateError, Origin, SumoHome};
pub(crate) use process::Process;
pub use server::SumoServer;
pub use spawn::spawn as spawn_tied;
pub use start::{ExitReport, Sumo, SumoCommand};
