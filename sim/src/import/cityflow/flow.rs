//! CityFlow's flow file, read one flow at a time.

use super::{ImportError, RoadNet, input};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Error as _, SeqAccess, Visitor};
use std::collections::HashMap;
use std::fmt;
use std::io::Read;
use std::path::Path;

/// A million vehicles are more than any simulation of an hour moves, and a sign of a wrong unit.
pub(super) const MAX_VEHICLES: u64 = 500_000;
/// About three times what that many flows take.
const MAX_BYTES: u64 = 512 << 20;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Flow {
    route: Vec<String>,
    /// Seconds between two vehicles.
    interval: f64,
    /// Departure of the first vehicle, seconds.
    start_time: f64,
    /// Latest departure, seconds; -1 for no end.
    end_time: f64,
}

/// A vehicle of a demand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vehicle {
    /// Seconds.
    pub(super) depart: f64,
    /// Index into [`Demand::routes`].
    pub(super) route: usize,
    /// Number of its flow in the file.
    pub(super) flow: u64,
    /// Number of the vehicle in its flow; none in a flow of one.
    pub(super) number: Option<u64>,
}

/// What a flow file asks for.
#[derive(Debug, Default)]
pub(super) struct Demand {
    pub(super) flows: u64,
    /// In order of departure.
    pub(super) vehicles: Vec<Vehicle>,
    /// Distinct routes, as indices of roads.
    pub(super) routes: Vec<Vec<usize>>,
    /// Vehicles that would depart at or after the end.
    pub(super) too_late: u64,
}

/// Reads a flow file for a road network; `end` is the time at which the simulation ends, seconds.
pub(super) fn read(path: &Path, roads: &RoadNet, end: f64) -> Result<Demand, ImportError> {
    parse(input::open(path, MAX_BYTES)?, path, roads, end)
}

/// As [`read`], from a text; `path` is how errors call it.
pub(super) fn parse(text: impl Read, path: &Path, roads: &RoadNet, end: f64) -> Result<Demand, ImportError> {
    let mut refused = None;
    let mut reader = FlowReader {
        linked: roads.linked_roads(),
        roads,
        end,
        demand: Demand::default(),
        route_of_roads: HashMap::new(),
        refused: &mut refused,
    };
    let mut json = serde_json::Deserializer::from_reader(text);
    let result = FlowList(&mut reader).deserialize(&mut json).and_then(|()| json.end());
    let mut demand = reader.demand;
    match (refused, result) {
        (Some(what), _) => return Err(ImportError::content(path, what)),
        (None, Err(error)) => return Err(ImportError::json(path, "flow", &error)),
        (None, Ok(())) => {}
    }
    if demand.vehicles.is_empty() {
        return Err(ImportError::content(path, format!("no vehicle departs before {end} s")));
    }
    // Stable: vehicles of the same second keep the order of the file.
    demand.vehicles.sort_by(|a, b| a.depart.total_cmp(&b.depart));
    Ok(demand)
}

struct FlowReader<'a> {
    roads: &'a RoadNet,
    linked: std::collections::HashSet<(usize, usize)>,
    end: f64,
    demand: Demand,
    route_of_roads: HashMap<Vec<usize>, usize>,
    /// Why a flow was refused, in full; the JSON parser's own errors cannot carry it unchanged.
    refused: &'a mut Option<String>,
}

impl FlowReader<'_> {
    fn add(&mut self, flow: &Flow) -> Result<(), String> {
        let number = self.demand.flows;
        self.demand.flows += 1;
        let wrong = |what: String| Err(format!("flow {number} {what}"));
        // As JSON has no NaN, these are numbers.
        if flow.interval <= 0.0 {
            return wrong(format!("has interval {} s, which must be above 0", flow.interval));
        }
        if flow.start_time < 0.0 {
            return wrong(format!("has startTime {} s, which must not be negative", flow.start_time));
        }
        let endless = flow.end_time == -1.0;
        if !endless && flow.end_time < flow.start_time {
            return wrong(format!("has endTime {} s before startTime {} s", flow.end_time, flow.start_time));
        }
        let route = self.route(number, &flow.route)?;
        // Vehicles depart at startTime and then every interval up to and including endTime.
        let last = if endless { self.end } else { flow.end_time };
        let count = ((last - flow.start_time) / flow.interval + 1e-9).floor().max(0.0) + 1.0;
        if count + self.demand.vehicles.len() as f64 + self.demand.too_late as f64 > MAX_VEHICLES as f64 {
            return Err(format!(
                "with flow {number} it has more than {MAX_VEHICLES} vehicles; split it, or look at its intervals"
            ));
        }
        let single = !endless && count < 2.0;
        for vehicle in 0..count as u64 {
            let depart = flow.start_time + vehicle as f64 * flow.interval;
            if depart < self.end {
                let number_in_flow = (!single).then_some(vehicle);
                self.demand.vehicles.push(Vehicle { depart, route, flow: number, number: number_in_flow });
            } else if !endless {
                self.demand.too_late += 1;
            }
        }
        Ok(())
    }

    fn route(&mut self, flow: u64, names: &[String]) -> Result<usize, String> {
        if names.is_empty() {
            return Err(format!("flow {flow} has an empty route"));
        }
        let mut route = Vec::with_capacity(names.len());
        for name in names {
            match self.roads.road(name) {
                Some((index, _)) => route.push(index),
                None => {
                    return Err(format!(
                        "flow {flow} drives on road {name:?}, which the roadnet does not have"
                    ));
                }
            }
        }
        if let Some(pair) = route.windows(2).find(|pair| !self.linked.contains(&(pair[0], pair[1]))) {
            let name = |index: usize| &self.roads.roads[index].id;
            return Err(format!(
                "flow {flow} goes from road {:?} to road {:?}, but no lane leads there",
                name(pair[0]),
                name(pair[1])
            ));
        }
        let next = self.demand.routes.len();
        let known = *self.route_of_roads.entry(route.clone()).or_insert(next);
        if known == next {
            self.demand.routes.push(route);
        }
        Ok(known)
    }
}

struct FlowList<'r, 'a>(&'r mut FlowReader<'a>);

impl<'de> DeserializeSeed<'de> for FlowList<'_, '_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for FlowList<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of flows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut flows: A) -> Result<(), A::Error> {
        while let Some(flow) = flows.next_element::<Flow>()? {
            if let Err(what) = self.0.add(&flow) {
                *self.0.refused = Some(what);
                return Err(A::Error::custom("refused"));
            }
        }
        Ok(())
    }
}
