//! Watching an episode second by second, for metrics that are defined per second.

use crate::lanes::LaneTable;

/// The network after one simulated second.
#[derive(Debug)]
pub struct SecondView<'a> {
    /// Simulated time, seconds; an episode's first view is one second after its beginning.
    pub time: f64,
    /// Vehicles on the lanes of the layout. In the second that a decision ends with all counts are there; in the others
    /// SUMO is not asked where on its lane a vehicle is, and only [`stopped`](crate::lanes::LaneCounts::stopped) and
    /// [`total`](crate::lanes::LaneCounts::total) count.
    pub lanes: &'a LaneTable,
    /// Vehicles in the network, on any lane.
    pub running: u32,
    /// Mean speed of these vehicles, m/s; 0 when there are none.
    pub mean_speed: f64,
    /// Vehicles that reached their destination in this second.
    pub arrived: u32,
    /// Vehicles that entered the network in this second.
    pub departed: u32,
    /// Vehicles that began to teleport in this second.
    pub teleports: u32,
    /// Vehicles whose departure time has come but which found no room to enter yet.
    pub waiting_to_enter: u32,
}

/// Called by [`Env::step_observed`](crate::env::Env::step_observed) after each simulated second.
pub trait SecondObserver {
    /// Sees the network after one more second.
    fn second(&mut self, view: &SecondView<'_>);
}

impl<F: FnMut(&SecondView<'_>)> SecondObserver for F {
    fn second(&mut self, view: &SecondView<'_>) {
        self(view);
    }
}
