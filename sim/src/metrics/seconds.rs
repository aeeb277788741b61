//! What is measured each simulated second: queue length, speed, arrivals, teleports.

use super::moments::{MeanStd, Moments};
use crate::env::{SecondObserver, SecondView};

/// Seconds over which arrivals are summed for the deviation of the trip completion rate.
const RATE_BLOCK_SECONDS: u32 = 10;
/// Seconds at the end of an episode without one arrival, vehicles running all the while, that are called a gridlock.
const GRIDLOCK_SECONDS: u32 = 300;

/// Collects the per-second metrics of one episode.
#[derive(Debug, Clone, Default)]
pub struct SecondMeter {
    queue: Moments,
    speed: Moments,
    arrived: u64,
    departed: u64,
    teleports: u64,
    block: Block,
    block_rate: Moments,
    seconds: u32,
    seconds_without_arrival: u32,
}

/// Arrivals of a block of seconds that is not over yet.
#[derive(Debug, Clone, Copy, Default)]
struct Block {
    seconds: u32,
    arrived: u32,
}

impl SecondMeter {
    /// Stopped vehicles on a signalised incoming lane, whole lane, vehicles.
    #[must_use]
    pub fn queue_length(&self) -> MeanStd {
        self.queue.mean_std()
    }

    /// Mean speed of the running vehicles, m/s.
    #[must_use]
    pub fn speed(&self) -> MeanStd {
        self.speed.mean_std()
    }

    /// Arrivals per second; the deviation is that of the rates of blocks of 10 s, the last partial block left out.
    #[must_use]
    pub fn trip_completion_rate(&self) -> MeanStd {
        let mean = if self.seconds == 0 { 0.0 } else { self.arrived as f64 / f64::from(self.seconds) };
        MeanStd { mean, std: self.block_rate.mean_std().std }
    }

    /// Vehicles that arrived.
    #[must_use]
    pub fn arrived(&self) -> u64 {
        self.arrived
    }

    /// Vehicles that entered the network.
    #[must_use]
    pub fn departed(&self) -> u64 {
        self.departed
    }

    /// Teleports that began; one vehicle may teleport more than once.
    #[must_use]
    pub fn teleports(&self) -> u64 {
        self.teleports
    }

    /// Seconds that were seen.
    #[must_use]
    pub fn seconds(&self) -> u32 {
        self.seconds
    }

    /// Whether traffic had come to rest: no vehicle arrived in the last 300 s although some were running all the while.
    ///
    /// An episode shorter than twice that is never called a gridlock, since its first vehicles may still be on the way.
    #[must_use]
    pub fn gridlock(&self) -> bool {
        self.seconds >= 2 * GRIDLOCK_SECONDS && self.seconds_without_arrival >= GRIDLOCK_SECONDS
    }
}

impl SecondObserver for SecondMeter {
    fn second(&mut self, view: &SecondView<'_>) {
        self.seconds += 1;
        let lanes = view.lanes.signalised_incoming();
        // A layout has an intersection and each has an incoming lane; without any there is no queue to speak of.
        let number = lanes.len().max(1) as f64;
        let stopped: u64 = lanes.map(|lane| u64::from(lane.stopped)).sum();
        self.queue.add(stopped as f64 / number);
        self.speed.add(view.mean_speed);
        self.arrived += u64::from(view.arrived);
        self.departed += u64::from(view.departed);
        self.teleports += u64::from(view.teleports);
        self.seconds_without_arrival =
            if view.arrived > 0 || view.running == 0 { 0 } else { self.seconds_without_arrival + 1 };

        self.block.seconds += 1;
        self.block.arrived += view.arrived;
        if self.block.seconds == RATE_BLOCK_SECONDS {
            self.block_rate.add(f64::from(self.block.arrived) / f64::from(RATE_BLOCK_SECONDS));
            self.block = Block::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::LaneTable;
    use crate::layout::{Intersection, Lane, Movement, NetworkLayout, Phase};

    fn lanes() -> LaneTable {
        let lane = |id: &str| Lane::new(id, 100.0, 10.0);
        let layout = NetworkLayout {
            intersections: vec![Intersection {
                id: "a".to_owned(),
                position: (0.0, 0.0),
                incoming: vec![lane("in_0"), lane("in_1")],
                outgoing: vec![lane("out")],
                movements: vec![Movement::new(0, 0), Movement::new(1, 0)],
                phases: vec![Phase { state: "GG".to_owned(), green: vec![1.0, 1.0] }],
                roads_in: Vec::new(),
                roads_out: Vec::new(),
            }],
        };
        LaneTable::new(&layout, 50.0)
    }

    fn view(lanes: &LaneTable, arrived: u32, running: u32) -> SecondView<'_> {
        SecondView {
            time: 0.0,
            lanes,
            running,
            mean_speed: 2.5,
            arrived,
            departed: 1,
            teleports: 2,
            waiting_to_enter: 0,
        }
    }

    #[test]
    fn queue_is_per_signalised_incoming_lane() {
        let mut lanes = lanes();
        let mut meter = SecondMeter::default();
        meter.second(&view(&lanes, 0, 0));
        lanes.add("in_0", 5.0, 0.0);
        lanes.add("in_1", 99.0, 0.05);
        lanes.add("in_1", 50.0, 0.0);
        // Neither moving vehicles nor those on outgoing or unknown lanes queue at a signal.
        lanes.add("in_1", 10.0, 0.1);
        lanes.add("out", 10.0, 0.0);
        lanes.add(":junction_0", 1.0, 0.0);
        meter.second(&view(&lanes, 0, 6));
        assert_eq!(meter.queue_length(), MeanStd { mean: 0.75, std: 0.75 });
        assert_eq!(meter.speed(), MeanStd { mean: 2.5, std: 0.0 });
        assert_eq!((meter.seconds(), meter.departed(), meter.teleports()), (2, 2, 4));
    }

    #[test]
    fn completion_rate_deviates_over_blocks_of_ten_seconds() {
        let lanes = lanes();
        let mut meter = SecondMeter::default();
        // Blocks of 10 and 0 arrivals, and half a block that counts only for the mean.
        for second in 0..25 {
            meter.second(&view(&lanes, u32::from(!(10..20).contains(&second)), 1));
        }
        assert_eq!(meter.arrived(), 15);
        assert_eq!(meter.trip_completion_rate(), MeanStd { mean: 0.6, std: 0.5 });
    }

    #[test]
    fn gridlock_is_a_long_end_without_arrivals_on_a_network_with_vehicles() {
        let lanes = lanes();
        let run = |arrivals: &dyn Fn(u32) -> u32, running: u32, seconds: u32| {
            let mut meter = SecondMeter::default();
            for second in 0..seconds {
                meter.second(&view(&lanes, arrivals(second), running));
            }
            meter.gridlock()
        };
        assert!(run(&|second| u32::from(second < 300), 5, 600));
        assert!(!run(&|second| u32::from(second < 301), 5, 600), "one arrival within the last 300 s");
        assert!(!run(&|_| 0, 5, 599), "too short to tell");
        assert!(!run(&|_| 0, 0, 3600), "an empty network is not locked");
    }

    #[test]
    fn an_episode_without_seconds_measures_nothing() {
        let meter = SecondMeter::default();
        assert_eq!(meter.trip_completion_rate(), MeanStd::default());
        assert!(!meter.gridlock());
    }
}
