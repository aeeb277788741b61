//! Who drives through a grid: profiles of demand and the route file they make.

mod scattered;
mod two_wave;

use super::GenerateError;
use super::grid::{GridOptions, whole};
use super::xml::XmlFile;
use serde::{Deserialize, Serialize};
use std::io::{self, Write};

/// The one vehicle type of generated demand.
pub(crate) const VEHICLE_TYPE: &str = "type1";
/// More vehicles than a grid of the largest size can move in a day.
const MAX_VEHICLES: u64 = 500_000;

/// A profile of demand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "profile", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Demand {
    /// Two waves of through traffic, first from the north and west, then from the south and east, as in the MA2C
    /// benchmark. It takes ten slots, the first wave seven from the start, the second seven from the fourth slot.
    TwoWave {
        /// Vehicles per hour of each east-west pair at the peak of the first wave; north-south pairs have 60 % of it.
        first_peak: u32,
        /// The same for the second wave.
        second_peak: u32,
        /// Length of a slot, seconds.
        #[serde(default = "five_minutes")]
        slot_seconds: u32,
        /// Vehicles that stand on every lane between two crossings when the simulation begins.
        #[serde(default)]
        initial_per_lane: u32,
    },
    /// Single vehicles at random: departures a Poisson process, ends of the trip uniform over the dead ends.
    Uniform {
        /// Departures an hour, on average.
        vehicles_per_hour: u32,
        /// For how long, seconds.
        #[serde(default = "one_hour")]
        duration: u32,
    },
    /// As uniform, but the rate rises to four times that of the beginning in the middle and falls again.
    Peak {
        /// Departures an hour, on average.
        vehicles_per_hour: u32,
        /// For how long, seconds.
        #[serde(default = "one_hour")]
        duration: u32,
    },
}

fn five_minutes() -> u32 {
    300
}

fn one_hour() -> u32 {
    3600
}

impl Default for Demand {
    fn default() -> Self {
        Self::Peak { vehicles_per_hour: 2000, duration: one_hour() }
    }
}

impl Demand {
    pub(crate) fn validate(&self, grid: &GridOptions) -> Result<(), GenerateError> {
        let refuse = |what: String| Err(GenerateError::Option { what });
        match *self {
            Self::TwoWave { first_peak, second_peak, slot_seconds, initial_per_lane } => {
                whole("first_peak", first_peak, 0..=20_000)?;
                whole("second_peak", second_peak, 0..=20_000)?;
                whole("slot_seconds", slot_seconds, 60..=3600)?;
                whole("initial_per_lane", initial_per_lane, 0..=100)?;
                if grid.columns < 5 || grid.rows < 3 {
                    return refuse(format!(
                        "two-wave demand needs at least 5 columns and 3 rows, but there are {} and {}; take the \
                         profile uniform or peak",
                        grid.columns, grid.rows
                    ));
                }
                if grid.closed > 0.0 {
                    return refuse(format!(
                        "two-wave demand needs every road, but closed is {}; take the profile uniform or peak",
                        grid.closed
                    ));
                }
            }
            Self::Uniform { vehicles_per_hour, duration } | Self::Peak { vehicles_per_hour, duration } => {
                whole("duration", duration, 1..=86_400)?;
                let vehicles = scattered::vehicles(vehicles_per_hour, duration);
                if vehicles == 0 || vehicles > MAX_VEHICLES {
                    return refuse(format!(
                        "vehicles_per_hour is {vehicles_per_hour}, which makes {vehicles} vehicles in {duration} s but \
                         must make between 1 and {MAX_VEHICLES}"
                    ));
                }
            }
        }
        Ok(())
    }
}

/// Writes the route file of a grid whose options have been validated.
pub(crate) fn write(options: &GridOptions, target: impl Write) -> io::Result<()> {
    let mut xml = XmlFile::start(target, "routes")?;
    xml.element("vType", &[("id", &VEHICLE_TYPE), ("length", &5), ("accel", &5), ("decel", &10)])?;
    match options.demand {
        Demand::TwoWave { first_peak, second_peak, slot_seconds, initial_per_lane } => {
            two_wave::initial(&mut xml, options, initial_per_lane)?;
            two_wave::waves(&mut xml, options, [first_peak, second_peak], slot_seconds)?;
        }
        Demand::Uniform { vehicles_per_hour, duration } => {
            scattered::trips(&mut xml, options, vehicles_per_hour, duration, |_| 1.0)?;
        }
        Demand::Peak { vehicles_per_hour, duration } => {
            scattered::trips(&mut xml, options, vehicles_per_hour, duration, |share| {
                1.0 - 0.75 * (2.0 * share - 1.0).abs()
            })?;
        }
    }
    xml.finish().map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(options: &GridOptions) -> String {
        options.validate().unwrap();
        let mut text = Vec::new();
        write(options, &mut text).unwrap();
        String::from_utf8(text).unwrap()
    }

    fn value<'a>(line: &'a str, key: &str) -> Option<&'a str> {
        line.split_once(&format!(" {key}=\""))?.1.split('"').next()
    }

    #[test]
    fn the_waves_have_the_published_pairs_and_rates() {
        let demand =
            Demand::TwoWave { first_peak: 1100, second_peak: 925, slot_seconds: 300, initial_per_lane: 0 };
        let text = text(&GridOptions { demand, ..GridOptions::default() });
        let flows: Vec<_> = text.lines().filter(|line| line.contains("<flow")).collect();
        assert_eq!(flows.len(), 84);
        let hours: f64 =
            flows.iter().map(|line| value(line, "vehsPerHour").unwrap().parse::<f64>().unwrap()).sum();
        assert_eq!((hours / 12.0).round(), 3682.0);
        let of = |from: &str, to: &str| -> Vec<_> {
            flows
                .iter()
                .filter(|line| value(line, "from") == Some(from) && value(line, "to") == Some(to))
                .map(|line| (value(line, "begin").unwrap(), value(line, "vehsPerHour").unwrap()))
                .collect()
        };
        // From the fourth dead end in the north to the second in the south.
        let first = of("np12_nt24", "nt2_np2");
        assert_eq!(first[..4], [("0", "264"), ("300", "462"), ("600", "594"), ("900", "660")]);
        assert_eq!(of("np16_nt21", "nt5_np6")[3], ("900", "1100"));
        // Truncated, not rounded: 0.6 of 277.5 is 166.5.
        assert_eq!(of("np2_nt2", "nt22_np14")[0], ("900", "166"));
        assert_eq!(of("np10_nt25", "nt21_np16").last(), Some(&("2700", "185")));
        let begins: Vec<u32> =
            flows.iter().map(|line| value(line, "begin").unwrap().parse().unwrap()).collect();
        assert!(begins.is_sorted(), "SUMO wants flows in order of their beginning");
    }

    #[test]
    fn vehicles_that_stand_there_at_the_beginning_fill_every_inner_lane() {
        let demand =
            Demand::TwoWave { first_peak: 0, second_peak: 0, slot_seconds: 360, initial_per_lane: 6 };
        let text = text(&GridOptions { demand, ..GridOptions::default() });
        let flows: Vec<_> = text.lines().filter(|line| line.contains("number=\"6\"")).collect();
        assert_eq!(flows.len(), 120);
        assert!(flows.iter().all(|line| value(line, "from").is_some_and(|from| !from.contains("np"))));
        assert!(flows.iter().all(|line| value(line, "to").is_some_and(|to| to.contains("_np"))));
    }

    #[test]
    fn scattered_trips_repeat_with_their_seed_and_are_in_order() {
        let options = |seed, demand| GridOptions { seed, demand, ..GridOptions::default() };
        let uniform = Demand::Uniform { vehicles_per_hour: 720, duration: 1800 };
        let first = text(&options(1, uniform.clone()));
        assert_eq!(first, text(&options(1, uniform.clone())));
        assert_ne!(first, text(&options(2, uniform)));
        let departs = |text: &str| -> Vec<u32> {
            text.lines().filter_map(|line| value(line, "depart")?.parse().ok()).collect()
        };
        let times = departs(&first);
        assert_eq!(times.len(), 360);
        assert!(times.is_sorted() && times.iter().all(|&time| time < 1800));
        for line in first.lines().filter(|line| line.contains("<trip")) {
            let (from, to) = (value(line, "from").unwrap(), value(line, "to").unwrap());
            assert!(from.starts_with("np") && to.contains("_np"), "{line}");
            assert_ne!(from.split('_').next(), to.split('_').nth(1), "back to where it came from: {line}");
        }
        let peak = Demand::Peak { vehicles_per_hour: 3600, duration: 3600 };
        let times = departs(&text(&options(1, peak)));
        let within =
            |from: u32, until: u32| times.iter().filter(|&&time| from <= time && time < until).count();
        assert!(within(1500, 2100) > 2 * within(0, 600), "{} {}", within(1500, 2100), within(0, 600));
    }

    #[test]
    fn odd_demand_is_refused_by_name() {
        let refused = |options: GridOptions, words: &str| {
            let error = options.validate().unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        };
        let two_wave =
            Demand::TwoWave { first_peak: 1, second_peak: 1, slot_seconds: 300, initial_per_lane: 0 };
        refused(GridOptions { columns: 4, demand: two_wave, ..GridOptions::default() }, "5 columns");
        let none = Demand::Uniform { vehicles_per_hour: 0, duration: 3600 };
        refused(GridOptions { demand: none, ..GridOptions::default() }, "vehicles_per_hour");
        let many = Demand::Peak { vehicles_per_hour: u32::MAX, duration: 86_400 };
        refused(GridOptions { demand: many, ..GridOptions::default() }, "vehicles_per_hour");
        let two_wave =
            Demand::TwoWave { first_peak: 1, second_peak: 1, slot_seconds: 300, initial_per_lane: 0 };
        refused(GridOptions { demand: two_wave, closed: 0.1, ..GridOptions::default() }, "every road");
        refused(GridOptions { closed: 0.6, ..GridOptions::default() }, "closed");
        refused(GridOptions { closed: f64::NAN, ..GridOptions::default() }, "closed");
        refused(GridOptions { jitter: -1.0, ..GridOptions::default() }, "jitter");
        refused(GridOptions { jitter: 51.0, ..GridOptions::default() }, "jitter");
        refused(GridOptions { spacing: f64::NAN, ..GridOptions::default() }, "spacing");
        refused(GridOptions { columns: 0, ..GridOptions::default() }, "columns");
        refused(GridOptions { rows: 1_000_000, ..GridOptions::default() }, "rows");
    }
}
