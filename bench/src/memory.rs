//! Memory of this process and of others, as the kernel counts it.

use crate::error::BenchError;
use std::io::{Error, ErrorKind};
use std::path::Path;

const STATUS: &str = "/proc/self/status";
const CLEAR: &str = "/proc/self/clear_refs";
/// What resets the peak (proc(5), `clear_refs`).
const RESET_PEAK: &str = "5";
/// The lines of `status` that tell what is resident: now, and at most.
const NOW: &str = "VmRSS:";
const PEAK: &str = "VmHWM:";

/// Largest resident memory since the process's start or the last [`reset_peak`], bytes.
///
/// # Errors
/// [`BenchError::Memory`] where the kernel does not tell.
pub fn peak() -> Result<u64, BenchError> {
    read(Path::new(STATUS), PEAK)
}

/// The same of another process since its start.
pub(crate) fn peak_of(pid: u32) -> Result<u64, BenchError> {
    read(Path::new(&format!("/proc/{pid}/status")), PEAK)
}

/// Resident memory of another process, bytes. Sockets' buffers are the kernel's and not in it.
pub(crate) fn resident_of(pid: u32) -> Result<u64, BenchError> {
    read(Path::new(&format!("/proc/{pid}/status")), NOW)
}

fn read(path: &Path, line: &str) -> Result<u64, BenchError> {
    let wrong = |source| BenchError::Memory { path: path.to_owned(), source };
    let text = std::fs::read_to_string(path).map_err(wrong)?;
    let missing = || Error::new(ErrorKind::InvalidData, format!("it has no line {line} in kB"));
    parse(&text, line).ok_or_else(|| wrong(missing()))
}

/// Forgets the peak so far: it is then what is resident now. Where the kernel does not allow it, the old peak stays, which
/// is never too low.
pub fn reset_peak() {
    let _ = std::fs::write(CLEAR, RESET_PEAK);
}

fn parse(status: &str, name: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_kernels_line() {
        let status = "VmPeak:\t 9 kB\nVmHWM:\t    1234 kB\nVmRSS:\t 5 kB\n";
        assert_eq!((parse(status, PEAK), parse(status, NOW)), (Some(1234 * 1024), Some(5 * 1024)));
        assert_eq!(parse("VmRSS:\t 5 kB\n", PEAK), None);
    }

    #[test]
    fn a_large_allocation_shows_in_the_peak_after_it_is_gone() {
        let before = peak().unwrap();
        let block = vec![1u8; 64 << 20];
        assert!(std::hint::black_box(&block).iter().all(|&byte| byte == 1));
        drop(block);
        assert!(peak().unwrap() >= before.max(64 << 20));
        let own = std::process::id();
        assert!(resident_of(own).unwrap() <= peak_of(own).unwrap());
    }
}
