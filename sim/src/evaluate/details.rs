//! What a report page draws of an evaluation beyond its means: curves over time, every trip, every intersection, and the
//! network to draw them on. Only there when [`Setting::details`](super::Setting::details) asked for it.

use serde::{Deserialize, Serialize};

/// Seconds over which [`Series`] averages.
pub const SERIES_INTERVAL_SECONDS: u32 = 10;

/// The details of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Details {
    /// The network that all its episodes were in.
    pub network: NetworkDrawing,
    /// One entry for each seed, in the order of [`EvalReport::seeds`](super::EvalReport::seeds).
    pub seeds: Vec<SeedDetails>,
}

/// Roads and signals as lines and points, metres eastward and northward in the net's own coordinates.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct NetworkDrawing {
    /// Ordinary edges, in the net's order.
    pub edges: Vec<EdgeDrawing>,
    /// Agents, in layout order; the order of [`SeedDetails::intersections`].
    pub signals: Vec<SignalDrawing>,
}

/// An edge of a [`NetworkDrawing`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EdgeDrawing {
    /// SUMO edge id.
    pub id: String,
    /// Number of lanes.
    pub lanes: u32,
    /// Centre line of its middle lane in driving direction, points `[x, y]`, metres; empty if the net does not tell.
    pub shape: Vec<[f64; 2]>,
}

/// An agent of a [`NetworkDrawing`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SignalDrawing {
    /// SUMO traffic light id.
    pub id: String,
    /// Metres eastward.
    pub x: f64,
    /// Metres northward.
    pub y: f64,
}

/// The details of one episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeedDetails {
    /// SUMO's seed.
    pub seed: u32,
    /// Curves over time.
    pub series: Series,
    /// Every vehicle.
    pub trips: Trips,
    /// Every agent, in the order of [`NetworkDrawing::signals`].
    pub intersections: Vec<IntersectionDetails>,
}

/// Curves over time: entry `i` is about the seconds `i * interval_seconds` to `(i + 1) * interval_seconds` of the episode,
/// the last one about what is left. All arrays are of one length; means are rounded to four decimals.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Series {
    /// Seconds of an entry.
    pub interval_seconds: u32,
    /// Mean queue length, stopped vehicles per signalised incoming lane.
    pub queue_length: Vec<f64>,
    /// Mean over seconds of the mean speed of the vehicles in the network, m/s; a second without vehicles counts as 0.
    pub speed: Vec<f64>,
    /// Mean number of vehicles in the network.
    pub running: Vec<f64>,
    /// Mean number of vehicles that are due but find no room to enter.
    pub waiting_to_enter: Vec<f64>,
    /// Vehicles that reached their destination.
    pub arrived: Vec<u32>,
}

/// Every vehicle of an episode, by what became of it; in the order of SUMO's trip output.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Trips {
    /// Those that reached their destination.
    pub finished: TripTimes,
    /// Those still in the network at the end; their times end there.
    pub unfinished: TripTimes,
    /// Seconds that each vehicle that never found room to enter had waited at the end.
    pub never_inserted: Vec<f64>,
}

/// Times of several vehicles: entry `i` of both arrays is of the same vehicle.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TripTimes {
    /// Seconds from entering to arrival or the end.
    pub trip_time: Vec<f64>,
    /// Seconds of standing among them.
    pub trip_delay: Vec<f64>,
}

/// What happened at one agent, means over the seconds of an episode, rounded to four decimals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IntersectionDetails {
    /// SUMO traffic light id.
    pub id: String,
    /// Stopped vehicles per incoming lane.
    pub queue_length: f64,
    /// Stopped vehicles on all incoming lanes together.
    pub stopped: f64,
    /// Vehicles, stopped or not, on all incoming lanes together.
    pub vehicles: f64,
    /// The incoming roads, in order of their first lane.
    pub roads: Vec<RoadDetails>,
}

/// What happened on one road that leads to an agent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoadDetails {
    /// SUMO edge id, as [`EdgeDrawing::id`].
    pub edge: String,
    /// Stopped vehicles per lane, over the lanes that the agent's signal controls; mean over seconds.
    pub queue_length: f64,
}
