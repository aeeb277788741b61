//! SUMO's tripinfo output, read one vehicle at a time.
//!
//! The file must have been written with `--tripinfo-output.write-unfinished` and `--tripinfo-output.write-undeparted`;
//! without them the vehicles that fared worst would be missing from every mean.

use crate::xml::Bounded;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

/// A tripinfo file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TripInfoError {
    /// It could not be read.
    #[error("cannot read SUMO's trip output {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// It is not the whole and valid XML file that SUMO writes when it ends well.
    #[error("SUMO's trip output {} is broken near byte {position}: {problem}; run the episode again", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where reading stopped.
        position: u64,
        /// What is wrong there.
        problem: String,
    },
}

/// How a vehicle fared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It reached its destination.
    Finished,
    /// It was still in the network at the end.
    Unfinished,
    /// It was due, and found no room to enter until the end.
    NeverInserted,
    /// SUMO had read it, but its departure was not due before the end.
    NotDue,
}

/// What matters here of one vehicle; seconds unless said.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trip {
    depart: f64,
    arrival: f64,
    /// From entering until arrival or the end.
    pub duration: f64,
    /// Of standing (below 0.1 m/s).
    pub waiting_time: f64,
    /// Lost against driving as fast as allowed.
    pub time_loss: f64,
    /// Between the departure that was due and entering, or the end.
    pub depart_delay: f64,
    /// Number of halts.
    pub stops: f64,
    /// What it gave off and used, if it has SUMO's emissions device.
    pub emissions: Option<Emissions>,
}

/// What a vehicle gave off and used on its trip until arrival or the end.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Emissions {
    /// Carbon dioxide, milligrams.
    pub co2: f64,
    /// Fuel, milligrams.
    pub fuel: f64,
}

/// Reads a tripinfo file, however large, in constant memory, and calls `each` for every vehicle in it.
///
/// # Errors
/// [`TripInfoError`] names the file, and where and how it is malformed or cut off. Vehicles before that place have been
/// told by then.
pub fn read_trips(path: &Path, each: &mut dyn FnMut(&Trip)) -> Result<(), TripInfoError> {
    let file = File::open(path).map_err(|source| TripInfoError::Read { path: path.to_owned(), source })?;
    parse_trips(BufReader::new(file), path, each)
}

/// As [`read_trips`], from any text; `path` is how errors call it.
///
/// # Errors
/// As [`read_trips`].
pub fn parse_trips(
    text: impl BufRead,
    path: &Path,
    each: &mut dyn FnMut(&Trip),
) -> Result<(), TripInfoError> {
    let mut reader = Reader::from_reader(Bounded::new(text));
    let mut buffer = Vec::new();
    let mut open: usize = 0;
    // The vehicle whose element is open: its emissions stand inside.
    let mut current: Option<Trip> = None;
    let mut complete = false;
    let malformed = |position: u64, problem: String| TripInfoError::Malformed {
        path: path.to_owned(),
        position,
        problem,
    };
    loop {
        buffer.clear();
        reader.get_mut().next_piece();
        let event = match reader.read_event_into(&mut buffer) {
            Ok(event) => event,
            Err(quick_xml::Error::Io(source)) => {
                let source = std::io::Error::new(source.kind(), source);
                return Err(TripInfoError::Read { path: path.to_owned(), source });
            }
            Err(error) => return Err(malformed(reader.error_position(), error.to_string())),
        };
        let (element, empty) = match &event {
            Event::Start(element) => (element, false),
            Event::Empty(element) => (element, true),
            Event::End(_) => {
                open -= 1;
                complete = open == 0;
                if open == 1 {
                    current.take().iter().for_each(&mut *each);
                }
                continue;
            }
            Event::Eof => break,
            _ => continue,
        };
        let name = element.name();
        let read = match (open, name.as_ref()) {
            (0, "tripinfos") if !complete => {
                complete = empty;
                Ok(())
            }
            (0, other) => Err(format!("<{other}> stands where only one <tripinfos> belongs")),
            (1, "tripinfo") => Trip::parse(element).map(|trip| {
                if empty {
                    each(&trip);
                } else {
                    current = Some(trip);
                }
            }),
            (2, "emissions") => match &mut current {
                Some(trip) => Emissions::parse(element).map(|emissions| trip.emissions = Some(emissions)),
                None => Ok(()),
            },
            // Persons, containers, other devices.
            _ => Ok(()),
        };
        read.map_err(|problem| malformed(reader.buffer_position(), problem))?;
        open += usize::from(!empty);
    }
    if complete {
        Ok(())
    } else {
        Err(malformed(reader.buffer_position(), "it ends before </tripinfos>".to_owned()))
    }
}

impl Trip {
    /// How the vehicle fared.
    #[must_use]
    pub fn fate(&self) -> Fate {
        // SUMO writes -1 for a moment that never came.
        if self.depart < 0.0 {
            if self.depart_delay > 0.0 { Fate::NeverInserted } else { Fate::NotDue }
        } else if self.arrival < 0.0 {
            Fate::Unfinished
        } else {
            Fate::Finished
        }
    }

    fn parse(element: &BytesStart<'_>) -> Result<Self, String> {
        let mut trip = Self::default();
        let fields = [
            ("depart", &mut trip.depart),
            ("arrival", &mut trip.arrival),
            ("duration", &mut trip.duration),
            ("waitingTime", &mut trip.waiting_time),
            ("timeLoss", &mut trip.time_loss),
            ("departDelay", &mut trip.depart_delay),
            ("waitingCount", &mut trip.stops),
        ];
        numbers(element, fields)?;
        Ok(trip)
    }
}

impl Emissions {
    fn parse(element: &BytesStart<'_>) -> Result<Self, String> {
        let mut emissions = Self::default();
        numbers(element, [("CO2_abs", &mut emissions.co2), ("fuel_abs", &mut emissions.fuel)])?;
        Ok(emissions)
    }
}

/// Reads the attributes of these names, all of which must be there and finite.
fn numbers<const N: usize>(
    element: &BytesStart<'_>,
    mut fields: [(&'static str, &mut f64); N],
) -> Result<(), String> {
    let mut seen = [false; N];
    // SUMO never writes one twice, and looking for that costs time on each of thousands of vehicles.
    for attribute in element.attributes().with_checks(false) {
        let attribute = attribute.map_err(|error| error.to_string())?;
        let name = attribute.key.as_ref();
        let fields = fields.iter_mut().zip(&mut seen);
        let Some(((_, field), seen)) = fields.into_iter().find(|((of, _), _)| *of == name) else { continue };
        let number = attribute.value.trim().parse().ok().filter(|value: &f64| value.is_finite());
        **field = number.ok_or_else(|| format!("{name}={:?} is not a number", attribute.value))?;
        *seen = true;
    }
    match fields.iter().zip(seen).find(|(_, seen)| !seen) {
        None => Ok(()),
        Some(((missing, _), _)) => Err(format!("<{}> has no {missing}", element.name().as_ref())),
    }
}
