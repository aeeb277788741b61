//! Standard output: the result and nothing else.

use crate::failure::Outcome;
use anyhow::Context;
use serde::Serialize;
use std::io::Write;

/// Writes text, with a line break at its end.
pub(crate) fn text(text: &str) -> Outcome<()> {
    write(text)
}

/// Writes the one JSON document of a command called with `--json`.
pub(crate) fn json(document: &impl Serialize) -> Outcome<()> {
    write(&serde_json::to_string_pretty(document).context("cannot write the result as JSON")?)
}

fn write(text: &str) -> Outcome<()> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{}", text.trim_end()).and_then(|()| out.flush()) {
        // Whoever reads has seen enough, as `head` does.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        result => Ok(result.context("cannot write to standard output")?),
    }
}
