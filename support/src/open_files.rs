//! How many files and sockets this process may have open.
//!
//! Shells and containers commonly give a process 1024 and let it ask for more; a learner's connections would not fit.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// What a process needs besides its connections: log, checkpoints, libraries, the admin port.
const RESERVED: u64 = 128;

/// Raises the limit as far as an ordinary user may, and returns it; `None` means that there is none. Where the system does
/// not allow even that, the limit stays.
pub fn raise() -> Option<u64> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum && setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).is_err() {
        return current;
    }
    most()
}

/// As many as this process may open now; `None` means any number.
#[must_use]
pub fn most() -> Option<u64> {
    getrlimit(Resource::Nofile).current
}

/// As many as this process may allow itself with [`raise`]; `None` means any number.
#[must_use]
pub fn attainable() -> Option<u64> {
    getrlimit(Resource::Nofile).maximum
}

/// How many of the wanted connections fit under a limit on open files; never none.
#[must_use]
pub fn connections(wanted: usize, limit: Option<u64>) -> usize {
    let Some(limit) = limit else { return wanted };
    let room = usize::try_from(limit.saturating_sub(RESERVED)).unwrap_or(usize::MAX);
    wanted.min(room.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_leave_room_for_files() {
        assert_eq!(connections(4096, None), 4096);
        assert_eq!(connections(4096, Some(1 << 20)), 4096);
        assert_eq!(connections(4096, Some(1024)), 896);
        assert_eq!(connections(4, Some(1024)), 4);
        assert_eq!(connections(4096, Some(100)), 1);
    }

    #[test]
    fn the_limit_is_raised_to_what_is_attainable() {
        assert_eq!(raise(), attainable());
        assert_eq!(most(), attainable());
    }
}
