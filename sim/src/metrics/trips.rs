//! What is measured of each vehicle: SUMO's tripinfo output, folded into totals as it is read.
//!
//! The file must have been written with `--tripinfo-output.write-unfinished` and `--tripinfo-output.write-undeparted`;
//! without them the vehicles that fared worst would be missing from every mean.

use super::moments::{MeanStd, Moments};
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

/// Totals over the vehicles of one episode.
#[derive(Debug, Clone, Default)]
pub struct TripTotals {
    finished: u64,
    unfinished: u64,
    never_inserted: u64,
    not_due: u64,
    trip_time: Moments,
    finished_trip_time: Moments,
    delay: Moments,
    time_loss: Moments,
    stops: Moments,
    depart_delay: Moments,
    duration: Moments,
}

impl TripTotals {
    /// Reads a tripinfo file, however large, in constant memory.
    ///
    /// # Errors
    /// [`TripInfoError`] names the file, and where and how it is malformed or cut off.
    pub fn read(path: &Path) -> Result<Self, TripInfoError> {
        let file =
            File::open(path).map_err(|source| TripInfoError::Read { path: path.to_owned(), source })?;
        Self::parse(BufReader::new(file), path)
    }

    /// As [`TripTotals::read`], from any text; `path` is how errors call it.
    ///
    /// # Errors
    /// As [`TripTotals::read`].
    pub fn parse(text: impl BufRead, path: &Path) -> Result<Self, TripInfoError> {
        let mut reader = Reader::from_reader(text);
        let mut buffer = Vec::new();
        let mut totals = Self::default();
        let mut open: usize = 0;
        let mut complete = false;
        let malformed = |position: u64, problem: String| TripInfoError::Malformed {
            path: path.to_owned(),
            position,
            problem,
        };
        loop {
            buffer.clear();
            let event = match reader.read_event_into(&mut buffer) {
                Ok(event) => event,
                Err(quick_xml::Error::Io(source)) => {
                    let source = std::io::Error::new(source.kind(), source);
                    return Err(TripInfoError::Read { path: path.to_owned(), source });
                }
                Err(error) => return Err(malformed(reader.error_position(), error.to_string())),
            };
            // Vehicles are the root's children; with emissions asked for, they have children of their own.
            let (element, empty) = match &event {
                Event::Start(element) => (element, false),
                Event::Empty(element) => (element, true),
                Event::End(_) => {
                    open -= 1;
                    complete = open == 0;
                    continue;
                }
                Event::Eof => break,
                _ => continue,
            };
            let name = element.name();
            match (open, name.as_ref()) {
                (0, "tripinfos") if !complete => complete = empty,
                (0, other) => {
                    let problem = format!("<{other}> stands where only one <tripinfos> belongs");
                    return Err(malformed(reader.buffer_position(), problem));
                }
                (1, "tripinfo") => {
                    let trip = Trip::parse(element)
                        .map_err(|problem| malformed(reader.buffer_position(), problem))?;
                    totals.add(&trip);
                }
                // Persons, containers, emissions: none of them is a vehicle.
                _ => {}
            }
            open += usize::from(!empty);
        }
        if complete {
            Ok(totals)
        } else {
            Err(malformed(reader.buffer_position(), "it ends before </tripinfos>".to_owned()))
        }
    }

    fn add(&mut self, trip: &Trip) {
        match trip.fate() {
            Fate::NotDue => {
                self.not_due += 1;
                return;
            }
            Fate::NeverInserted => {
                self.never_inserted += 1;
                self.depart_delay.add(trip.depart_delay);
                self.duration.add(trip.depart_delay);
                return;
            }
            Fate::Finished => {
                self.finished += 1;
                self.finished_trip_time.add(trip.duration);
            }
            Fate::Unfinished => self.unfinished += 1,
        }
        self.trip_time.add(trip.duration);
        self.delay.add(trip.waiting_time);
        self.time_loss.add(trip.time_loss);
        self.stops.add(trip.stops);
        self.depart_delay.add(trip.depart_delay);
        self.duration.add(trip.duration);
    }

    /// Vehicles that reached their destination.
    #[must_use]
    pub fn finished(&self) -> u64 {
        self.finished
    }

    /// Vehicles still in the network at the end.
    #[must_use]
    pub fn unfinished(&self) -> u64 {
        self.unfinished
    }

    /// Vehicles that wanted to enter and found no room until the end.
    #[must_use]
    pub fn never_inserted(&self) -> u64 {
        self.never_inserted
    }

    /// Vehicles that SUMO had read but whose departure was not due before the end; part of no metric.
    #[must_use]
    pub fn not_due(&self) -> u64 {
        self.not_due
    }

    /// Seconds from entering until arrival or the end, over the vehicles that entered.
    #[must_use]
    pub fn trip_time(&self) -> MeanStd {
        self.trip_time.mean_std()
    }

    /// The same over the vehicles that arrived.
    #[must_use]
    pub fn finished_trip_time(&self) -> MeanStd {
        self.finished_trip_time.mean_std()
    }

    /// Seconds of standing (below 0.1 m/s), over the vehicles that entered.
    #[must_use]
    pub fn trip_delay(&self) -> MeanStd {
        self.delay.mean_std()
    }

    /// Seconds lost against driving as fast as allowed, over the vehicles that entered.
    #[must_use]
    pub fn time_loss(&self) -> MeanStd {
        self.time_loss.mean_std()
    }

    /// Times that a vehicle came to stand, over the vehicles that entered.
    #[must_use]
    pub fn stops(&self) -> MeanStd {
        self.stops.mean_std()
    }

    /// Seconds between wanting to enter and entering, or the end; over all vehicles.
    #[must_use]
    pub fn depart_delay(&self) -> MeanStd {
        self.depart_delay.mean_std()
    }

    /// Trip time of the vehicles that entered and waiting time of those that never did, over all of them, seconds.
    #[must_use]
    pub fn trip_duration(&self) -> MeanStd {
        self.duration.mean_std()
    }
}

/// How a vehicle fared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    Finished,
    Unfinished,
    NeverInserted,
    NotDue,
}

/// The attributes of one vehicle that matter here, seconds unless said.
#[derive(Debug, Default)]
struct Trip {
    depart: f64,
    arrival: f64,
    duration: f64,
    waiting_time: f64,
    time_loss: f64,
    depart_delay: f64,
    /// Number of halts.
    stops: f64,
}

impl Trip {
    fn parse(element: &BytesStart<'_>) -> Result<Self, String> {
        let mut trip = Self::default();
        let mut missing: Vec<&str> =
            vec!["depart", "arrival", "duration", "waitingTime", "timeLoss", "departDelay", "waitingCount"];
        // SUMO never writes one twice, and looking for that costs time on each of thousands of vehicles.
        for attribute in element.attributes().with_checks(false) {
            let attribute = attribute.map_err(|error| error.to_string())?;
            let field = match attribute.key.as_ref() {
                "depart" => &mut trip.depart,
                "arrival" => &mut trip.arrival,
                "duration" => &mut trip.duration,
                "waitingTime" => &mut trip.waiting_time,
                "timeLoss" => &mut trip.time_loss,
                "departDelay" => &mut trip.depart_delay,
                "waitingCount" => &mut trip.stops,
                _ => continue,
            };
            *field =
                attribute.value.trim().parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(
                    || format!("{}={:?} is not a number", attribute.key.as_ref(), attribute.value),
                )?;
            missing.retain(|name| *name != attribute.key.as_ref());
        }
        match missing.first() {
            None => Ok(trip),
            Some(name) => Err(format!("a vehicle has no {name}")),
        }
    }

    fn fate(&self) -> Fate {
        // SUMO writes -1 for a moment that never came.
        if self.depart < 0.0 {
            if self.depart_delay > 0.0 { Fate::NeverInserted } else { Fate::NotDue }
        } else if self.arrival < 0.0 {
            Fate::Unfinished
        } else {
            Fate::Finished
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<TripTotals, String> {
        TripTotals::parse(text.as_bytes(), Path::new("t.xml")).map_err(|error| error.to_string())
    }

    fn trip(depart: f64, arrival: f64, duration: f64, waiting: f64, delay: f64) -> String {
        format!(
            "<tripinfo id=\"v\" depart=\"{depart}\" departLane=\"a_0\" departDelay=\"{delay}\" arrival=\"{arrival}\" \
             duration=\"{duration}\" waitingTime=\"{waiting}\" waitingCount=\"2\" timeLoss=\"{}\" vaporized=\"\"/>\n",
            waiting + 1.0
        )
    }

    fn file(trips: &[String]) -> String {
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- generated -->\n<tripinfos xmlns:xsi=\"x\">\n{}</tripinfos>\n",
            trips.concat()
        )
    }

    #[test]
    fn every_vehicle_counts_where_it_belongs() {
        let totals = parse(&file(&[
            trip(0.0, 100.0, 100.0, 10.0, 0.0),
            trip(50.0, -1.0, 300.0, 50.0, 20.0),
            trip(-1.0, -1.0, 0.0, 0.0, 500.0),
            trip(-1.0, -1.0, 0.0, 0.0, 0.0),
        ]))
        .unwrap();
        let counts = [totals.finished(), totals.unfinished(), totals.never_inserted(), totals.not_due()];
        assert_eq!(counts, [1, 1, 1, 1]);
        assert_eq!(totals.trip_time(), MeanStd { mean: 200.0, std: 100.0 });
        assert_eq!(totals.finished_trip_time(), MeanStd { mean: 100.0, std: 0.0 });
        assert_eq!(totals.trip_delay(), MeanStd { mean: 30.0, std: 20.0 });
        assert_eq!(totals.time_loss(), MeanStd { mean: 31.0, std: 20.0 });
        assert_eq!(totals.stops(), MeanStd { mean: 2.0, std: 0.0 });
        assert_eq!(totals.trip_duration().mean, 300.0);
        assert!((totals.depart_delay().mean - 520.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn an_episode_without_vehicles_is_all_zero() {
        for text in [file(&[]), "<tripinfos/>".to_owned()] {
            let totals = parse(&text).unwrap();
            assert_eq!(totals.finished(), 0);
            assert_eq!(totals.trip_duration(), MeanStd::default());
        }
    }

    #[test]
    fn children_and_other_elements_are_not_vehicles() {
        let with_child = trip(0.0, 9.0, 9.0, 1.0, 0.0).replace("/>", "><emissions CO_abs=\"1\"/></tripinfo>");
        let person = "<personinfo id=\"p\"><ride><tripinfo/></ride></personinfo>".to_owned();
        assert_eq!(parse(&file(&[with_child, person])).unwrap().finished(), 1);
    }

    #[test]
    fn a_file_that_is_cut_off_anywhere_is_refused() {
        let whole = file(&[trip(0.0, 9.0, 9.0, 1.0, 0.0), trip(1.0, 9.0, 8.0, 1.0, 0.0)]);
        let end = whole.trim_end().len();
        for cut in 0..end {
            let error = parse(&whole[..cut]).expect_err("a part is not the whole");
            assert!(error.contains("t.xml"), "{error}");
        }
        assert!(parse(&whole[..end]).is_ok());
    }

    #[test]
    fn odd_content_is_refused_in_words() {
        let good = file(&[trip(0.0, 9.0, 9.0, 1.0, 0.0)]);
        for (text, word) in [
            (good.replace("duration=\"9\"", "duration=\"soon\""), "soon"),
            (good.replace("duration=\"9\"", "duration=\"NaN\""), "NaN"),
            (good.replace("duration=\"9\"", "duration=\"inf\""), "inf"),
            (good.replace("waitingCount=\"2\"", ""), "waitingCount"),
            ("<html></html>".to_owned(), "html"),
            (format!("{good}<tripinfos/>"), "only one"),
            ("not xml at all".to_owned(), "ends before"),
            (good.replace("</tripinfos>", "</trips>"), "broken"),
            (String::new(), "ends before"),
        ] {
            let error = parse(&text).expect_err(&text);
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = TripTotals::read(Path::new("/nonexistent/t.xml")).unwrap_err().to_string();
        assert!(error.contains("/nonexistent/t.xml"), "{error}");
    }

    proptest! {
        #[test]
        fn garbage_never_panics(text in "\\PC{0,200}") {
            let _ = parse(&text);
        }

        #[test]
        fn damaged_bytes_never_panic(position in 0_usize..400, byte: u8, length in 0_usize..600) {
            let mut bytes = file(&[trip(0.0, 9.0, 9.0, 1.0, 0.0), trip(-1.0, -1.0, 0.0, 0.0, 3.0)]).into_bytes();
            let at = position % bytes.len();
            bytes[at] = byte;
            bytes.truncate(length);
            let _ = TripTotals::parse(bytes.as_slice(), Path::new("t.xml"));
        }

        #[test]
        fn tags_in_any_order_never_panic(parts in prop::collection::vec(
            prop::sample::select(vec!["<tripinfos>", "</tripinfos>", "<tripinfo", "/>", ">", "depart=\"1\"", "<!--", "-->", "&x;", "</", "\""]),
            0..30,
        )) {
            let _ = parse(&parts.join(" "));
        }
    }
}
