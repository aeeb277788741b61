//! Peak memory of this process, as the kernel counts it.

use crate::error::BenchError;
use std::io::{Error, ErrorKind};
use std::path::Path;

const STATUS: &str = "/proc/self/status";
const CLEAR: &str = "/proc/self/clear_refs";
/// What resets the peak (proc(5), `clear_refs`).
const RESET_PEAK: &str = "5";

/// Largest resident memory since the process's start or the last [`reset_peak`], bytes.
///
/// # Errors
/// [`BenchError::Memory`] where the kernel does not tell.
pub fn peak() -> Result<u64, BenchError> {
    let wrong = |source| BenchError::Memory { path: Path::new(STATUS).to_owned(), source };
    let text = std::fs::read_to_string(STATUS).map_err(wrong)?;
    parse(&text).ok_or_else(|| wrong(Error::new(ErrorKind::InvalidData, "it has no line VmHWM in kB")))
}

/// Forgets the peak so far: it is then what is resident now. Where the kernel does not allow it, the old peak stays, which
/// is never too low.
pub fn reset_peak() {
    let _ = std::fs::write(CLEAR, RESET_PEAK);
}

fn parse(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_kernels_line() {
        assert_eq!(parse("VmPeak:\t 9 kB\nVmHWM:\t    1234 kB\nVmRSS:\t 5 kB\n"), Some(1234 * 1024));
        assert_eq!(parse("VmRSS:\t 5 kB\n"), None);
    }

    #[test]
    fn a_large_allocation_shows_in_the_peak_after_it_is_gone() {
        let before = peak().unwrap();
        let block = vec![1u8; 64 << 20];
        assert!(std::hint::black_box(&block).iter().all(|&byte| byte == 1));
        drop(block);
        assert!(peak().unwrap() >= before.max(64 << 20));
    }
}
