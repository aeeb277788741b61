//! The memory of another process while something happens, looked at every few milliseconds.
//!
//! Its peak since the start, which the kernel keeps, would hold an update's memory too.

use crate::error::BenchError;
use crate::memory;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

const EVERY: Duration = Duration::from_millis(5);

/// A thread that looks until it is dropped.
#[derive(Debug)]
pub(crate) struct Sampler {
    most: Arc<AtomicU64>,
    done: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Sampler {
    pub(crate) fn start(pid: u32) -> Result<Self, BenchError> {
        let most = Arc::new(AtomicU64::new(memory::resident_of(pid)?));
        let done = Arc::new(AtomicBool::new(false));
        let (theirs, ended) = (Arc::clone(&most), Arc::clone(&done));
        let look = move || {
            while !ended.load(Ordering::Relaxed) {
                // Of a process that has ended whoever waits for it hears elsewhere.
                let now = memory::resident_of(pid).unwrap_or(0);
                theirs.fetch_max(now, Ordering::Relaxed);
                std::thread::sleep(EVERY);
            }
        };
        let thread = std::thread::Builder::new().name("sampler".to_owned()).spawn(look);
        let thread = thread.map_err(|source| BenchError::Runtime { source })?;
        Ok(Self { most, done, thread: Some(thread) })
    }

    /// The most so far, bytes.
    pub(crate) fn most(&self) -> u64 {
        self.most.load(Ordering::Relaxed)
    }
}

impl Drop for Sampler {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It does nothing that can panic.
            let _ = thread.join();
        }
    }
}
