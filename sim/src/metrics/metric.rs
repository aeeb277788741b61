//! The list of metrics: key, name, unit, better direction, formula and source of each.

use super::definition::{self, Definition};

/// Which way a metric improves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// A lower value is better.
    Lower,
    /// A higher value is better.
    Higher,
}

/// One metric of [`EpisodeMetrics`](super::EpisodeMetrics).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Metric {
    /// Stopped vehicles on a signalised incoming lane, each second.
    QueueLength,
    /// Mean speed of the running vehicles, each second.
    Speed,
    /// Vehicles that arrive per second.
    TripCompletionRate,
    /// Time in the network.
    TripTime,
    /// Time of standing.
    TripDelay,
    /// Time in the network or waiting to enter it, over all vehicles.
    TripDuration,
    /// Time in the network of the vehicles that arrived.
    FinishedTripTime,
    /// Time of waiting to enter and of standing, over all vehicles.
    WaitingTime,
    /// Time lost against driving as fast as allowed.
    TimeLoss,
    /// Time lost, waiting to enter included, over all vehicles.
    TotalDelay,
    /// Times of coming to stand.
    Stops,
    /// Time of waiting to enter.
    DepartDelay,
    /// Carbon dioxide given off.
    Co2,
    /// Fuel used.
    Fuel,
}

impl Metric {
    /// The six metrics that papers report.
    pub const PAPER: [Self; 6] = [
        Self::QueueLength,
        Self::Speed,
        Self::TripCompletionRate,
        Self::TripTime,
        Self::TripDelay,
        Self::TripDuration,
    ];

    /// All metrics.
    pub const ALL: [Self; 14] = [
        Self::QueueLength,
        Self::Speed,
        Self::TripCompletionRate,
        Self::TripTime,
        Self::TripDelay,
        Self::TripDuration,
        Self::FinishedTripTime,
        Self::WaitingTime,
        Self::TimeLoss,
        Self::TotalDelay,
        Self::Stops,
        Self::DepartDelay,
        Self::Co2,
        Self::Fuel,
    ];

    /// What it is, in words.
    #[must_use]
    pub fn definition(self) -> &'static Definition {
        match self {
            Self::QueueLength => &definition::QUEUE_LENGTH,
            Self::Speed => &definition::SPEED,
            Self::TripCompletionRate => &definition::TRIP_COMPLETION_RATE,
            Self::TripTime => &definition::TRIP_TIME,
            Self::TripDelay => &definition::TRIP_DELAY,
            Self::TripDuration => &definition::TRIP_DURATION,
            Self::FinishedTripTime => &definition::FINISHED_TRIP_TIME,
            Self::WaitingTime => &definition::WAITING_TIME,
            Self::TimeLoss => &definition::TIME_LOSS,
            Self::TotalDelay => &definition::TOTAL_DELAY,
            Self::Stops => &definition::STOPS,
            Self::DepartDelay => &definition::DEPART_DELAY,
            Self::Co2 => &definition::CO2,
            Self::Fuel => &definition::FUEL,
        }
    }

    /// The metric with this key.
    #[must_use]
    pub fn from_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|metric| metric.key() == key)
    }

    /// Key in JSON.
    #[must_use]
    pub fn key(self) -> &'static str {
        self.definition().key
    }

    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.definition().name
    }

    /// Unit in tables.
    #[must_use]
    pub fn unit(self) -> &'static str {
        self.definition().unit
    }

    /// What its mean is the mean of.
    #[must_use]
    pub fn formula(self) -> &'static str {
        self.definition().formula
    }

    /// What of SUMO's it is computed from.
    #[must_use]
    pub fn source(self) -> &'static str {
        self.definition().source
    }

    /// Which way it improves.
    #[must_use]
    pub fn better(self) -> Better {
        match self {
            Self::Speed | Self::TripCompletionRate => Better::Higher,
            _ => Better::Lower,
        }
    }

    /// Digits after the decimal point in tables: those that differ between seeds.
    #[must_use]
    pub fn digits(self) -> usize {
        match self {
            Self::QueueLength | Self::TripCompletionRate => 3,
            Self::Speed | Self::Stops => 2,
            _ => 1,
        }
    }
}
