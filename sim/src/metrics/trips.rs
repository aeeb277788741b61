//! What is measured of each vehicle, folded into totals as SUMO's trip output is read.

use super::moments::{MeanStd, Moments};
use super::tripinfo::{Emissions, Fate, Trip, TripInfoError, parse_trips, read_trips};
use std::io::BufRead;
use std::path::Path;

/// SUMO writes emissions in milligrams.
const MILLIGRAMS_PER_GRAM: f64 = 1000.0;

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
    waiting: Moments,
    total_delay: Moments,
    duration: Moments,
    co2: Moments,
    fuel: Moments,
}

impl TripTotals {
    /// Reads a tripinfo file, however large, in constant memory.
    ///
    /// # Errors
    /// [`TripInfoError`] names the file, and where and how it is malformed or cut off.
    pub fn read(path: &Path) -> Result<Self, TripInfoError> {
        let mut totals = Self::default();
        read_trips(path, &mut |trip| totals.add(trip))?;
        Ok(totals)
    }

    /// As [`TripTotals::read`], from any text; `path` is how errors call it.
    ///
    /// # Errors
    /// As [`TripTotals::read`].
    pub fn parse(text: impl BufRead, path: &Path) -> Result<Self, TripInfoError> {
        let mut totals = Self::default();
        parse_trips(text, path, &mut |trip| totals.add(trip))?;
        Ok(totals)
    }

    /// Takes one vehicle in.
    pub fn add(&mut self, trip: &Trip) {
        match trip.fate() {
            Fate::NotDue => {
                self.not_due += 1;
                return;
            }
            Fate::NeverInserted => {
                self.never_inserted += 1;
                self.depart_delay.add(trip.depart_delay);
                self.waiting.add(trip.depart_delay);
                self.total_delay.add(trip.depart_delay);
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
        self.waiting.add(trip.depart_delay + trip.waiting_time);
        self.total_delay.add(trip.depart_delay + trip.time_loss);
        self.duration.add(trip.duration);
        if let Some(Emissions { co2, fuel }) = trip.emissions {
            self.co2.add(co2 / MILLIGRAMS_PER_GRAM);
            self.fuel.add(fuel / MILLIGRAMS_PER_GRAM);
        }
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
    /// Seconds of waiting, outside the network to enter it and standing inside it, over all vehicles.
    #[must_use]
    pub fn waiting_time(&self) -> MeanStd {
        self.waiting.mean_std()
    }

    /// Seconds of waiting to enter the network and lost inside it, over all vehicles.
    #[must_use]
    pub fn total_delay(&self) -> MeanStd {
        self.total_delay.mean_std()
    }

    /// Grams of carbon dioxide until arrival or the end, over the vehicles that entered and have SUMO's emissions device.
    #[must_use]
    pub fn co2(&self) -> MeanStd {
        self.co2.mean_std()
    }

    /// Grams of fuel, over the same vehicles.
    #[must_use]
    pub fn fuel(&self) -> MeanStd {
        self.fuel.mean_std()
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
        // 10 inside; 20 outside and 50 inside; 500 outside.
        assert!((totals.waiting_time().mean - 580.0 / 3.0).abs() < 1e-9);
        // 11 inside; 20 outside and 51 inside; 500 outside.
        assert!((totals.total_delay().mean - 582.0 / 3.0).abs() < 1e-9);
        assert_eq!(totals.co2(), MeanStd::default(), "nothing measured them");
    }

    #[test]
    fn emissions_are_those_of_the_vehicles_that_entered() {
        let emits = |trip: String, co2: f64| {
            let emissions = format!("<emissions CO_abs=\"9\" CO2_abs=\"{co2}\" fuel_abs=\"{}\"/>", co2 / 4.0);
            trip.replace("/>", &format!("> {emissions} <x/> </tripinfo>"))
        };
        let totals = parse(&file(&[
            emits(trip(0.0, 100.0, 100.0, 10.0, 0.0), 3000.0),
            emits(trip(50.0, -1.0, 300.0, 50.0, 20.0), 1000.0),
            emits(trip(-1.0, -1.0, 0.0, 0.0, 500.0), 0.0),
            // One without the device.
            trip(0.0, 100.0, 100.0, 10.0, 0.0),
        ]))
        .unwrap();
        assert_eq!(totals.co2(), MeanStd { mean: 2.0, std: 1.0 });
        assert_eq!(totals.fuel(), MeanStd { mean: 0.5, std: 0.25 });
        assert_eq!(totals.finished(), 2);
        let bad = emits(trip(0.0, 9.0, 9.0, 1.0, 0.0), 1.0);
        for (from, to, word) in
            [("CO2_abs=\"1\"", "", "CO2_abs"), ("fuel_abs=\"0.25\"", "fuel_abs=\"much\"", "much")]
        {
            let error = parse(&file(&[bad.replace(from, to)])).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
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
        let with_child = trip(0.0, 9.0, 9.0, 1.0, 0.0).replace("/>", "><battery Pmax=\"1\"/></tripinfo>");
        let person = "<personinfo id=\"p\"><ride><tripinfo/><emissions/></ride></personinfo>".to_owned();
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
            prop::sample::select(vec!["<tripinfos>", "</tripinfos>", "<tripinfo", "</tripinfo>", "<emissions", "/>", ">", "depart=\"1\"", "<!--", "-->", "&x;", "</", "\""]),
            0..30,
        )) {
            let _ = parse(&parts.join(" "));
        }
    }
}
