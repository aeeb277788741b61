//! Names that actors give themselves.

use crate::Violation;
use std::fmt;
use std::str::FromStr;

/// Most characters of an actor id.
pub const MAX_ACTOR_ID: usize = 128;

/// An actor's id: 1 to 128 characters of `[A-Za-z0-9._-]`.
///
/// The rule keeps ids safe in log lines, file names and metadata without any escaping.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ActorId(String);

impl ActorId {
    /// Checks an id received in `field`.
    ///
    /// # Errors
    /// [`Violation`] of `field` if the id is empty, too long or has another character.
    pub fn parse(id: &str, field: &str) -> Result<Self, Violation> {
        if id.is_empty() {
            return Err(Violation::new(field, "is empty; an actor id has 1 to 128 characters"));
        }
        if id.len() > MAX_ACTOR_ID {
            return Err(Violation::new(
                field,
                format!("is {} bytes long; an actor id has at most {MAX_ACTOR_ID}", id.len()),
            ));
        }
        match id.chars().find(|c| !(c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-'))) {
            Some(c) => Err(Violation::new(
                field,
                format!("holds {c:?}; an actor id consists of letters, digits, '.', '_' and '-'"),
            )),
            None => Ok(Self(id.to_owned())),
        }
    }

    /// The id.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for ActorId {
    type Err = Violation;

    fn from_str(id: &str) -> Result<Self, Violation> {
        Self::parse(id, "actor_id")
    }
}

impl AsRef<str> for ActorId {
    fn as_ref(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for ActorId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<ActorId> for String {
    fn from(id: ActorId) -> Self {
        id.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ordinary_ids_pass_unchanged() {
        for id in ["a", "actor-0", "host.example_7-B", &"x".repeat(MAX_ACTOR_ID)] {
            let parsed: ActorId = id.parse().unwrap();
            assert_eq!(parsed.as_str(), id);
            assert_eq!(parsed.to_string(), id);
            assert_eq!(String::from(parsed), id);
        }
    }

    #[test]
    fn bad_ids_are_refused_with_the_field_and_the_character() {
        for id in ["", &"x".repeat(MAX_ACTOR_ID + 1), "a b", "a/b", "ä", "a\n", "a\0"] {
            let violation = ActorId::parse(id, "hello.actor_id").unwrap_err();
            assert_eq!(violation.field, "hello.actor_id", "{id:?}");
        }
        assert!(ActorId::parse("a/b", "id").unwrap_err().to_string().contains("'/'"));
    }
}
