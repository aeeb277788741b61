//! SUMO's own output files, read line by line without the readers under test.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::panic,
    reason = "each test file uses its own part, and may panic"
)]

pub(crate) mod comparison;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Speed in m/s below which a vehicle halts.
const HALTING: f64 = 0.1;

/// Where an episode's outputs are, and the options that ask SUMO for them.
pub(crate) struct Outputs {
    folder: PathBuf,
}

impl Outputs {
    pub(crate) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// All records, with enough digits that rounding is no difference.
    pub(crate) fn options(&self) -> Vec<String> {
        let file = |name: &str| self.path(name).display().to_string();
        [
            ["--summary-output", &file("summary.xml")],
            ["--fcd-output", &file("fcd.xml")],
            ["--fcd-output.attributes", "lane,speed,pos"],
            ["--lanedata-output", &file("lanes.xml")],
            ["--statistic-output", &file("statistics.xml")],
            ["--emission-output", &file("emissions.xml")],
            ["--emission-output.attributes", "CO2,fuel"],
            ["--emission-output.precision", "9"],
            ["--device.emissions.probability", "1"],
            ["--precision", "9"],
        ]
        .concat()
        .into_iter()
        .map(str::to_owned)
        .collect()
    }

    pub(crate) fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    /// The lines of a file that open this element.
    pub(crate) fn lines(&self, name: &str, element: &str) -> Vec<String> {
        let open = format!("<{element} ");
        let text = self.text(name);
        text.lines().filter(|line| line.trim_start().starts_with(&open)).map(str::to_owned).collect()
    }

    /// Every vehicle of the trip output that was due, with its emissions.
    pub(crate) fn trips(&self) -> Vec<Trip> {
        let mut trips: Vec<Trip> = Vec::new();
        for line in self.text("trips.xml").lines() {
            if line.contains("<tripinfo ") {
                trips.push(Trip {
                    id: attribute(line, "id").unwrap().to_owned(),
                    depart: number(line, "depart"),
                    depart_lane: attribute(line, "departLane").unwrap().to_owned(),
                    depart_speed: number(line, "departSpeed"),
                    arrival: number(line, "arrival"),
                    duration: number(line, "duration"),
                    waiting_time: number(line, "waitingTime"),
                    time_loss: number(line, "timeLoss"),
                    depart_delay: number(line, "departDelay"),
                    stops: number(line, "waitingCount"),
                    emitted: Vec::new(),
                });
            } else if line.contains("<emissions ") {
                let trip = trips.last_mut().unwrap();
                trip.emitted = EMITTED.map(|name| number(line, &format!("{name}_abs"))).to_vec();
            }
        }
        trips.retain(|trip| trip.depart >= 0.0 || trip.depart_delay > 0.0);
        trips
    }

    /// What each vehicle gave off in each second before `end`, in the order of [`EMITTED`].
    pub(crate) fn emissions(&self, end: f64) -> HashMap<String, Vec<[f64; 2]>> {
        let mut of: HashMap<String, Vec<[f64; 2]>> = HashMap::new();
        let mut time = 0.0;
        for line in self.text("emissions.xml").lines() {
            if line.contains("<timestep ") {
                time = number(line, "time");
            } else if line.contains("<vehicle ") && time < end {
                let values = EMITTED.map(|name| number(line, name));
                of.entry(attribute(line, "id").unwrap().to_owned()).or_default().push(values);
            }
        }
        of
    }

    /// The position record of the seconds from `begin` to `end`.
    pub(crate) fn seconds(&self, begin: f64, end: f64) -> Vec<Second> {
        let mut seconds: Vec<Second> = Vec::new();
        let mut inside = false;
        for line in self.text("fcd.xml").lines() {
            if line.contains("<timestep ") {
                let time = number(line, "time");
                inside = time >= begin && time < end;
                if inside {
                    seconds.push(Second::default());
                }
            } else if inside && line.contains("<vehicle ") {
                // A vehicle that is between two places, teleporting, stands on no lane.
                let lane = attribute(line, "lane").unwrap().to_owned();
                let halting = number(line, "speed") < HALTING;
                seconds.last_mut().unwrap().vehicles.push((lane, number(line, "pos"), halting));
            }
        }
        seconds
    }
}

/// Names of what is measured of the vehicles' emissions; milligrams.
pub(crate) const EMITTED: [&str; 2] = ["CO2", "fuel"];

/// One vehicle of the trip output.
pub(crate) struct Trip {
    pub(crate) id: String,
    pub(crate) depart: f64,
    pub(crate) depart_lane: String,
    pub(crate) depart_speed: f64,
    pub(crate) arrival: f64,
    pub(crate) duration: f64,
    pub(crate) waiting_time: f64,
    pub(crate) time_loss: f64,
    pub(crate) depart_delay: f64,
    pub(crate) stops: f64,
    pub(crate) emitted: Vec<f64>,
}

/// One second of the position record: lane, position and whether it halts, of each vehicle.
#[derive(Default)]
pub(crate) struct Second {
    vehicles: Vec<(String, f64, bool)>,
}

impl Second {
    /// Halting vehicles on these lanes.
    pub(crate) fn halting(&self, lanes: &HashSet<String>) -> usize {
        self.vehicles.iter().filter(|(lane, _, halting)| *halting && lanes.contains(lane)).count()
    }

    /// Halting vehicles on lanes behind stop lines, given length and metres to these: those within so many metres of all, and of
    /// any.
    pub(crate) fn halting_behind(
        &self,
        lanes: &HashMap<String, (f64, Vec<f64>)>,
        metres: f64,
    ) -> (usize, usize) {
        let (mut all, mut any) = (0, 0);
        for (lane, position, _) in self.vehicles.iter().filter(|(_, _, halting)| *halting) {
            let Some((length, to)) = lanes.get(lane) else { continue };
            let near = |to: &&f64| length - position + **to <= metres;
            let within = to.iter().filter(near).count();
            all += usize::from(within == to.len());
            any += usize::from(within > 0);
        }
        (all, any)
    }

    /// Halting vehicles within so many metres of the end of these lanes, given the lanes' lengths.
    pub(crate) fn halting_near(&self, lanes: &HashMap<String, f64>, metres: f64) -> usize {
        let near =
            |lane: &str, position: f64| lanes.get(lane).is_some_and(|length| length - position <= metres);
        self.vehicles.iter().filter(|(lane, position, halting)| *halting && near(lane, *position)).count()
    }
}

/// The lanes that each signal controls, with their lengths, from the text of a net.
pub(crate) fn signalised(net: &str) -> HashMap<String, HashMap<String, f64>> {
    let lanes = net.lines().filter(|line| line.trim_start().starts_with("<lane "));
    let lengths: HashMap<_, _> =
        lanes.map(|line| (attribute(line, "id").unwrap(), number(line, "length"))).collect();
    let mut signals: HashMap<String, HashMap<String, f64>> = HashMap::new();
    for line in net.lines().filter(|line| line.trim_start().starts_with("<connection ")) {
        let Some(signal) = attribute(line, "tl") else { continue };
        let (from, to) = (attribute(line, "from").unwrap(), attribute(line, "to").unwrap());
        // Pedestrians' crossings are connections, too.
        if from.starts_with(':') || to.starts_with(':') {
            continue;
        }
        let lane = format!("{from}_{}", attribute(line, "fromLane").unwrap());
        let length = lengths[lane.as_str()];
        signals.entry(signal.to_owned()).or_default().insert(lane, length);
    }
    signals
}

/// Value of an attribute in a line of XML.
pub(crate) fn attribute<'l>(line: &'l str, name: &str) -> Option<&'l str> {
    let from = line.find(&format!(" {name}=\""))? + name.len() + 3;
    Some(&line[from..from + line[from..].find('"')?])
}

pub(crate) fn number(line: &str, name: &str) -> f64 {
    attribute(line, name).unwrap_or_else(|| panic!("no {name} in {line}")).parse().unwrap()
}

/// Mean and population deviation in two passes; zero of nothing.
pub(crate) fn mean_std(values: &[f64]) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / count).sqrt())
}
