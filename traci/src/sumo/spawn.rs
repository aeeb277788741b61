//! Starting a child that cannot outlive this process.
//!
//! On Linux the kernel kills the child when its parent dies (`PR_SET_PDEATHSIG`), whatever the parent dies of. "Parent"
//! means the *thread* that forked: a child forked on a thread that later ends dies with that thread. All children are
//! therefore forked by one thread that lives as long as the process, and callers may come from any thread, a runtime's
//! short-lived ones included.

use std::io;
use std::process::{Child, Command};
use std::sync::mpsc::{Sender, SyncSender, channel, sync_channel};
use std::sync::{Mutex, PoisonError};

struct Job {
    command: Command,
    done: SyncSender<io::Result<Child>>,
}

static FORKER: Mutex<Option<Sender<Job>>> = Mutex::new(None);

/// Starts `command`, tied to this process's life and outside its process group, so that Ctrl-C reaches the owner only
/// and the owner ends SUMO in order. What else works for the owner, such as a client program, may be started so too.
///
/// # Errors
/// What the operating system says: the program is not there, or no process can be started.
pub fn spawn(mut command: Command) -> io::Result<Child> {
    tie(&mut command);
    let (done, outcome) = sync_channel(1);
    {
        let mut forker = FORKER.lock().unwrap_or_else(PoisonError::into_inner);
        let job = Job { command, done };
        let unsent = match forker.as_ref() {
            Some(sender) => sender.send(job).err().map(|error| error.0),
            None => Some(job),
        };
        if let Some(job) = unsent {
            let (sender, jobs) = channel::<Job>();
            std::thread::Builder::new().name("sumo-forker".to_owned()).stack_size(256 << 10).spawn(
                move || {
                    // Ends only when the sender is dropped, which a static never is.
                    for Job { mut command, done } in jobs {
                        // The receiver waits for exactly this answer.
                        let _ = done.send(command.spawn());
                    }
                },
            )?;
            sender.send(job).map_err(|_| io::Error::other("the thread that starts processes has ended"))?;
            *forker = Some(sender);
        }
    }
    outcome.recv().map_err(|_| io::Error::other("the thread that starts processes has ended"))?
}

#[cfg(target_os = "linux")]
fn tie(command: &mut Command) {
    use rustix::process::{Signal, getpid, getppid, set_parent_process_death_signal};
    use std::os::unix::process::CommandExt;

    command.process_group(0);
    let owner = getpid();
    let before_exec = move || {
        set_parent_process_death_signal(Some(Signal::KILL))?;
        // If the owner died between fork and the line above, no signal will come any more.
        if getppid() == Some(owner) { Ok(()) } else { Err(rustix::io::Errno::SRCH.into()) }
    };
    #[expect(unsafe_code, reason = "only code run between fork and exec can set the parent-death signal")]
    // SAFETY: after a fork of a process with threads only async-signal-safe calls are allowed. The closure makes two
    // system calls, prctl and getppid, through rustix, which issues them directly; it takes no lock and allocates
    // nothing: an `io::Error` made from an error number holds just that number, and `owner` is a copied integer.
    unsafe {
        command.pre_exec(before_exec);
    }
}

#[cfg(all(unix, not(target_os = "linux")))]
fn tie(command: &mut Command) {
    use std::os::unix::process::CommandExt;
    command.process_group(0);
}

#[cfg(not(unix))]
fn tie(_: &mut Command) {}
