//! Counting the vehicles of route files.

use super::ScenarioError;
use flate2::bufread::MultiGzDecoder;
use quick_xml::events::{BytesStart, Event};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

pub(super) fn vehicles(routes: &[PathBuf], begin: f64, end: f64) -> Result<u64, ScenarioError> {
    let mut total = 0.0;
    for path in routes {
        let unreadable = |source| ScenarioError::Read { path: path.clone(), source };
        let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
        total += if file.fill_buf().map_err(unreadable)?.starts_with(&[0x1f, 0x8b]) {
            count(BufReader::new(MultiGzDecoder::new(file)), path, begin, end)?
        } else {
            count(file, path, begin, end)?
        };
    }
    // Not negative, and far below 2^53.
    Ok(total.round() as u64)
}

fn count(text: impl BufRead, path: &Path, begin: f64, end: f64) -> Result<f64, ScenarioError> {
    let mut xml = quick_xml::Reader::from_reader(text);
    let mut buffer = Vec::new();
    let mut total = 0.0;
    loop {
        buffer.clear();
        let event = xml.read_event_into(&mut buffer).map_err(|error| ScenarioError::Read {
            path: path.to_owned(),
            source: std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()),
        })?;
        match event {
            Event::Start(element) | Event::Empty(element) => match element.name().as_ref() {
                "vehicle" | "trip" if departs_in_time(&element, begin) => total += 1.0,
                "flow" => total += flow(&element, begin, end),
                _ => {}
            },
            Event::Eof => return Ok(total),
            _ => {}
        }
    }
}

/// SUMO discards what should have departed before the simulation begins.
fn departs_in_time(element: &BytesStart<'_>, begin: f64) -> bool {
    number(element, "depart").is_none_or(|depart| depart >= begin)
}

fn flow(element: &BytesStart<'_>, begin: f64, end: f64) -> f64 {
    if let Some(number) = number(element, "number") {
        return number;
    }
    let from = number(element, "begin").unwrap_or(begin).max(begin);
    let until = number(element, "end").unwrap_or(end).min(end);
    let per_second = number(element, "vehsPerHour")
        .or_else(|| number(element, "perHour"))
        .map(|rate| rate / 3600.0)
        .or_else(|| number(element, "period").filter(|period| *period > 0.0).map(|period| 1.0 / period))
        .or_else(|| number(element, "probability"))
        .unwrap_or(0.0);
    (per_second * (until - from)).max(0.0)
}

fn number(element: &BytesStart<'_>, key: &str) -> Option<f64> {
    let value: f64 = element.try_get_attribute(key).ok()??.value.trim().parse().ok()?;
    (value.is_finite() && value >= 0.0).then_some(value)
}
