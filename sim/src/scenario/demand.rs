//! Reading the departures that route files define.

use super::ScenarioError;
use crate::xml::Bounded;
use flate2::bufread::MultiGzDecoder;
use quick_xml::events::{BytesStart, Event};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

/// Largest time or rate that is one: some thirty thousand years. Sums of larger ones would be no numbers.
const LARGEST: f64 = 1e12;
/// Most vehicles a second of one flow; SUMO inserts one a second on each lane.
const MOST_PER_SECOND: f64 = 1e6;

/// Something in a route file that makes vehicles depart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Departures {
    /// One vehicle at a time in seconds; none for one that waits for something else.
    Single(Option<f64>),
    /// Vehicles at a constant rate.
    Flow {
        /// Seconds.
        from: f64,
        /// Seconds.
        until: f64,
        /// On average.
        per_second: f64,
    },
}

/// Calls `visit` for every element that makes vehicles depart, in the order of the files. What a flow does not say about
/// its beginning and end is taken from `begin` and `end`.
pub(super) fn read(
    routes: &[PathBuf],
    begin: f64,
    end: f64,
    visit: &mut dyn FnMut(Departures),
) -> Result<(), ScenarioError> {
    for path in routes {
        let unreadable = |source| ScenarioError::Read { path: path.clone(), source };
        let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
        if file.fill_buf().map_err(unreadable)?.starts_with(&[0x1f, 0x8b]) {
            read_text(BufReader::new(MultiGzDecoder::new(file)), path, (begin, end), visit)?;
        } else {
            read_text(file, path, (begin, end), visit)?;
        }
    }
    Ok(())
}

/// Vehicles from `begin` on: single ones, plus what flows send on average until `end`.
pub(super) fn vehicles(routes: &[PathBuf], begin: f64, end: f64) -> Result<u64, ScenarioError> {
    let mut total = 0.0;
    read(routes, begin, end, &mut |departures| {
        total += match departures {
            // SUMO discards what should have departed before the simulation begins.
            Departures::Single(depart) => f64::from(u8::from(depart.is_none_or(|depart| depart >= begin))),
            Departures::Flow { from, until, per_second } => {
                (until.min(end) - from.max(begin)).max(0.0) * per_second
            }
        };
    })?;
    // Not negative, and far below 2^53.
    Ok(total.round() as u64)
}

/// As [`read`], from the text of one file; `path` is how errors call it.
pub(super) fn read_text(
    text: impl BufRead,
    path: &Path,
    times: (f64, f64),
    visit: &mut dyn FnMut(Departures),
) -> Result<(), ScenarioError> {
    let mut xml = quick_xml::Reader::from_reader(Bounded::new(text));
    let mut buffer = Vec::new();
    loop {
        buffer.clear();
        xml.get_mut().next_piece();
        let event = xml.read_event_into(&mut buffer).map_err(|error| ScenarioError::Read {
            path: path.to_owned(),
            source: std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()),
        })?;
        match event {
            Event::Start(element) | Event::Empty(element) => match element.name().as_ref() {
                "vehicle" | "trip" => visit(Departures::Single(number(&element, "depart"))),
                "flow" => flow(&element, times).map_or((), &mut *visit),
                _ => {}
            },
            Event::Eof => return Ok(()),
            _ => {}
        }
    }
}

fn flow(element: &BytesStart<'_>, (begin, end): (f64, f64)) -> Option<Departures> {
    let from = number(element, "begin").unwrap_or(begin);
    let until = number(element, "end").unwrap_or(end);
    // `period="exp(0.5)"`: exponentially distributed pauses, so many vehicles a second.
    let exponential = || {
        let period = element.try_get_attribute("period").ok()??;
        period.value.trim().strip_prefix("exp(")?.strip_suffix(')')?.trim().parse::<f64>().ok()
    };
    let per_hour = |rate: f64| rate / 3600.0;
    let per_second = number(element, "number")
        .map(|number| number / (until - from))
        .or_else(|| number(element, "vehsPerHour").map(per_hour))
        .or_else(|| number(element, "perHour").map(per_hour))
        .or_else(|| number(element, "period").map(|period| 1.0 / period))
        .or_else(|| number(element, "probability"))
        .or_else(exponential)?;
    (per_second > 0.0 && per_second <= MOST_PER_SECOND).then_some(Departures::Flow {
        from,
        until,
        per_second,
    })
}

fn number(element: &BytesStart<'_>, key: &str) -> Option<f64> {
    let value: f64 = element.try_get_attribute(key).ok()??.value.trim().parse().ok()?;
    (0.0..=LARGEST).contains(&value).then_some(value)
}
