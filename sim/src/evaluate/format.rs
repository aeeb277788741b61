//! The number that tells the documents of different versions apart.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Raised when a member of a report changes its meaning or goes; a new member does not raise it.
const NUMBER: u32 = 1;

/// The format of a report: written as its number, and refused when it is another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Format;

impl Serialize for Format {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u32(NUMBER)
    }
}

impl<'de> Deserialize<'de> for Format {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match u64::deserialize(deserializer)? {
            number if number == u64::from(NUMBER) => Ok(Self),
            number => Err(D::Error::custom(format!(
                "it is an evaluation in format {number}, of which this version of CROSS reads {NUMBER} alone; use the \
                 version that wrote it, or evaluate again"
            ))),
        }
    }
}
