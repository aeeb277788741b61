//! What SUMO prints, kept within bounds.

use std::collections::VecDeque;
use std::io::Read;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Lines kept, the newest.
const LINES: usize = 100;
/// Bytes kept of a line.
const LINE_BYTES: usize = 2000;

/// The last lines that matter. Two threads fill it, so that SUMO never waits for a reader.
#[derive(Debug, Default)]
pub(crate) struct Output {
    state: Mutex<State>,
    finished: Condvar,
}

#[derive(Debug, Default)]
struct State {
    lines: VecDeque<String>,
    dropped: u64,
    reading: usize,
}

/// Which lines of a stream are kept.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Keep {
    /// Every line that is not blank.
    All,
    /// Only errors: stdout is mostly progress.
    Errors,
}

impl Output {
    /// Reads `stream` to its end on a thread of its own.
    pub(crate) fn read(
        self: &Arc<Self>,
        name: &str,
        stream: impl Read + Send + 'static,
        keep: Keep,
    ) -> std::io::Result<()> {
        self.lock().reading += 1;
        let output = Arc::clone(self);
        let spawned =
            std::thread::Builder::new().name(name.to_owned()).stack_size(128 << 10).spawn(move || {
                output.collect(stream, keep);
                output.end();
            });
        if spawned.is_err() {
            self.end();
        }
        spawned.map(drop)
    }

    /// The lines kept and the number of those dropped, once both streams have ended or `patience` has run out.
    pub(crate) fn last_lines(&self, patience: Duration) -> (Vec<String>, u64) {
        let state = self.lock();
        let (state, _) = self
            .finished
            .wait_timeout_while(state, patience, |state| state.reading > 0)
            .unwrap_or_else(PoisonError::into_inner);
        (state.lines.iter().cloned().collect(), state.dropped)
    }

    fn end(&self) {
        self.lock().reading -= 1;
        self.finished.notify_all();
    }

    // A panic while the lock is held leaves whole lines behind: the state stays good.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn collect(&self, mut stream: impl Read, keep: Keep) {
        let mut chunk = [0; 4096];
        let mut line = Vec::new();
        loop {
            match stream.read(&mut chunk) {
                Ok(0) => break,
                Ok(count) => {
                    for &byte in &chunk[..count] {
                        // Progress is printed over itself with carriage returns.
                        if byte == b'\n' || byte == b'\r' {
                            self.push(&line, keep);
                            line.clear();
                        } else if line.len() < LINE_BYTES {
                            line.push(byte);
                        }
                    }
                }
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        self.push(&line, keep);
    }

    fn push(&self, line: &[u8], keep: Keep) {
        let line = String::from_utf8_lossy(line);
        let line = line.trim_end();
        let wanted = match keep {
            Keep::All => !line.trim().is_empty(),
            Keep::Errors => line.starts_with("Error"),
        };
        if !wanted {
            return;
        }
        let mut state = self.lock();
        if state.lines.len() == LINES {
            state.lines.pop_front();
            state.dropped += 1;
        }
        state.lines.push_back(line.to_owned());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn collected(text: &[u8], keep: Keep) -> (Vec<String>, u64) {
        let output = Output::default();
        output.collect(text, keep);
        output.last_lines(Duration::ZERO)
    }

    #[test]
    fn only_the_newest_lines_are_kept_and_the_others_counted() {
        let text: String = (0..250).map(|i| format!("line {i}\n")).collect();
        let (lines, dropped) = collected(text.as_bytes(), Keep::All);
        assert_eq!((lines.len(), dropped), (LINES, 150));
        assert_eq!(lines.first().map(String::as_str), Some("line 150"));
        assert_eq!(lines.last().map(String::as_str), Some("line 249"));
    }

    #[test]
    fn a_line_without_end_takes_bounded_memory_and_an_unfinished_one_is_kept() {
        let (lines, _) = collected(&vec![b'x'; 1 << 20], Keep::All);
        assert_eq!(lines, [("x".repeat(LINE_BYTES))]);
    }

    #[test]
    fn of_stdout_only_errors_are_kept() {
        let (lines, dropped) = collected(b"Loading\rStep #1.00\rError: no net\nbye\xff\n", Keep::Errors);
        assert_eq!((lines, dropped), (vec!["Error: no net".to_owned()], 0));
    }
}
