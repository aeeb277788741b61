//! An episode's metrics beside the same ones computed from SUMO's outputs.

use super::{EMITTED, Outputs, Trip, attribute, mean_std, number, signalised};
use cross_config::EnvConfig;
use cross_sim::layout::{NetworkLayout, load_layout};
use cross_sim::metrics::{EpisodeMetrics, MeanStd, Metric};
use cross_sim::scenario::Scenario;
use std::collections::{HashMap, HashSet};

const EXACT: f64 = 1e-6;

/// The lanes behind incoming ones: length, and the metres from the end to each stop line.
fn behind(layout: &NetworkLayout) -> HashMap<String, (f64, Vec<f64>)> {
    let mut lanes: HashMap<String, (f64, Vec<f64>)> = HashMap::new();
    for stretch in layout.intersections.iter().flat_map(|agent| &agent.incoming).flat_map(|lane| &lane.behind)
    {
        let entry = lanes.entry(stretch.id.clone()).or_insert((f64::from(stretch.length), Vec::new()));
        entry.1.push(f64::from(stretch.metres));
    }
    lanes
}

/// Our figures of an episode, and the scenario's name for messages.
pub(crate) struct Comparison<'c> {
    pub(crate) of: &'c str,
    pub(crate) ours: &'c EpisodeMetrics,
}

impl Comparison<'_> {
    fn close(&self, ours: f64, theirs: f64, tolerance: f64, what: &str) {
        // Six digits after the point of small figures, and of large ones as many as an f64 carries safely.
        let tolerance = tolerance * theirs.abs().max(1.0);
        assert!((ours - theirs).abs() <= tolerance, "{}, {what}: ours {ours}, SUMO's {theirs}", self.of);
    }

    fn exact(&self, metric: Metric, values: &[f64]) {
        let MeanStd { mean, std } = self.ours.get(metric);
        let (theirs, deviation) = mean_std(values);
        self.close(mean, theirs, EXACT, metric.key());
        self.close(std, deviation, EXACT, &format!("deviation of {}", metric.key()));
    }

    /// Compares everything; `agents` are the signals that we steer.
    pub(crate) fn all(&self, scenario: &Scenario, agents: &[String], seconds: u32, outputs: &Outputs) {
        let begin = f64::from(scenario.begin);
        let end = begin + f64::from(seconds);
        let net = signalised(&std::fs::read_to_string(&scenario.net).unwrap());
        let trips = outputs.trips();
        let layout = load_layout(scenario, &EnvConfig::default()).unwrap();
        self.seconds(&net, agents, (begin, end), &layout, outputs);
        self.trips(&trips);
        self.totals(&trips, seconds, outputs);
        // A vehicle that teleports is recorded each second, though it gives nothing off on its way.
        if self.ours.vehicles.teleports == 0 {
            self.emissions(&trips, end, outputs);
        }
        self.lane_data(&net, agents, &trips, seconds, outputs);
    }

    /// Queue, speed, completions and return from the records of every second.
    fn seconds(
        &self,
        net: &HashMap<String, HashMap<String, f64>>,
        agents: &[String],
        (begin, end): (f64, f64),
        layout: &NetworkLayout,
        outputs: &Outputs,
    ) {
        let lanes = lanes_of(net, agents);
        let seconds = outputs.seconds(begin, end);
        assert_eq!(seconds.len() as f64, end - begin, "{}: SUMO recorded every second", self.of);
        let queue: Vec<_> =
            seconds.iter().map(|second| second.halting(&lanes) as f64 / lanes.len() as f64).collect();
        self.exact(Metric::QueueLength, &queue);

        let config = EnvConfig::default();
        let metres = f64::from(config.reward_range_metres);
        let decisions = seconds
            .chunks_exact(config.decision_seconds as usize)
            .map(|interval| &interval[interval.len() - 1]);
        let behind = behind(layout);
        let (mut stopped, mut least, mut most) = (0, 0, 0);
        for second in decisions {
            stopped += agents.iter().map(|id| second.halting_near(&net[id], metres)).sum::<usize>();
            // A lane that leads to several stop lines has its vehicles counted by turns, so that only bounds are known.
            let (always, ever) = second.halting_behind(&behind, metres);
            (least, most) = (least + always, most + ever);
        }
        let ours = -self.ours.episode_return * agents.len() as f64;
        let theirs = ours.clamp((stopped + least) as f64, (stopped + most) as f64);
        self.close(ours, theirs, EXACT, "return, of all agents, without its sign");

        let summary = outputs.lines("summary.xml", "step");
        let summary = &summary[..seconds.len()];
        // SUMO writes -1 for the mean speed of no vehicles.
        let speed: Vec<_> = summary.iter().map(|step| number(step, "meanSpeed").max(0.0)).collect();
        self.exact(Metric::Speed, &speed);
        let arrived: Vec<_> =
            std::iter::once(0.0).chain(summary.iter().map(|step| number(step, "arrived"))).collect();
        let rate = self.ours.get(Metric::TripCompletionRate);
        self.close(rate.mean, arrived[seconds.len()] / seconds.len() as f64, EXACT, "trip completion rate");
        let blocks: Vec<_> = arrived
            .chunks(10)
            .zip(arrived[10..].chunks(10))
            .map(|(from, to)| (to[0] - from[0]) / 10.0)
            .collect();
        assert_eq!(blocks.len(), seconds.len() / 10);
        self.close(rate.std, mean_std(&blocks).1, EXACT, "deviation of the trip completion rate");
        let last = summary.last().unwrap();
        self.close(self.ours.vehicles.teleports as f64, number(last, "teleports"), 0.0, "teleports");

        let tail = &summary[seconds.len().saturating_sub(300)..];
        let standstill = tail.iter().all(|step| number(step, "running") > 0.0)
            && number(last, "arrived") == arrived[seconds.len().saturating_sub(300)];
        assert_eq!(self.ours.gridlock, seconds.len() >= 600 && standstill, "{}: gridlock", self.of);
    }

    /// Whatever is measured of each vehicle, from the trip output.
    fn trips(&self, trips: &[Trip]) {
        let of = |which: &dyn Fn(&Trip) -> bool, value: &dyn Fn(&Trip) -> f64| -> Vec<f64> {
            trips.iter().filter(|trip| which(trip)).map(value).collect()
        };
        let all = |_: &Trip| true;
        let entered = |trip: &Trip| trip.depart >= 0.0;
        let finished = |trip: &Trip| entered(trip) && trip.arrival >= 0.0;
        self.exact(Metric::TripTime, &of(&entered, &|trip| trip.duration));
        self.exact(Metric::TripDelay, &of(&entered, &|trip| trip.waiting_time));
        self.exact(Metric::TimeLoss, &of(&entered, &|trip| trip.time_loss));
        self.exact(Metric::Stops, &of(&entered, &|trip| trip.stops));
        self.exact(Metric::Co2, &of(&entered, &|trip| trip.emitted[0] / 1000.0));
        self.exact(Metric::Fuel, &of(&entered, &|trip| trip.emitted[1] / 1000.0));
        self.exact(Metric::FinishedTripTime, &of(&finished, &|trip| trip.duration));
        let duration = |trip: &Trip| if entered(trip) { trip.duration } else { trip.depart_delay };
        self.exact(Metric::TripDuration, &of(&all, &duration));
        self.exact(Metric::DepartDelay, &of(&all, &|trip| trip.depart_delay));
        // A vehicle that never entered neither stood nor lost time inside.
        self.exact(Metric::WaitingTime, &of(&all, &|trip| trip.depart_delay + trip.waiting_time));
        self.exact(Metric::TotalDelay, &of(&all, &|trip| trip.depart_delay + trip.time_loss));
        self.close(self.ours.vehicles.finished as f64, of(&finished, &|_| 1.0).len() as f64, 0.0, "finished");
    }

    /// Vehicles and trips from SUMO's own totals.
    fn totals(&self, trips: &[Trip], seconds: u32, outputs: &Outputs) {
        let vehicles = self.ours.vehicles;
        let summary = outputs.lines("summary.xml", "step");
        let last = &summary[seconds as usize - 1];
        self.close(vehicles.finished as f64, number(last, "arrived"), 0.0, "finished");
        self.close(vehicles.unfinished as f64, number(last, "running"), 0.0, "unfinished");
        // SUMO's last attempt to insert is at the beginning of the last second; who is due within that second counts as
        // never inserted, too, but not as waiting yet.
        let due_too_late = trips.iter().filter(|trip| trip.depart < 0.0 && trip.depart_delay < 1.0).count();
        let waiting = number(last, "waiting") + due_too_late as f64;
        self.close(vehicles.never_inserted as f64, waiting, 0.0, "never inserted");

        let totals = &outputs.lines("statistics.xml", "vehicleTripStatistics")[0];
        let count = number(totals, "count");
        self.close((vehicles.finished + vehicles.unfinished) as f64, count, 0.0, "trips");
        let total = number(totals, "totalTravelTime");
        self.close(self.ours.get(Metric::TripTime).mean, total / count, EXACT, "trip time");
        // SUMO gives these as means alone, cut to the milliseconds of its clock, as are the values they are taken of.
        self.close(self.ours.get(Metric::TripDelay).mean, number(totals, "waitingTime"), 2e-3, "trip delay");
        self.close(self.ours.get(Metric::TimeLoss).mean, number(totals, "timeLoss"), 2e-3, "time loss");
    }

    /// CO2 and fuel from what each vehicle gave off each second.
    ///
    /// The record of seconds begins with the one in which a vehicle enters, which its trip does not count, and lacks the
    /// one in which it arrives. So unfinished vehicles agree exactly, finished ones up to one second's emissions.
    fn emissions(&self, trips: &[Trip], end: f64, outputs: &Outputs) {
        let emitted = outputs.emissions(end);
        for (kind, name) in EMITTED.iter().enumerate() {
            let largest = emitted
                .values()
                .flatten()
                .map(|values| values[kind])
                .fold(0.0, f64::max)
                .max(f64::MIN_POSITIVE);
            for trip in trips.iter().filter(|trip| trip.depart >= 0.0) {
                let seconds = emitted.get(&trip.id).map(Vec::as_slice).unwrap_or_default();
                let total: f64 = seconds.iter().skip(1).map(|values| values[kind]).sum();
                let rest = trip.emitted[kind] - total;
                if trip.arrival < 0.0 {
                    self.close(trip.emitted[kind], total, EXACT, &format!("{name} of {}", trip.id));
                } else {
                    let plausible = (-EXACT..=2.0 * largest).contains(&rest);
                    assert!(
                        plausible,
                        "{}: {name} of {} is {rest} off, a second is {largest}",
                        self.of, trip.id
                    );
                }
            }
        }
    }

    /// The queue from SUMO's lane data, the halting seconds on each lane.
    ///
    /// It lacks the second in which a vehicle is inserted, standing, which is added here. It counts a vehicle on a lane until
    /// its rear has left, we until its front has, so that those that stand across a stop line make it more; and it counts
    /// only a part of the second in which a vehicle comes to a lane, which makes it less. Hence a tolerance on either side.
    fn lane_data(
        &self,
        net: &HashMap<String, HashMap<String, f64>>,
        agents: &[String],
        trips: &[Trip],
        seconds: u32,
        outputs: &Outputs,
    ) {
        let lanes = lanes_of(net, agents);
        let on_lanes = |lane: &str| lanes.contains(lane);
        let halting: f64 = outputs
            .lines("lanes.xml", "lane")
            .iter()
            .filter(|lane| on_lanes(attribute(lane, "id").unwrap()))
            .map(|lane| attribute(lane, "waitingTime").map_or(0.0, |time| time.parse().unwrap()))
            .sum();
        let entered = trips
            .iter()
            .filter(|trip| trip.depart >= 0.0 && trip.depart_speed < 0.1 && on_lanes(&trip.depart_lane));
        let theirs = halting + entered.count() as f64;
        let ours = self.ours.get(Metric::QueueLength).mean * f64::from(seconds) * lanes.len() as f64;
        let (low, high) = (theirs * 0.93 - 1.0, theirs * 1.02 + 1.0);
        assert!((low..=high).contains(&ours), "{}: {ours} halting seconds, SUMO's lanes {theirs}", self.of);
    }
}

fn lanes_of(net: &HashMap<String, HashMap<String, f64>>, agents: &[String]) -> HashSet<String> {
    agents.iter().flat_map(|id| net[id].keys().cloned()).collect()
}
