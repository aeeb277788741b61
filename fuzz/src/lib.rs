//! Fuzzing of everything that CROSS reads from others: SUMO, the network, files of users.
//!
//! ```text
//!   corpus/TARGET/* ──> mutate ──> targets ── run under ──> limits     no panic, no hang, no memory beyond the input's due
//!                          ^                                   │
//!                          └── libFuzzer keeps what is new ────┘       `make fuzz`; without it, a short run in `make test`
//! ```
//! A [`Target`] is a plain function over bytes. It panics where a promise is broken; memory and time are watched from outside,
//! by [`check`]. `docs/fuzzing.md` tells how to run it and what came out.

pub mod corpus;
pub mod limits;
pub mod mutate;
pub mod parts;
mod targets;

pub use targets::{TARGETS, Target};

/// What became of an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It was read.
    Accepted,
    /// It was refused, in a sentence.
    Refused,
}

impl Outcome {
    fn of<T, E>(result: &Result<T, E>) -> Self {
        if result.is_ok() { Self::Accepted } else { Self::Refused }
    }
}

/// The target of that name.
#[must_use]
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}

/// Runs a target on an input and holds it to its limit.
///
/// # Panics
/// If the reader panics, breaks a promise, or takes more memory or time than the input may. A first input of a target also
/// pays for what is made once; give it one before measuring.
pub fn check(target: &Target, input: &[u8]) -> Outcome {
    let (outcome, usage) = limits::measured(|| (target.run)(input));
    let broken = target.limit.broken(input.len(), usage);
    assert!(broken.is_none(), "{} {}", target.name, broken.unwrap_or_default());
    outcome
}
