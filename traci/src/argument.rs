//! Typed values that are sent to SUMO.

use crate::codec::Writer;
use crate::constants::types;

/// A value to send.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Argument<'a> {
    /// A real number.
    Double(f64),
    /// An integer.
    Int(i32),
    /// A signed byte.
    Byte(i8),
    /// An unsigned byte.
    UByte(u8),
    /// Text.
    Str(&'a str),
    /// A list of texts.
    StrList(&'a [&'a str]),
    /// A list of real numbers.
    DoubleList(&'a [f64]),
    /// A point, metres.
    Position {
        /// East, metres.
        x: f64,
        /// North, metres.
        y: f64,
    },
    /// Red, green, blue, alpha.
    Color([u8; 4]),
    /// Several values.
    Compound(&'a [Argument<'a>]),
}

impl Argument<'_> {
    /// Appends type id and value.
    pub fn write(&self, writer: &mut Writer<'_>) {
        match self {
            Self::Double(value) => writer.u8(types::DOUBLE).f64(*value),
            Self::Int(value) => writer.u8(types::INTEGER).i32(*value),
            Self::Byte(value) => writer.u8(types::BYTE).i8(*value),
            Self::UByte(value) => writer.u8(types::UBYTE).u8(*value),
            Self::Str(value) => writer.u8(types::STRING).str(value),
            Self::StrList(values) => {
                values.iter().fold(writer.u8(types::STRING_LIST).count(values.len()), |w, value| w.str(value))
            }
            Self::DoubleList(values) => values
                .iter()
                .fold(writer.u8(types::DOUBLE_LIST).count(values.len()), |w, value| w.f64(*value)),
            Self::Position { x, y } => writer.u8(types::POSITION_2D).f64(*x).f64(*y),
            Self::Color(channels) => {
                channels.iter().fold(writer.u8(types::COLOR), |w, channel| w.u8(*channel))
            }
            Self::Compound(parts) => {
                let writer = writer.u8(types::COMPOUND).count(parts.len());
                for part in *parts {
                    part.write(writer);
                }
                writer
            }
        };
    }
}
