//! Subscription results, read in place.
//!
//! The message is checked once when it arrives; after that, walking over subscriptions, objects and values borrows
//! from the receive buffer, allocates nothing and cannot fail.

use crate::codec::{DecodeError, Reader};
use crate::constants::{Domain, RESPONSE, result};
use crate::value::{Value, read_value};

/// What a `simulationStep` brought: one [`Subscription`] for each that is active.
#[derive(Debug, Clone, Copy, Default)]
pub struct SubscriptionResults<'a> {
    count: usize,
    bytes: &'a [u8],
}

impl<'a> SubscriptionResults<'a> {
    /// Checks `count` subscriptions that fill `bytes` exactly.
    pub(crate) fn check(count: usize, bytes: &'a [u8]) -> Result<(), DecodeError> {
        let mut reader = Reader::new(bytes);
        for _ in 0..count {
            Subscription::read(reader.block()?)?.check()?;
        }
        reader.end()
    }

    /// Wraps bytes that [`check`](Self::check) accepted.
    pub(crate) fn checked(count: usize, bytes: &'a [u8]) -> Self {
        Self { count, bytes }
    }

    /// Number of subscriptions.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether nothing is subscribed.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The subscriptions, in the order in which they were made.
    pub fn iter(&self) -> impl Iterator<Item = Subscription<'a>> + Clone + use<'a> {
        let mut reader = Reader::new(self.bytes);
        std::iter::from_fn(move || {
            if reader.is_empty() { None } else { Subscription::read(reader.block().ok()?).ok() }
        })
    }

    /// The variable subscription of this object, if there is one.
    pub fn find(&self, domain: Domain, object: &str) -> Option<Subscription<'a>> {
        self.iter().find(|s| s.domain == domain && s.context.is_none() && s.object == object)
    }

    /// The context subscription around this object, if there is one.
    pub fn find_context(&self, domain: Domain, object: &str, of: Domain) -> Option<Subscription<'a>> {
        self.iter().find(|s| s.domain == domain && s.context == Some(of) && s.object == object)
    }
}

/// One subscription's results: one object's variables, or those of each object in the context.
#[derive(Debug, Clone, Copy)]
pub struct Subscription<'a> {
    domain: Domain,
    object: &'a str,
    context: Option<Domain>,
    variables: usize,
    objects: usize,
    bytes: &'a [u8],
}

impl<'a> Subscription<'a> {
    /// Reads the head of a response block.
    pub(crate) fn read(mut block: Reader<'a>) -> Result<Self, DecodeError> {
        let response = block.u8()?;
        let command = response.wrapping_sub(RESPONSE);
        let found = Domain::ALL.into_iter().find_map(|domain| {
            if domain.subscribe() == command {
                Some((domain, false))
            } else if domain.subscribe_context() == command {
                Some((domain, true))
            } else {
                None
            }
        });
        let Some((domain, is_context)) = found else {
            return Err(DecodeError::Mismatch {
                what: "response",
                expected: "of a subscription".to_owned(),
                found: format!("0x{response:02x}"),
            });
        };
        let object = block.str()?;
        let context = if is_context {
            let id = block.u8()?;
            Some(Domain::from_get(id).ok_or_else(|| DecodeError::Mismatch {
                what: "context",
                expected: "a domain".to_owned(),
                found: format!("0x{id:02x}"),
            })?)
        } else {
            None
        };
        let variables = block.u8()?.into();
        // An object takes at least its id's length.
        let objects = if is_context { block.count(4)? } else { 1 };
        Ok(Self { domain, object, context, variables, objects, bytes: block.rest() })
    }

    /// Reads everything once.
    pub(crate) fn check(&self) -> Result<(), DecodeError> {
        let mut reader = Reader::new(self.bytes);
        for _ in 0..self.objects {
            if self.context.is_some() {
                reader.str()?;
            }
            for _ in 0..self.variables {
                read_variable(&mut reader)?;
            }
        }
        reader.end()
    }

    /// Domain of the object subscribed to (or around).
    pub fn domain(&self) -> Domain {
        self.domain
    }

    /// The object subscribed to (or around).
    pub fn object_id(&self) -> &'a str {
        self.object
    }

    /// In a context subscription, the domain of the objects that follow.
    pub fn context(&self) -> Option<Domain> {
        self.context
    }

    /// Number of objects; 1 for a variable subscription.
    pub fn len(&self) -> usize {
        self.objects
    }

    /// Whether no object is in the context.
    pub fn is_empty(&self) -> bool {
        self.objects == 0
    }

    /// The objects with their values, ordered by id as SUMO sorts them.
    pub fn objects(&self) -> Objects<'a> {
        Objects {
            left: self.objects,
            variables: self.variables,
            own: self.context.is_none().then_some(self.object),
            reader: Reader::new(self.bytes),
        }
    }
}

/// Iterator over a subscription's objects.
#[derive(Debug, Clone)]
pub struct Objects<'a> {
    left: usize,
    variables: usize,
    own: Option<&'a str>,
    reader: Reader<'a>,
}

impl<'a> Iterator for Objects<'a> {
    type Item = Object<'a>;

    fn next(&mut self) -> Option<Object<'a>> {
        self.left = self.left.checked_sub(1)?;
        // The bytes were checked on arrival; `ok` can only end a message that was not.
        let id = match self.own {
            Some(id) => id,
            None => self.reader.str().ok()?,
        };
        let start = self.reader.rest();
        for _ in 0..self.variables {
            read_variable(&mut self.reader).ok()?;
        }
        Some(Object { id, bytes: &start[..start.len() - self.reader.rest().len()] })
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.left, Some(self.left))
    }
}

impl ExactSizeIterator for Objects<'_> {}

/// One object and its values.
#[derive(Debug, Clone, Copy)]
pub struct Object<'a> {
    id: &'a str,
    bytes: &'a [u8],
}

impl<'a> Object<'a> {
    /// The object's id.
    pub fn id(&self) -> &'a str {
        self.id
    }

    /// Variables with their values, in the order of the subscription.
    pub fn values(&self) -> impl Iterator<Item = (u8, Value<'a>)> + Clone + use<'a> {
        let mut reader = Reader::new(self.bytes);
        std::iter::from_fn(move || if reader.is_empty() { None } else { read_variable(&mut reader).ok() })
    }

    /// The value of one variable.
    pub fn get(&self, variable: u8) -> Option<Value<'a>> {
        self.values().find(|(id, _)| *id == variable).map(|(_, value)| value)
    }
}

/// Variable id, status, value; for an error status the value is SUMO's message.
fn read_variable<'a>(reader: &mut Reader<'a>) -> Result<(u8, Value<'a>), DecodeError> {
    let variable = reader.u8()?;
    let status = reader.u8()?;
    let value = read_value(reader)?;
    if status == result::OK {
        return Ok((variable, value));
    }
    Ok((variable, Value::Failed(value.str()?)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::argument::Argument;
    use crate::codec::Writer;
    use crate::constants::vehicle;
    use proptest::prelude::*;

    fn context_block(vehicles: &[(String, String, f64)]) -> Vec<u8> {
        let mut bytes = Vec::new();
        Writer::new(&mut bytes).command(Domain::Junction.subscribe_context() + RESPONSE, |w| {
            w.str("J0").u8(Domain::Vehicle.get()).u8(2).count(vehicles.len());
            for (id, lane, speed) in vehicles {
                w.str(id).u8(vehicle::LANE_ID).u8(result::OK);
                Argument::Str(lane).write(w);
                w.u8(vehicle::SPEED).u8(result::OK);
                Argument::Double(*speed).write(w);
            }
        });
        bytes
    }

    #[test]
    fn a_value_that_sumo_could_not_find_carries_its_message() {
        let mut bytes = Vec::new();
        Writer::new(&mut bytes).command(Domain::Vehicle.subscribe() + RESPONSE, |w| {
            w.str("v").u8(1).u8(vehicle::SPEED).u8(result::ERROR);
            Argument::Str("Vehicle 'v' is not known").write(w);
        });
        SubscriptionResults::check(1, &bytes).unwrap();
        let results = SubscriptionResults::checked(1, &bytes);
        let found = results.find(Domain::Vehicle, "v").unwrap();
        let value = found.objects().next().unwrap().get(vehicle::SPEED).unwrap();
        assert_eq!(value, Value::Failed("Vehicle 'v' is not known"));
        assert_eq!(value.double(), Err(DecodeError::Failed("Vehicle 'v' is not known".to_owned())));
        assert!(results.find(Domain::Vehicle, "w").is_none());
        assert!(results.find_context(Domain::Vehicle, "v", Domain::Vehicle).is_none());
    }

    proptest! {
        #[test]
        fn contexts_round_trip_and_every_cut_is_noticed(
            vehicles in proptest::collection::vec((".{0,12}", ".{0,12}", any::<f64>()), 0..20), cut in any::<proptest::sample::Index>(),
        ) {
            let bytes = context_block(&vehicles);
            SubscriptionResults::check(1, &bytes).unwrap();
            let results = SubscriptionResults::checked(1, &bytes);
            let found = results.find_context(Domain::Junction, "J0", Domain::Vehicle).unwrap();
            prop_assert_eq!(found.len(), vehicles.len());
            for (object, (id, lane, speed)) in found.objects().zip(&vehicles) {
                prop_assert_eq!(object.id(), id);
                prop_assert_eq!(object.get(vehicle::LANE_ID).unwrap().str().unwrap(), lane);
                prop_assert_eq!(object.get(vehicle::SPEED).unwrap().double().unwrap().to_bits(), speed.to_bits());
            }
            let cut = cut.index(bytes.len());
            prop_assert!(SubscriptionResults::check(1, &bytes[..cut]).is_err());
        }

        #[test]
        fn arbitrary_bytes_never_panic(
            head in prop_oneof![Just(0x99u8), Just(0xe4u8), any::<u8>()], body in proptest::collection::vec(any::<u8>(), 0..200), count in 0usize..4,
        ) {
            let mut bytes = Vec::new();
            Writer::new(&mut bytes).command(head, |w| { for byte in &body { w.u8(*byte); } });
            let _ = SubscriptionResults::check(count, &bytes);
            let _ = SubscriptionResults::check(count, &body);
            // Even unchecked bytes must only end the iteration early.
            for subscription in SubscriptionResults::checked(count, &bytes).iter() {
                for object in subscription.objects() {
                    for (_, value) in object.values() {
                        let _ = value.position();
                    }
                }
            }
        }
    }
}
