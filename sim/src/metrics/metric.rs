//! The list of metrics: key, name, unit and better direction of each.

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
    /// Time lost against driving as fast as allowed.
    TimeLoss,
    /// Times of coming to stand.
    Stops,
    /// Time of waiting to enter.
    DepartDelay,
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
    pub const ALL: [Self; 10] = [
        Self::QueueLength,
        Self::Speed,
        Self::TripCompletionRate,
        Self::TripTime,
        Self::TripDelay,
        Self::TripDuration,
        Self::FinishedTripTime,
        Self::TimeLoss,
        Self::Stops,
        Self::DepartDelay,
    ];

    /// Key in JSON.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::QueueLength => "queue_length",
            Self::Speed => "speed",
            Self::TripCompletionRate => "trip_completion_rate",
            Self::TripTime => "trip_time",
            Self::TripDelay => "trip_delay",
            Self::TripDuration => "trip_duration",
            Self::FinishedTripTime => "finished_trip_time",
            Self::TimeLoss => "time_loss",
            Self::Stops => "stops",
            Self::DepartDelay => "depart_delay",
        }
    }

    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::QueueLength => "queue length",
            Self::Speed => "speed",
            Self::TripCompletionRate => "trip completion rate",
            Self::TripTime => "trip time",
            Self::TripDelay => "trip delay",
            Self::TripDuration => "trip duration",
            Self::FinishedTripTime => "finished trip time",
            Self::TimeLoss => "time loss",
            Self::Stops => "stops",
            Self::DepartDelay => "depart delay",
        }
    }

    /// Unit in tables.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::QueueLength => "veh",
            Self::Speed => "m/s",
            Self::TripCompletionRate => "veh/s",
            Self::Stops => "1",
            Self::TripTime
            | Self::TripDelay
            | Self::TripDuration
            | Self::FinishedTripTime
            | Self::TimeLoss
            | Self::DepartDelay => "s",
        }
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
