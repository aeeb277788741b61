//! What a reader may use for an input: memory by its length, and a moment of time.
//!
//! Memory is what the thread's allocator has handed out and not got back, at its highest while the reader runs. So an
//! announced length that is believed is found even if nothing is ever written there.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Duration;

thread_local! {
    /// Bytes handed out less bytes got back, by this thread.
    static LIVE: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

/// An allocator that counts for each thread by itself. A program that measures makes it its `#[global_allocator]`.
#[derive(Debug)]
pub struct Counting;

fn count(change: isize) {
    let live = LIVE.get().wrapping_add(change);
    LIVE.set(live);
    if live > PEAK.get() {
        PEAK.set(live);
    }
}

#[expect(unsafe_code, reason = "an allocator can only be written so")]
// SAFETY: every call is passed on unchanged to the system's allocator, which keeps the trait's contract. The counters are
// thread-local integers without destructors, so that using them neither allocates nor fails at a thread's end.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size().cast_signed());
        // SAFETY: the caller keeps the contract of `alloc`, which is the same here.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size().cast_signed());
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Where it has to move, both are there for a moment.
        count(size.cast_signed());
        count(-layout.size().cast_signed());
        // SAFETY: the pointer comes from this allocator, that is from `System`; the rest as above.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-layout.size().cast_signed());
        // SAFETY: the pointer comes from this allocator, that is from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Most that an input may cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limit {
    /// Bytes of memory, whatever the input.
    pub base: usize,
    /// Bytes of memory for each byte of input.
    pub factor: usize,
    /// Time of the processor.
    pub time: Duration,
}

/// What an input did cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Usage {
    /// Highest number of bytes in use beyond those before.
    pub memory: usize,
    /// Time that the thread ran; a machine that does something else does not count.
    pub time: Duration,
}

impl Limit {
    /// Bytes that an input of this length may take.
    #[must_use]
    pub fn memory(&self, length: usize) -> usize {
        self.factor.saturating_mul(length).saturating_add(self.base)
    }

    /// What of `usage` is beyond the limit, in words.
    #[must_use]
    pub fn broken(&self, length: usize, usage: Usage) -> Option<String> {
        let most = self.memory(length);
        if usage.memory > most {
            return Some(format!(
                "took {} bytes of memory for an input of {length}, where {most} are allowed",
                usage.memory
            ));
        }
        (usage.time > self.time).then(|| {
            format!("took {:?} for an input of {length} bytes, where {:?} are allowed", usage.time, self.time)
        })
    }
}

/// Runs `work` and measures it. Memory is counted only in a program whose allocator is [`Counting`].
pub fn measured<T>(work: impl FnOnce() -> T) -> (T, Usage) {
    let before = LIVE.get();
    PEAK.set(before);
    let begun = thread_time();
    let value = work();
    let time = thread_time().saturating_sub(begun);
    (value, Usage { memory: PEAK.get().wrapping_sub(before).max(0).cast_unsigned(), time })
}

fn thread_time() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    // The clock of a thread starts at zero and counts up.
    Duration::new(now.tv_sec.cast_unsigned(), u32::try_from(now.tv_nsec).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[global_allocator]
    static COUNTING: Counting = Counting;

    const LIMIT: Limit = Limit { base: 1000, factor: 10, time: Duration::from_millis(200) };

    #[test]
    fn memory_that_was_given_back_counts_at_its_highest() {
        let (length, usage) = measured(|| {
            drop(std::hint::black_box(vec![0u8; 1 << 20]));
            std::hint::black_box(vec![0u8; 1 << 10]).len()
        });
        assert_eq!((length, usage.memory), (1 << 10, 1 << 20));
        let (_, usage) = measured(|| {
            let mut growing = std::hint::black_box(Vec::with_capacity(100));
            growing.resize(1000, 0u8);
            growing
        });
        assert_eq!(usage.memory, 1100, "while it moves, old and new are there");
        assert_eq!(measured(|| ()).1.memory, 0);
    }

    #[test]
    fn too_much_is_told_and_enough_is_not() {
        let usage = |memory, milliseconds| Usage { memory, time: Duration::from_millis(milliseconds) };
        assert_eq!(LIMIT.broken(5, usage(1050, 200)), None);
        assert!(LIMIT.broken(5, usage(1051, 0)).unwrap().contains("took 1051 bytes"));
        assert!(LIMIT.broken(5, usage(0, 201)).unwrap().contains("200ms are allowed"));
        assert_eq!(LIMIT.memory(usize::MAX), usize::MAX);
    }

    #[test]
    fn time_is_the_threads_own() {
        let busy = || {
            let begun = thread_time();
            while thread_time() - begun < Duration::from_millis(3) {}
        };
        assert!(measured(busy).1.time >= Duration::from_millis(3));
    }
}
