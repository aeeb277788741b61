//! What a command can end with: a sentence for the person and an exit code for the script.

use std::fmt;

/// Exit code for wrong usage or bad input: repeating the command cannot help.
pub(crate) const BAD_INPUT: u8 = 2;
/// Exit code for everything else that went wrong.
pub(crate) const FAILED: u8 = 1;

/// Result of a command.
pub(crate) type Outcome<T> = Result<T, Failure>;

/// An error on its way to the terminal.
#[derive(Debug)]
pub(crate) struct Failure {
    error: anyhow::Error,
    code: u8,
}

impl Failure {
    /// Something the person must change before trying again.
    pub(crate) fn input(message: impl Into<String>) -> Self {
        Self { error: anyhow::Error::msg(message.into()), code: BAD_INPUT }
    }

    /// Something that went wrong on the way.
    pub(crate) fn failed(message: impl Into<String>) -> Self {
        Self { error: anyhow::Error::msg(message.into()), code: FAILED }
    }

    /// Any error as bad input.
    pub(crate) fn bad_input(error: impl Into<anyhow::Error>) -> Self {
        Self { error: error.into(), code: BAD_INPUT }
    }

    /// The process's exit code.
    pub(crate) fn code(&self) -> u8 {
        self.code
    }
}

/// Anything not marked as bad input counts as failed.
impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { error: error.into(), code: FAILED }
    }
}

impl fmt::Display for Failure {
    /// The whole chain of causes on one line; a cause that an outer message already quotes is not said again.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut said = String::new();
        for cause in self.error.chain() {
            let text = one_line(&cause.to_string());
            if said.contains(&text) {
                continue;
            }
            if !said.is_empty() {
                said.push_str(": ");
            }
            said.push_str(&text);
        }
        f.write_str(&said)
    }
}

/// Marks an error as bad input at the place where that is known.
pub(crate) trait OrBadInput<T> {
    /// The error as [`Failure::bad_input`].
    fn or_bad_input(self) -> Outcome<T>;
}

impl<T, E: Into<anyhow::Error>> OrBadInput<T> for Result<T, E> {
    fn or_bad_input(self) -> Outcome<T> {
        self.map_err(Failure::bad_input)
    }
}

/// Folds line breaks and runs of blanks, so that a message stays one sentence whatever a parser made of it.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn a_cause_that_is_already_quoted_is_said_once() {
        let inner = std::io::Error::other("disk full");
        let failure = Failure::from(anyhow::Error::new(inner).context("cannot write x: disk full"));
        assert_eq!(failure.to_string(), "cannot write x: disk full");
        assert_eq!(failure.code(), FAILED);
    }

    #[test]
    fn causes_follow_in_order_on_one_line() {
        let result: Result<(), _> = Err(std::io::Error::other("a\n  b"));
        let failure = Failure::bad_input(result.context("outer").unwrap_err());
        assert_eq!(failure.to_string(), "outer: a b");
        assert_eq!(failure.code(), BAD_INPUT);
    }
}
