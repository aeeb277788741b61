//! Collects the details of an episode beside its metrics.

use super::details::{IntersectionDetails, RoadDetails, SERIES_INTERVAL_SECONDS, Series};
use crate::env::{SecondObserver, SecondView};
use crate::lanes::LaneCounts;
use crate::layout::{Intersection, NetworkLayout};
use crate::metrics::SecondMeter;

/// Watches an episode: always for its metrics, for its details where a [`DetailMeter`] is there.
#[derive(Debug, Default)]
pub(super) struct Recorder {
    pub(super) metrics: SecondMeter,
    pub(super) details: Option<DetailMeter>,
}

impl SecondObserver for Recorder {
    fn second(&mut self, view: &SecondView<'_>) {
        self.metrics.second(view);
        if let Some(details) = &mut self.details {
            details.second(view);
        }
    }
}

/// Sums of what details are means of.
#[derive(Debug)]
pub(super) struct DetailMeter {
    series: Series,
    interval: Interval,
    seconds: u64,
    /// Stopped and all vehicles, summed over seconds, for each incoming lane of each agent.
    lanes: Vec<Vec<LaneSums>>,
}

#[derive(Debug, Clone, Copy, Default)]
struct LaneSums {
    stopped: u64,
    vehicles: u64,
}

/// Sums over an interval of the series that is not over yet.
#[derive(Debug, Clone, Copy, Default)]
struct Interval {
    seconds: u32,
    queue_length: f64,
    speed: f64,
    running: u64,
    waiting_to_enter: u64,
    arrived: u32,
}

impl DetailMeter {
    pub(super) fn new(layout: &NetworkLayout) -> Self {
        let lanes = |intersection: &Intersection| vec![LaneSums::default(); intersection.incoming.len()];
        Self {
            series: Series { interval_seconds: SERIES_INTERVAL_SECONDS, ..Series::default() },
            interval: Interval::default(),
            seconds: 0,
            lanes: layout.intersections.iter().map(lanes).collect(),
        }
    }

    fn second(&mut self, view: &SecondView<'_>) {
        self.seconds += 1;
        for (agent, sums) in self.lanes.iter_mut().enumerate() {
            for (lane, sum) in view.lanes.incoming_of(agent).zip(sums) {
                sum.stopped += u64::from(lane.stopped);
                sum.vehicles += u64::from(lane.total);
            }
        }
        let signalised = view.lanes.signalised_incoming();
        let number = signalised.len().max(1) as f64;
        let interval = &mut self.interval;
        interval.seconds += 1;
        interval.queue_length += signalised.map(stopped).sum::<u64>() as f64 / number;
        interval.speed += view.mean_speed;
        interval.running += u64::from(view.running);
        interval.waiting_to_enter += u64::from(view.waiting_to_enter);
        interval.arrived += view.arrived;
        if interval.seconds == SERIES_INTERVAL_SECONDS {
            self.close_interval();
        }
    }

    fn close_interval(&mut self) {
        let interval = std::mem::take(&mut self.interval);
        let seconds = f64::from(interval.seconds);
        self.series.queue_length.push(rounded(interval.queue_length / seconds));
        self.series.speed.push(rounded(interval.speed / seconds));
        self.series.running.push(rounded(interval.running as f64 / seconds));
        self.series.waiting_to_enter.push(rounded(interval.waiting_to_enter as f64 / seconds));
        self.series.arrived.push(interval.arrived);
    }

    /// What was seen, for the agents of the layout it was made for.
    pub(super) fn finish(mut self, layout: &NetworkLayout) -> (Series, Vec<IntersectionDetails>) {
        if self.interval.seconds > 0 {
            self.close_interval();
        }
        let seconds = self.seconds.max(1) as f64;
        let agents = layout.intersections.iter().zip(&self.lanes);
        (self.series, agents.map(|(intersection, sums)| details(intersection, sums, seconds)).collect())
    }
}

fn stopped(lane: &LaneCounts) -> u64 {
    u64::from(lane.stopped)
}

fn details(intersection: &Intersection, sums: &[LaneSums], seconds: f64) -> IntersectionDetails {
    let total = |value: fn(&LaneSums) -> u64| sums.iter().map(value).sum::<u64>() as f64 / seconds;
    let stopped = total(|sums| sums.stopped);
    // Edge, its lanes here, its stopped vehicles.
    let mut roads: Vec<(&str, u32, u64)> = Vec::new();
    for (lane, sums) in intersection.incoming.iter().zip(sums) {
        let edge = edge_of(&lane.id);
        match roads.iter_mut().find(|(known, ..)| *known == edge) {
            Some((_, lanes, stopped)) => (*lanes, *stopped) = (*lanes + 1, *stopped + sums.stopped),
            None => roads.push((edge, 1, sums.stopped)),
        }
    }
    let road = |(edge, lanes, stopped): (&str, u32, u64)| RoadDetails {
        edge: edge.to_owned(),
        queue_length: rounded(stopped as f64 / seconds / f64::from(lanes)),
    };
    IntersectionDetails {
        id: intersection.id.clone(),
        queue_length: rounded(stopped / intersection.incoming.len().max(1) as f64),
        stopped: rounded(stopped),
        vehicles: rounded(total(|sums| sums.vehicles)),
        roads: roads.into_iter().map(road).collect(),
    }
}

/// SUMO names a lane after its edge: `edge_index`.
fn edge_of(lane: &str) -> &str {
    lane.rsplit_once('_').map_or(lane, |(edge, _)| edge)
}

/// Four decimals: more than a page shows, and a third of the digits that would otherwise be written.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::LaneTable;
    use crate::layout::Lane;

    fn layout() -> NetworkLayout {
        let lane = |id: &str| Lane::new(id, 100.0, 10.0);
        let intersection = |id: &str, incoming: &[&str]| Intersection {
            id: id.to_owned(),
            position: (0.0, 0.0),
            incoming: incoming.iter().map(|id| lane(id)).collect(),
            outgoing: vec![lane("out_0")],
            movements: Vec::new(),
            phases: Vec::new(),
            roads_in: Vec::new(),
            roads_out: Vec::new(),
        };
        let intersections = vec![intersection("A", &["a_1_0", "b_0", "a_1_1"]), intersection("B", &["c_0"])];
        NetworkLayout { intersections }
    }

    fn run(seconds: u32) -> (Series, Vec<IntersectionDetails>) {
        let layout = layout();
        let mut recorder = Recorder { details: Some(DetailMeter::new(&layout)), ..Recorder::default() };
        let mut lanes = LaneTable::new(&layout, 50.0);
        lanes.add("a_1_0", 90.0, 0.0);
        lanes.add("a_1_1", 90.0, 0.0);
        lanes.add("a_1_1", 50.0, 0.0);
        lanes.add("b_0", 50.0, 3.0);
        for second in 0..seconds {
            recorder.second(&SecondView {
                time: f64::from(second),
                lanes: &lanes,
                running: second,
                mean_speed: 2.0,
                arrived: 1,
                departed: 0,
                teleports: 0,
                waiting_to_enter: 3,
            });
        }
        assert_eq!(recorder.metrics.seconds(), seconds);
        recorder.details.unwrap().finish(&layout)
    }

    #[test]
    fn a_series_has_an_entry_for_each_interval_and_one_for_the_rest() {
        let (series, _) = run(25);
        assert_eq!(series.interval_seconds, 10);
        assert_eq!(series.queue_length, [0.75; 3], "three stopped vehicles on four lanes");
        assert_eq!(series.speed, [2.0; 3]);
        assert_eq!(series.running, [4.5, 14.5, 22.0]);
        assert_eq!(series.waiting_to_enter, [3.0; 3]);
        assert_eq!(series.arrived, [10, 10, 5]);
        assert_eq!(run(20).0.arrived, [10, 10], "no empty rest");
        assert!(run(0).0.arrived.is_empty());
    }

    #[test]
    fn an_intersection_has_its_own_queue_and_that_of_each_road() {
        let (_, intersections) = run(7);
        let [a, b] = intersections.as_slice() else { unreachable!("two agents") };
        assert_eq!((a.id.as_str(), a.queue_length, a.stopped, a.vehicles), ("A", 1.0, 3.0, 4.0));
        let roads: Vec<_> = a.roads.iter().map(|road| (road.edge.as_str(), road.queue_length)).collect();
        assert_eq!(roads, [("a_1", 1.5), ("b", 0.0)]);
        assert_eq!((b.id.as_str(), b.queue_length, b.vehicles), ("B", 0.0, 0.0));
        assert_eq!(run(0).1[0].queue_length, 0.0, "an episode without seconds");
    }
}
