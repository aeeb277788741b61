//! Every figure of an evaluation in words: `cross eval --help` prints these, `docs/metrics.md` has them with what each
//! leaves out.

use super::Metric;

/// What a figure is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Definition {
    /// Key in JSON.
    pub key: &'static str,
    /// Name in tables.
    pub name: &'static str,
    /// Unit; `1` for a plain number.
    pub unit: &'static str,
    /// Its mean over an episode. T: seconds of the episode; entered vehicles: finished and unfinished ones.
    pub formula: &'static str,
    /// What of SUMO's it is computed from.
    pub source: &'static str,
}

/// All figures: the metrics in the order of [`Metric::ALL`], then the counts of an episode.
#[must_use]
pub fn definitions() -> Vec<&'static Definition> {
    Metric::ALL.into_iter().map(Metric::definition).chain(&COUNTS).collect()
}

pub(super) const QUEUE_LENGTH: Definition = Definition {
    key: "queue_length",
    name: "queue length",
    unit: "veh",
    formula: "mean over T of stopped vehicles (below 0.1 m/s) per signalised incoming lane, whole lane",
    source: "TraCI lane and speed of every vehicle, each second",
};
pub(super) const SPEED: Definition = Definition {
    key: "speed",
    name: "speed",
    unit: "m/s",
    formula: "mean over T of the mean speed of the vehicles in the network, 0 when there are none",
    source: "TraCI speed of every vehicle, each second",
};
pub(super) const TRIP_COMPLETION_RATE: Definition = Definition {
    key: "trip_completion_rate",
    name: "trip completion rate",
    unit: "veh/s",
    formula: "finished vehicles / T",
    source: "TraCI number of arrived vehicles, each second",
};
pub(super) const TRIP_TIME: Definition = Definition {
    key: "trip_time",
    name: "trip time",
    unit: "s",
    formula: "mean over entered vehicles of the time from entering to arrival or the end",
    source: "tripinfo duration",
};
pub(super) const TRIP_DELAY: Definition = Definition {
    key: "trip_delay",
    name: "trip delay",
    unit: "s",
    formula: "mean over entered vehicles of the time stopped (below 0.1 m/s) in the network",
    source: "tripinfo waitingTime",
};
pub(super) const TRIP_DURATION: Definition = Definition {
    key: "trip_duration",
    name: "trip duration",
    unit: "s",
    formula: "mean over all vehicles of the trip time, or of the wait to enter if never inserted",
    source: "tripinfo duration, departDelay",
};
pub(super) const FINISHED_TRIP_TIME: Definition = Definition {
    key: "finished_trip_time",
    name: "finished trip time",
    unit: "s",
    formula: "mean over finished vehicles of the time from entering to arrival",
    source: "tripinfo duration",
};
pub(super) const WAITING_TIME: Definition = Definition {
    key: "waiting_time",
    name: "waiting time",
    unit: "s",
    formula: "mean over all vehicles of the wait to enter plus the time stopped in the network",
    source: "tripinfo departDelay + waitingTime",
};
pub(super) const TIME_LOSS: Definition = Definition {
    key: "time_loss",
    name: "time loss",
    unit: "s",
    formula: "mean over entered vehicles of the time lost against driving as fast as allowed",
    source: "tripinfo timeLoss",
};
pub(super) const TOTAL_DELAY: Definition = Definition {
    key: "total_delay",
    name: "total delay",
    unit: "s",
    formula: "mean over all vehicles of the wait to enter plus the time loss; RESCO's delay",
    source: "tripinfo departDelay + timeLoss",
};
pub(super) const STOPS: Definition = Definition {
    key: "stops",
    name: "stops",
    unit: "1",
    formula: "mean over entered vehicles of the times of coming to a stop",
    source: "tripinfo waitingCount",
};
pub(super) const DEPART_DELAY: Definition = Definition {
    key: "depart_delay",
    name: "depart delay",
    unit: "s",
    formula: "mean over all vehicles of the wait between the departure that was due and entering, or the end",
    source: "tripinfo departDelay",
};
pub(super) const CO2: Definition = Definition {
    key: "co2",
    name: "CO2",
    unit: "g",
    formula: "mean over entered vehicles of the carbon dioxide given off until arrival or the end",
    source: "tripinfo emissions CO2_abs (mg) / 1000, of each vehicle's own emission class",
};
pub(super) const FUEL: Definition = Definition {
    key: "fuel",
    name: "fuel",
    unit: "g",
    formula: "mean over entered vehicles of the fuel used until arrival or the end",
    source: "tripinfo emissions fuel_abs (mg) / 1000, of each vehicle's own emission class",
};

/// What is counted of an episode beside its metrics.
const COUNTS: [Definition; 6] = [
    Definition {
        key: "finished",
        name: "finished",
        unit: "veh",
        formula: "vehicles that reached their destination",
        source: "tripinfo depart >= 0 and arrival >= 0",
    },
    Definition {
        key: "unfinished",
        name: "unfinished",
        unit: "veh",
        formula: "vehicles in the network at the end",
        source: "tripinfo depart >= 0 and arrival = -1",
    },
    Definition {
        key: "never_inserted",
        name: "never inserted",
        unit: "veh",
        formula: "undeparted vehicles: due, and without room to enter until the end",
        source: "tripinfo depart = -1 and departDelay > 0",
    },
    Definition {
        key: "teleports",
        name: "teleports",
        unit: "1",
        formula: "teleports that began; a vehicle may teleport more than once",
        source: "TraCI number of vehicles that start to teleport, each second",
    },
    Definition {
        key: "episode_return",
        name: "episode return",
        unit: "veh",
        formula: "mean over agents of the sum over decisions of minus the vehicles stopped near the stop lines",
        source: "TraCI lane, position and speed of every vehicle at each decision",
    },
    Definition {
        key: "gridlock",
        name: "gridlock",
        unit: "1",
        formula: "whether no vehicle arrived in the last 300 s with vehicles in the network all the while",
        source: "TraCI number of arrived vehicles and of vehicles, each second",
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_figure_is_documented_with_its_unit() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/metrics.md");
        let page = std::fs::read_to_string(page).unwrap();
        for Definition { key, unit, .. } in definitions() {
            let line = page.lines().find(|line| line.starts_with('|') && line.contains(&format!("`{key}`")));
            let line = line.unwrap_or_else(|| unreachable!("docs/metrics.md has no row for `{key}`"));
            assert!(line.contains(&format!("| {unit} |")), "{line}");
        }
    }

    #[test]
    fn keys_are_distinct_and_lead_back_to_their_metric() {
        let keys: HashSet<_> = definitions().iter().map(|definition| definition.key).collect();
        assert_eq!(keys.len(), definitions().len());
        for metric in Metric::ALL {
            assert_eq!(Metric::from_key(metric.key()), Some(metric));
        }
        assert_eq!(Metric::from_key("finished"), None, "a count, not a metric");
    }
}
