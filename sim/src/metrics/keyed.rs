//! One value for each metric, as a JSON object with the metrics' keys.
//!
//! Keys that this version does not know are passed over, so that the file of a newer one can be read; a metric that is
//! missing is an error, since there is no figure that could stand for it.

use super::Metric;
use serde::de::{Error, IgnoredAny, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::marker::PhantomData;

/// A value for each metric, in the order of [`Metric::ALL`].
pub(crate) type Keyed<T> = [T; Metric::ALL.len()];

pub(crate) fn serialize<T: Serialize, S: Serializer>(
    values: &Keyed<T>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(values.len()))?;
    for (metric, value) in Metric::ALL.iter().zip(values) {
        map.serialize_entry(metric.key(), value)?;
    }
    map.end()
}

pub(crate) fn deserialize<'de, T, D>(deserializer: D) -> Result<Keyed<T>, D::Error>
where
    T: Deserialize<'de> + Copy + Default,
    D: Deserializer<'de>,
{
    struct Object<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de> + Copy + Default> Visitor<'de> for Object<T> {
        type Value = Keyed<T>;

        fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            formatter.write_str("an object with a member for each metric")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut values = [T::default(); Metric::ALL.len()];
            let mut seen = [false; Metric::ALL.len()];
            while let Some(key) = map.next_key::<String>()? {
                // The array holds the metrics in declaration order, which is that of `Metric::ALL`.
                match Metric::from_key(&key) {
                    Some(metric) if seen[metric as usize] => {
                        return Err(A::Error::custom(format!("the metric `{key}` is there twice")));
                    }
                    Some(metric) => {
                        values[metric as usize] = map.next_value()?;
                        seen[metric as usize] = true;
                    }
                    None => {
                        map.next_value::<IgnoredAny>()?;
                    }
                }
            }
            match Metric::ALL.iter().find(|metric| !seen[**metric as usize]) {
                None => Ok(values),
                Some(missing) => Err(A::Error::custom(format!("the metric `{}` is missing", missing.key()))),
            }
        }
    }

    deserializer.deserialize_map(Object(PhantomData))
}
