//! The metrics of one episode together.

use super::keyed::{self, Keyed};
use super::metric::Metric;
use super::moments::MeanStd;
use super::seconds::SecondMeter;
use super::trips::TripTotals;
use serde::{Deserialize, Serialize};

/// How many vehicles there were, by what became of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Vehicles {
    /// Reached their destination.
    pub finished: u64,
    /// Still in the network at the end.
    pub unfinished: u64,
    /// Wanted to enter and found no room until the end.
    pub never_inserted: u64,
    /// Teleports that began; counts events, not vehicles.
    pub teleports: u64,
}

/// What one episode amounted to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeMetrics {
    /// SUMO's seed.
    pub seed: u32,
    /// Mean and deviation of each metric, in the order of [`Metric::ALL`].
    #[serde(with = "keyed")]
    metrics: Keyed<MeanStd>,
    /// Vehicles by what became of them.
    pub vehicles: Vehicles,
    /// Sum of the rewards of an agent over the episode, mean over agents: what training maximises.
    pub episode_return: f64,
    /// Whether traffic had come to rest before the end: see [`SecondMeter::gridlock`].
    pub gridlock: bool,
}

impl EpisodeMetrics {
    /// Puts together what was seen each second and what SUMO wrote of each vehicle.
    #[must_use]
    pub fn new(seed: u32, seconds: &SecondMeter, trips: &TripTotals, episode_return: f64) -> Self {
        let metrics = Metric::ALL.map(|metric| match metric {
            Metric::QueueLength => seconds.queue_length(),
            Metric::Speed => seconds.speed(),
            Metric::TripCompletionRate => seconds.trip_completion_rate(),
            Metric::TripTime => trips.trip_time(),
            Metric::TripDelay => trips.trip_delay(),
            Metric::TripDuration => trips.trip_duration(),
            Metric::FinishedTripTime => trips.finished_trip_time(),
            Metric::WaitingTime => trips.waiting_time(),
            Metric::TimeLoss => trips.time_loss(),
            Metric::TotalDelay => trips.total_delay(),
            Metric::Stops => trips.stops(),
            Metric::DepartDelay => trips.depart_delay(),
            Metric::Co2 => trips.co2(),
            Metric::Fuel => trips.fuel(),
        });
        Self {
            seed,
            metrics,
            vehicles: Vehicles {
                finished: trips.finished(),
                unfinished: trips.unfinished(),
                never_inserted: trips.never_inserted(),
                teleports: seconds.teleports(),
            },
            episode_return,
            gridlock: seconds.gridlock(),
        }
    }

    /// Mean and deviation of one metric.
    #[must_use]
    pub fn get(&self, metric: Metric) -> MeanStd {
        // The array holds the metrics in declaration order, which is that of `Metric::ALL`.
        self.metrics[metric as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_list_of_metrics_is_in_declaration_order() {
        for (position, metric) in Metric::ALL.into_iter().enumerate() {
            assert_eq!(metric as usize, position, "{metric:?}");
        }
        assert_eq!(Metric::ALL[..6], Metric::PAPER);
    }

    #[test]
    fn json_names_every_metric_and_holds_only_numbers() {
        let trips = TripTotals::parse("<tripinfos/>".as_bytes(), Path::new("t.xml")).unwrap();
        let episode = EpisodeMetrics::new(3, &SecondMeter::default(), &trips, -1.5);
        let json = serde_json::to_value(&episode).unwrap();
        for metric in Metric::ALL {
            assert!(json["metrics"][metric.key()]["mean"].is_number(), "{}", metric.key());
            assert!(json["metrics"][metric.key()]["std"].is_number(), "{}", metric.key());
        }
        assert_eq!(json["seed"], 3);
        assert_eq!(json["episode_return"], -1.5);
        assert_eq!(json["vehicles"]["never_inserted"], 0);
        assert_eq!(json["gridlock"], false);
    }

    #[test]
    fn json_reads_back_the_same_and_is_checked() {
        let text = "<tripinfos><tripinfo depart=\"0\" arrival=\"0.3\" duration=\"0.1\" waitingTime=\"0.7\" \
                    waitingCount=\"1\" timeLoss=\"0.123456789012345\" departDelay=\"3\"/></tripinfos>";
        let trips = TripTotals::parse(text.as_bytes(), Path::new("t.xml")).unwrap();
        let episode = EpisodeMetrics::new(3, &SecondMeter::default(), &trips, -1.0 / 3.0);
        let json = serde_json::to_string(&episode).unwrap();
        assert_eq!(serde_json::from_str::<EpisodeMetrics>(&json).unwrap(), episode);
        let newer = json.replace("\"metrics\":{", "\"metrics\":{\"noise\":{\"mean\":1},");
        assert_eq!(
            serde_json::from_str::<EpisodeMetrics>(&newer).unwrap(),
            episode,
            "unknown metrics are no matter"
        );
        for (from, to, words) in [
            ("\"co2\":", "\"co3\":", "`co2` is missing"),
            ("\"fuel\":", "\"co2\":", "`co2` is there twice"),
            ("\"metrics\":{", "\"metrics\":[],\"old\":{", "an object with a member for each metric"),
            ("\"seed\":3,", "", "`seed`"),
        ] {
            let error = serde_json::from_str::<EpisodeMetrics>(&json.replace(from, to)).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
