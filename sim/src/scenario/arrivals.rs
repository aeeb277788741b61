//! Vehicles per minute, as data sets are described.

use super::ScenarioError;
use super::demand::{self, Departures};
use std::io::BufRead;
use std::path::{Path, PathBuf};

const MINUTE: f64 = 60.0;

/// How many vehicles a demand sends in each minute.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrivals {
    /// Vehicles in each minute from the beginning to the end, the last one possibly short; of flows, what they send on
    /// average.
    pub per_minute: Vec<f64>,
    /// Vehicles outside that time, which are never simulated.
    pub outside: f64,
    /// Vehicles whose departure has no time, because they wait for something else.
    pub untimed: u64,
}

impl Arrivals {
    pub(super) fn count(routes: &[PathBuf], begin: u32, end: u32) -> Result<Self, ScenarioError> {
        let mut arrivals = Self::none(begin, end);
        let (begin, end) = (f64::from(begin), f64::from(end));
        demand::read(routes, begin, end, &mut |departures| arrivals.add(departures, begin, end))?;
        Ok(arrivals)
    }

    /// Reads the text of one route file; `path` is how errors call it.
    ///
    /// # Errors
    /// [`ScenarioError::Read`] if it is not XML.
    pub fn parse(text: impl BufRead, path: &Path, begin: u32, end: u32) -> Result<Self, ScenarioError> {
        let mut arrivals = Self::none(begin, end);
        let (begin, end) = (f64::from(begin), f64::from(end));
        let add = &mut |departures| arrivals.add(departures, begin, end);
        demand::read_text(text, path, (begin, end), add)?;
        Ok(arrivals)
    }

    fn none(begin: u32, end: u32) -> Self {
        // A definition spans a year at most, which is half a million minutes.
        let minutes = f64::from(end.saturating_sub(begin)) / MINUTE;
        Self { per_minute: vec![0.0; minutes.ceil() as usize], outside: 0.0, untimed: 0 }
    }

    fn add(&mut self, departures: Departures, begin: f64, end: f64) {
        let (first, last, count): (f64, f64, &dyn Fn(f64) -> f64) = match departures {
            Departures::Single(None) => {
                self.untimed += 1;
                return;
            }
            // How many have departed before a time.
            Departures::Single(Some(depart)) => {
                (depart, depart, &move |time| f64::from(u8::from(depart < time)))
            }
            Departures::Flow { from, until, per_second } => {
                (from, until, &move |time: f64| ((time.min(until) - from) * per_second).max(0.0))
            }
        };
        let minute_of = |time: f64| ((time - begin).max(0.0) / MINUTE).floor() as usize;
        let range = minute_of(first)..self.per_minute.len().min(minute_of(last).saturating_add(1));
        let mut inside = 0.0;
        for minute in range {
            let from = begin + minute as f64 * MINUTE;
            let sent = count((from + MINUTE).min(end)) - count(from);
            self.per_minute[minute] += sent;
            inside += sent;
        }
        self.outside += count(f64::INFINITY) - inside;
    }

    /// Vehicles within the time.
    #[must_use]
    pub fn volume(&self) -> f64 {
        self.per_minute.iter().sum()
    }

    /// Mean of the minutes.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.volume() / self.per_minute.len().max(1) as f64
    }

    /// Standard deviation about the mean of those minutes in which anybody departs, divided by their number: the definition
    /// by which the published descriptions of data sets come out, whose traffic often ends before the hour does.
    #[must_use]
    pub fn std(&self) -> f64 {
        let mean = self.mean();
        let squares: f64 = self.busy_minutes().map(|count| (count - mean).powi(2)).sum();
        (squares / self.busy_minutes().count().max(1) as f64).sqrt()
    }

    /// The busiest minute.
    #[must_use]
    pub fn max(&self) -> f64 {
        self.per_minute.iter().copied().fold(0.0, f64::max)
    }

    /// The quietest minute in which anybody departs; 0 if nobody ever does.
    #[must_use]
    pub fn min(&self) -> f64 {
        self.busy_minutes().reduce(f64::min).unwrap_or(0.0)
    }

    /// Minutes in which nobody departs.
    #[must_use]
    pub fn empty_minutes(&self) -> usize {
        self.per_minute.len() - self.busy_minutes().count()
    }

    fn busy_minutes(&self) -> impl Iterator<Item = f64> {
        self.per_minute.iter().copied().filter(|&count| count > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrivals(elements: &str, begin: u32, end: u32) -> Arrivals {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("town.rou.xml");
        std::fs::write(&path, format!("<routes>{elements}</routes>")).unwrap();
        Arrivals::count(&[path], begin, end).unwrap()
    }

    #[test]
    fn vehicles_fall_into_their_minutes() {
        let vehicles = ["99.9", "100", "159.99", "160", "219", "220", "triggered"]
            .map(|depart| format!("<vehicle depart=\"{depart}\"/>"))
            .concat();
        let arrivals = arrivals(&vehicles, 100, 220);
        assert_eq!(arrivals.per_minute, [2.0, 2.0]);
        assert_eq!((arrivals.outside, arrivals.untimed), (2.0, 1));
    }

    #[test]
    fn a_flow_counts_by_its_rate() {
        let flow = "<flow begin=\"10\" end=\"90\" period=\"5\"/>";
        assert_eq!(arrivals(flow, 0, 120).per_minute, [10.0, 6.0]);
        let flow = "<flow begin=\"0\" end=\"120\" vehsPerHour=\"360\"/>";
        assert_eq!(arrivals(flow, 0, 120).per_minute, [6.0, 6.0]);
        let flow = "<flow begin=\"0\" end=\"1\" number=\"6\"/>";
        assert_eq!(arrivals(flow, 0, 120).per_minute, [6.0, 0.0]);
        for without in
            ["end=\"9\"", "begin=\"9\" end=\"9\" number=\"2\"", "period=\"0\"", "probability=\"-1\""]
        {
            assert_eq!(arrivals(&format!("<flow {without}/>"), 0, 120).volume(), 0.0, "{without}");
        }
    }

    #[test]
    fn absurd_rates_and_times_leave_numbers() {
        let flows = [
            "begin=\"10\" end=\"90\" vehsPerHour=\"1e308\"",
            "begin=\"0\" end=\"1e-300\" number=\"1e300\"",
            "end=\"1e308\" probability=\"1\"",
            "period=\"exp(1e300)\"",
        ];
        let arrivals = arrivals(&flows.map(|flow| format!("<flow {flow}/>").repeat(2)).concat(), 0, 120);
        assert_eq!((arrivals.volume(), arrivals.outside), (240.0, 0.0));
    }

    #[test]
    fn what_a_flow_sends_after_the_end_is_outside() {
        let flow = "<flow begin=\"30\" end=\"300\" probability=\"0.5\"/>";
        let arrivals = arrivals(flow, 0, 90);
        assert_eq!(arrivals.per_minute, [15.0, 15.0]);
        assert_eq!(arrivals.outside, 105.0);
    }

    #[test]
    fn statistics_are_those_of_the_minutes() {
        let arrivals = Arrivals { per_minute: vec![2.0, 4.0, 9.0], outside: 0.0, untimed: 0 };
        assert_eq!(
            (arrivals.volume(), arrivals.mean(), arrivals.max(), arrivals.min()),
            (15.0, 5.0, 9.0, 2.0)
        );
        assert!((arrivals.std() - (26.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        // A minute without departures counts for the mean alone.
        let arrivals = Arrivals { per_minute: vec![2.0, 4.0, 0.0], outside: 0.0, untimed: 0 };
        assert_eq!(
            (arrivals.mean(), arrivals.std(), arrivals.min(), arrivals.empty_minutes()),
            (2.0, 2.0_f64.sqrt(), 2.0, 1)
        );
        let nobody = Arrivals { per_minute: vec![0.0; 2], outside: 0.0, untimed: 0 };
        assert_eq!((nobody.mean(), nobody.std(), nobody.max(), nobody.min()), (0.0, 0.0, 0.0, 0.0));
    }
}
