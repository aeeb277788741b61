//! Waiting for things to happen.

use std::time::{Duration, Instant};

/// After this long something is broken, even on a busy machine.
pub const DEADLINE: Duration = Duration::from_secs(240);

const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Looks until there is something to return.
///
/// # Panics
/// When nothing has come by [`DEADLINE`]; `what` says what was waited for.
pub fn until<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + DEADLINE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < end, "waited {} s for this in vain: {what}", DEADLINE.as_secs());
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Looks until it is true, for so many seconds at most; what the last look saw.
///
/// # Errors
/// The first error of a look.
pub fn for_seconds<E>(seconds: u64, mut look: impl FnMut() -> Result<bool, E>) -> Result<bool, E> {
    let end = Instant::now() + Duration::from_secs(seconds);
    loop {
        let seen = look()?;
        if seen || Instant::now() >= end {
            return Ok(seen);
        }
        std::thread::sleep(LOOK_EVERY);
    }
}
