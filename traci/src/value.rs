//! Typed values that SUMO sends, borrowed from the receive buffer.

use crate::codec::{DecodeError, MAX_DEPTH, Reader};
use crate::constants::types;
use std::fmt;

/// A value that SUMO sent. Nothing is copied: strings and lists point into the receive buffer.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Value<'a> {
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
    StrList(StrList<'a>),
    /// A list of real numbers.
    DoubleList(DoubleList<'a>),
    /// A point in the network's own coordinates, metres. `z` is absent for a flat one.
    Position {
        /// East, metres.
        x: f64,
        /// North, metres.
        y: f64,
        /// Up, metres.
        z: Option<f64>,
    },
    /// A point in longitude and latitude, degrees, and altitude where SUMO knows it, metres.
    Geo {
        /// Degrees east.
        longitude: f64,
        /// Degrees north.
        latitude: f64,
        /// Metres.
        altitude: Option<f64>,
    },
    /// A place on an edge.
    RoadMap {
        /// Edge.
        edge: &'a str,
        /// Metres from the edge's beginning.
        position: f64,
        /// Lane index, 0 is the rightmost.
        lane: u8,
    },
    /// Red, green, blue, alpha.
    Color([u8; 4]),
    /// A line or area in the network's coordinates.
    Polygon(Polygon<'a>),
    /// Several values.
    Compound(Compound<'a>),
    /// In a subscription: SUMO could not find this value, and says why.
    Failed(&'a str),
}

impl<'a> Value<'a> {
    /// The type's name, for messages.
    pub fn type_name(&self) -> &'static str {
        match self {
            Self::Double(_) => "a double",
            Self::Int(_) => "an integer",
            Self::Byte(_) => "a byte",
            Self::UByte(_) => "an unsigned byte",
            Self::Str(_) => "a string",
            Self::StrList(_) => "a list of strings",
            Self::DoubleList(_) => "a list of doubles",
            Self::Position { .. } => "a position",
            Self::Geo { .. } => "a geographic position",
            Self::RoadMap { .. } => "a place on an edge",
            Self::Color(_) => "a colour",
            Self::Polygon(_) => "a polygon",
            Self::Compound(_) => "a compound",
            Self::Failed(_) => "an error",
        }
    }

    fn wrong(&self, expected: &'static str) -> DecodeError {
        match self {
            Self::Failed(message) => DecodeError::Failed((*message).to_owned()),
            other => DecodeError::Type { expected, found: other.type_name() },
        }
    }

    /// The real number.
    ///
    /// # Errors
    /// [`DecodeError::Type`] if it is something else, [`DecodeError::Failed`] if SUMO had no value; so for all the
    /// methods below.
    pub fn double(&self) -> Result<f64, DecodeError> {
        if let Self::Double(value) = self { Ok(*value) } else { Err(self.wrong("a double")) }
    }

    /// The integer; bytes count as integers.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn int(&self) -> Result<i32, DecodeError> {
        match self {
            Self::Int(value) => Ok(*value),
            Self::Byte(value) => Ok((*value).into()),
            Self::UByte(value) => Ok((*value).into()),
            other => Err(other.wrong("an integer")),
        }
    }

    /// The text.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn str(&self) -> Result<&'a str, DecodeError> {
        if let Self::Str(value) = self { Ok(value) } else { Err(self.wrong("a string")) }
    }

    /// The list of texts.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn strings(&self) -> Result<StrList<'a>, DecodeError> {
        if let Self::StrList(value) = self { Ok(*value) } else { Err(self.wrong("a list of strings")) }
    }

    /// The list of numbers.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn doubles(&self) -> Result<DoubleList<'a>, DecodeError> {
        if let Self::DoubleList(value) = self { Ok(*value) } else { Err(self.wrong("a list of doubles")) }
    }

    /// The point's east and north coordinates, metres.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn position(&self) -> Result<(f64, f64), DecodeError> {
        if let Self::Position { x, y, .. } = self { Ok((*x, *y)) } else { Err(self.wrong("a position")) }
    }

    /// The parts of a compound.
    ///
    /// # Errors
    /// As [`double`](Self::double).
    pub fn compound(&self) -> Result<Compound<'a>, DecodeError> {
        if let Self::Compound(value) = self { Ok(*value) } else { Err(self.wrong("a compound")) }
    }
}

macro_rules! list {
    ($(#[$doc:meta])* $name:ident, $item:ty, $iter:ident, $read:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq)]
        pub struct $name<'a> {
            count: usize,
            bytes: &'a [u8],
        }

        impl<'a> $name<'a> {
            /// Number of items.
            pub fn len(&self) -> usize {
                self.count
            }

            /// Whether there is no item.
            pub fn is_empty(&self) -> bool {
                self.count == 0
            }

            /// The items, in SUMO's order.
            pub fn iter(&self) -> $iter<'a> {
                $iter { left: self.count, reader: Reader::new(self.bytes) }
            }

            /// Checks every item now, so that iterating needs no errors.
            fn read(reader: &mut Reader<'a>, count: usize) -> Result<Self, DecodeError> {
                let all = reader.rest();
                for _ in 0..count {
                    let _: $item = $read(reader)?;
                }
                Ok(Self { count, bytes: &all[..all.len() - reader.rest().len()] })
            }
        }

        impl fmt::Debug for $name<'_> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.debug_list().entries(self.iter()).finish()
            }
        }

        impl<'a> IntoIterator for $name<'a> {
            type Item = $item;
            type IntoIter = $iter<'a>;
            fn into_iter(self) -> $iter<'a> {
                self.iter()
            }
        }

        /// Iterator over the items of the list of the same name.
        #[derive(Debug, Clone)]
        pub struct $iter<'a> {
            left: usize,
            reader: Reader<'a>,
        }

        impl<'a> Iterator for $iter<'a> {
            type Item = $item;
            fn next(&mut self) -> Option<$item> {
                self.left = self.left.checked_sub(1)?;
                // The list was checked when it was read; `ok` can only end a list that nobody can construct.
                $read(&mut self.reader).ok()
            }
            fn size_hint(&self) -> (usize, Option<usize>) {
                (self.left, Some(self.left))
            }
        }

        impl ExactSizeIterator for $iter<'_> {}
    };
}

fn read_pair(reader: &mut Reader<'_>) -> Result<(f64, f64), DecodeError> {
    Ok((reader.f64()?, reader.f64()?))
}

list!(
    /// Texts in the receive buffer.
    StrList, &'a str, StrIter, Reader::str
);
list!(
    /// Numbers in the receive buffer.
    DoubleList, f64, DoubleIter, Reader::f64
);
list!(
    /// Points (x, y) in the receive buffer, metres.
    Polygon, (f64, f64), PointIter, read_pair
);

/// Values in the receive buffer that belong together.
#[derive(Clone, Copy, PartialEq)]
pub struct Compound<'a> {
    bytes: &'a [u8],
}

impl<'a> Compound<'a> {
    /// The parts, in SUMO's order.
    pub fn iter(&self) -> CompoundIter<'a> {
        CompoundIter { reader: Reader::new(self.bytes) }
    }
}

impl fmt::Debug for Compound<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<'a> IntoIterator for Compound<'a> {
    type Item = Value<'a>;
    type IntoIter = CompoundIter<'a>;
    fn into_iter(self) -> CompoundIter<'a> {
        self.iter()
    }
}

/// Iterator over a [`Compound`].
#[derive(Debug, Clone)]
pub struct CompoundIter<'a> {
    reader: Reader<'a>,
}

impl<'a> Iterator for CompoundIter<'a> {
    type Item = Value<'a>;
    fn next(&mut self) -> Option<Value<'a>> {
        if self.reader.is_empty() { None } else { read_value(&mut self.reader).ok() }
    }
}

/// Reads a type id and the value behind it, and checks all of it.
///
/// # Errors
/// [`DecodeError`] for an unknown type, a wrong length or text that is not UTF-8.
pub fn read_value<'a>(reader: &mut Reader<'a>) -> Result<Value<'a>, DecodeError> {
    read_typed(reader, 0)
}

fn read_typed<'a>(reader: &mut Reader<'a>, depth: usize) -> Result<Value<'a>, DecodeError> {
    Ok(match reader.u8()? {
        types::DOUBLE => Value::Double(reader.f64()?),
        types::INTEGER => Value::Int(reader.i32()?),
        types::STRING => Value::Str(reader.str()?),
        types::BYTE => Value::Byte(reader.i8()?),
        types::UBYTE => Value::UByte(reader.u8()?),
        types::STRING_LIST => {
            let count = reader.count(4)?;
            Value::StrList(StrList::read(reader, count)?)
        }
        types::DOUBLE_LIST => {
            let count = reader.count(8)?;
            Value::DoubleList(DoubleList::read(reader, count)?)
        }
        types::POSITION_2D => Value::Position { x: reader.f64()?, y: reader.f64()?, z: None },
        types::POSITION_3D => Value::Position { x: reader.f64()?, y: reader.f64()?, z: Some(reader.f64()?) },
        types::POSITION_GEO => {
            Value::Geo { longitude: reader.f64()?, latitude: reader.f64()?, altitude: None }
        }
        types::POSITION_GEO_ALTITUDE => {
            Value::Geo { longitude: reader.f64()?, latitude: reader.f64()?, altitude: Some(reader.f64()?) }
        }
        types::POSITION_ROADMAP => {
            Value::RoadMap { edge: reader.str()?, position: reader.f64()?, lane: reader.u8()? }
        }
        types::COLOR => Value::Color([reader.u8()?, reader.u8()?, reader.u8()?, reader.u8()?]),
        types::POLYGON => {
            // One byte of length; zero announces four more, as in a command. An empty polygon, though, is a zero with
            // nothing behind it, which only the end of the bytes tells.
            let count = match reader.u8()? {
                0 if reader.is_empty() => 0,
                0 => reader.count(16)?,
                short => short.into(),
            };
            Value::Polygon(Polygon::read(reader, count)?)
        }
        types::COMPOUND => {
            if depth >= MAX_DEPTH {
                return Err(DecodeError::Depth);
            }
            let count = reader.count(2)?;
            let all = reader.rest();
            for _ in 0..count {
                read_typed(reader, depth + 1)?;
            }
            Value::Compound(Compound { bytes: &all[..all.len() - reader.rest().len()] })
        }
        unknown => return Err(DecodeError::UnknownType(unknown)),
    })
}

/// Reads the value of a response block, which ends with the block.
///
/// SUMO's counts in front of compounds are not the number of parts for every variable, so here the block's end counts.
///
/// # Errors
/// As [`read_value`], and [`DecodeError::Trailing`].
pub fn read_last_value<'a>(mut reader: Reader<'a>) -> Result<Value<'a>, DecodeError> {
    if reader.rest().first() == Some(&types::COMPOUND) {
        reader.take(5)?;
        let bytes = reader.rest();
        while !reader.is_empty() {
            read_typed(&mut reader, 1)?;
        }
        return Ok(Value::Compound(Compound { bytes }));
    }
    let value = read_value(&mut reader)?;
    reader.end()?;
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::argument::Argument;
    use crate::codec::Writer;
    use proptest::prelude::*;

    fn written(argument: Argument<'_>) -> Vec<u8> {
        let mut bytes = Vec::new();
        argument.write(&mut Writer::new(&mut bytes));
        bytes
    }

    fn value(bytes: &[u8]) -> Result<Value<'_>, DecodeError> {
        let mut reader = Reader::new(bytes);
        let value = read_value(&mut reader)?;
        reader.end()?;
        Ok(value)
    }

    #[test]
    fn a_value_of_another_type_says_what_it_is() {
        let bytes = written(Argument::Str("x"));
        let error = value(&bytes).unwrap().double().unwrap_err();
        assert_eq!(error.to_string(), "expected a double, found a string");
    }

    #[test]
    fn an_empty_polygon_is_a_zero_and_nothing_more() {
        let empty = value(&[types::POLYGON, 0]).unwrap();
        assert!(matches!(empty, Value::Polygon(points) if points.is_empty()));
    }

    #[test]
    fn compounds_nested_too_deep_are_refused_rather_than_followed() {
        let mut bytes = Vec::new();
        for _ in 0..100_000 {
            Writer::new(&mut bytes).u8(types::COMPOUND).i32(1);
        }
        assert_eq!(value(&[&bytes[..], &[types::UBYTE, 0]].concat()), Err(DecodeError::Depth));
    }

    #[test]
    fn lists_with_lying_counts_are_refused_before_they_are_believed() {
        for id in [types::STRING_LIST, types::DOUBLE_LIST, types::COMPOUND] {
            let bytes = [&[id][..], &i32::MAX.to_be_bytes(), &[0; 40]].concat();
            assert!(matches!(value(&bytes), Err(DecodeError::Length { .. })), "type 0x{id:02x}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(
            real in any::<f64>().prop_filter("NaN differs from itself", |x| !x.is_nan()), int in any::<i32>(), text in ".{0,40}",
            texts in proptest::collection::vec(".{0,10}", 0..6), reals in proptest::collection::vec(-1e9f64..1e9, 0..6), color in any::<[u8; 4]>(),
        ) {
            let borrowed: Vec<&str> = texts.iter().map(String::as_str).collect();
            let parts = [
                Argument::Double(real), Argument::Int(int), Argument::Byte(-3), Argument::UByte(200), Argument::Str(&text),
                Argument::StrList(&borrowed), Argument::DoubleList(&reals), Argument::Position { x: real, y: 1.5 }, Argument::Color(color),
            ];
            let bytes = written(Argument::Compound(&[Argument::Compound(&parts), Argument::Int(1)]));
            let whole = value(&bytes).unwrap().compound().unwrap();
            let inner = whole.iter().next().unwrap().compound().unwrap();
            let read: Vec<Value<'_>> = inner.iter().collect();
            prop_assert_eq!(whole.iter().count(), 2);
            prop_assert_eq!(read.len(), parts.len());
            prop_assert_eq!(read[0].double().unwrap(), real);
            prop_assert_eq!(read[1].int().unwrap(), int);
            prop_assert_eq!((read[2].int().unwrap(), read[3].int().unwrap()), (-3, 200));
            prop_assert_eq!(read[4].str().unwrap(), &text);
            prop_assert_eq!(read[5].strings().unwrap().iter().collect::<Vec<_>>(), borrowed);
            prop_assert_eq!(read[6].doubles().unwrap().iter().collect::<Vec<_>>(), reals);
            prop_assert_eq!(read[7].position().unwrap(), (real, 1.5));
            prop_assert_eq!(&read[8], &Value::Color(color));
            for cut in 0..bytes.len() {
                prop_assert!(value(&bytes[..cut]).is_err());
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(id in 0u8..0x14, bytes in proptest::collection::vec(any::<u8>(), 0..120)) {
            let bytes = [&[id][..], &bytes].concat();
            if let Ok(value) = read_value(&mut Reader::new(&bytes)) {
                let _ = format!("{value:?}");
            }
            let _ = read_last_value(Reader::new(&bytes));
        }
    }
}
