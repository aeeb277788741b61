//! Vehicles on lanes: what SUMO reports about each vehicle, folded into counts per lane.
//!
//! ```text
//!   (lane id, position, speed) of each vehicle ── LaneTable::add ──> LaneCounts of each lane ──> observation, reward,
//!                                                                                               controllers, metrics
//! ```
//! Only lanes that a layout names are counted; a lane that leaves one intersection and enters the next has one slot. One with
//! others [behind or beyond](crate::layout::Stretch) it has a second slot, in which their vehicles count too: it is what an agent
//! sees of that lane, while metrics and the field's rules go by lanes as SUMO has them.

use crate::layout::NetworkLayout;
use std::collections::HashMap;
use std::sync::Arc;

/// Below this speed, m/s, a vehicle counts as stopped (SUMO's own threshold for halting).
pub const STOPPED_SPEED: f64 = 0.1;
/// Reach of the paper's detectors before the end of a lane, metres.
pub const NEAR_METRES: f64 = 50.0;
/// End of the second band of [`Detection::Default`](cross_config::Detection::Default), metres before the end of a lane.
pub const MIDDLE_METRES: f64 = 100.0;

/// End of the last but one band of [`Detection::Fine`](cross_config::Detection::Fine) for moving vehicles, metres before the
/// end of a lane: about what a vehicle at 70 km/h drives between two decisions.
pub const FAR_METRES: f64 = 200.0;

/// Vehicles on one lane at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LaneCounts {
    /// Stopped, whole lane.
    pub stopped: u16,
    /// All, whole lane.
    pub total: u16,
    /// Stopped within 50 m of the lane's end.
    pub stopped_near: u16,
    /// All within 50 m of the lane's end.
    pub total_near: u16,
    /// Moving within 100 m of the lane's end.
    pub moving_middle: u16,
    /// Moving within 200 m of the lane's end.
    pub moving_far: u16,
    /// Stopped within the reward's range of the lane's end.
    pub stopped_in_reward_range: u16,
}

impl LaneCounts {
    /// Moving, whole lane.
    #[must_use]
    pub fn moving(&self) -> u16 {
        self.total - self.stopped
    }

    /// Moving within 50 m of the lane's end.
    #[must_use]
    pub fn moving_near(&self) -> u16 {
        self.total_near - self.stopped_near
    }

    fn add_somewhere(&mut self, stopped: bool) {
        bump(&mut self.total, true);
        bump(&mut self.stopped, stopped);
    }

    fn add(&mut self, distance_to_end: f64, stopped: bool, reward_range: f64) {
        self.add_somewhere(stopped);
        let near = distance_to_end <= NEAR_METRES;
        bump(&mut self.total_near, near);
        bump(&mut self.stopped_near, near && stopped);
        bump(&mut self.moving_middle, !stopped && distance_to_end <= MIDDLE_METRES);
        bump(&mut self.moving_far, !stopped && distance_to_end <= FAR_METRES);
        bump(&mut self.stopped_in_reward_range, stopped && distance_to_end <= reward_range);
    }
}

/// A lane never holds 65,535 vehicles; if SUMO ever said so, the count stays at the end of its range.
fn bump(count: &mut u16, condition: bool) {
    *count = count.saturating_add(u16::from(condition));
}

/// Slots of streets that a lane is a part of, each with the metres from the lane's end to the street's.
#[derive(Debug, Clone, Default)]
struct Parts {
    /// Towards a stop line: a vehicle counts in one of them.
    approaches: Vec<(u32, f64)>,
    /// From one on: a vehicle takes up room in all of them.
    exits: Vec<(u32, f64)>,
}

/// Which slot of a [`LaneTable`] belongs to which lane, and to which row of which agent.
#[derive(Debug)]
struct LaneIndex {
    slot_of_id: HashMap<Box<str>, u32>,
    lengths: Vec<f64>,
    /// For each lane the streets that it is a part of.
    parts: Vec<Parts>,
    /// Slot of each lane row of the layout: agents in order, incoming lanes then outgoing ones.
    rows: Vec<u32>,
    /// The same, but slots of streets where there are such.
    seen: Vec<u32>,
    /// For each agent the first row and how many of its rows are incoming; one more entry closes the last agent.
    agents: Vec<(usize, usize)>,
    /// Distinct lanes that enter any agent, in order of their first row.
    incoming: Vec<u32>,
}

impl LaneIndex {
    /// The slot of a lane, a new one if it had none.
    fn slot(&mut self, id: &str, length: f32) -> u32 {
        let next = self.lengths.len() as u32;
        let slot = *self.slot_of_id.entry(id.into()).or_insert(next);
        if slot == next {
            self.lengths.push(f64::from(length));
            self.parts.push(Parts::default());
        }
        slot
    }

    /// Fills [`seen`](Self::seen) and the parts; how many slots of streets there are beyond those of lanes.
    fn find_streets(&mut self, layout: &NetworkLayout) -> usize {
        self.seen.clone_from(&self.rows);
        let lanes = || layout.intersections.iter().flat_map(|at| at.incoming.iter().chain(&at.outgoing));
        for stretch in lanes().flat_map(|lane| lane.behind.iter().chain(&lane.beyond)) {
            self.slot(&stretch.id, stretch.length);
        }
        // Streets come after all lanes. A lane that several lights control, or lead to, has one.
        let first = self.lengths.len();
        let mut streets: HashMap<(u32, bool), u32> = HashMap::new();
        for (row, lane) in lanes().enumerate() {
            let (stretches, incoming) = match (lane.behind.is_empty(), lane.beyond.is_empty()) {
                (true, true) => continue,
                (true, false) => (&lane.beyond, false),
                (false, _) => (&lane.behind, true),
            };
            let slot = self.rows[row];
            let next = (first + streets.len()) as u32;
            let street = *streets.entry((slot, incoming)).or_insert(next);
            self.seen[row] = street;
            if street != next {
                continue;
            }
            let own = lane.reach() - lane.length;
            self.part(slot, incoming, street, if incoming { 0.0 } else { own });
            for stretch in stretches {
                let slot = self.slot(&stretch.id, stretch.length);
                self.part(slot, incoming, street, stretch.metres);
            }
        }
        streets.len()
    }

    fn part(&mut self, lane: u32, incoming: bool, street: u32, metres: f32) {
        let Parts { approaches, exits } = &mut self.parts[lane as usize];
        if incoming { approaches } else { exits }.push((street, f64::from(metres)));
    }
}

/// Counts of every lane that the layout names.
#[derive(Debug, Clone)]
pub struct LaneTable {
    index: Arc<LaneIndex>,
    /// Lanes, then streets.
    counts: Vec<LaneCounts>,
    /// For each lane that is a part of several approaches, which one its next vehicle counts in.
    turns: Vec<u32>,
    reward_range: f64,
}

impl LaneTable {
    /// An empty table for a layout; `reward_range` in metres before the end of a lane.
    #[must_use]
    pub fn new(layout: &NetworkLayout, reward_range: f64) -> Self {
        let mut index = LaneIndex {
            slot_of_id: HashMap::new(),
            lengths: Vec::new(),
            parts: Vec::new(),
            rows: Vec::with_capacity(layout.lane_rows()),
            seen: Vec::new(),
            agents: Vec::with_capacity(layout.agents() + 1),
            incoming: Vec::new(),
        };
        let mut enters = Vec::new();
        for intersection in &layout.intersections {
            index.agents.push((index.rows.len(), intersection.incoming.len()));
            let incoming = intersection.incoming.iter().map(|lane| (lane, true));
            for (lane, is_incoming) in incoming.chain(intersection.outgoing.iter().map(|lane| (lane, false)))
            {
                let slot = index.slot(&lane.id, lane.length);
                enters.resize(index.lengths.len(), false);
                index.rows.push(slot);
                if is_incoming && !std::mem::replace(&mut enters[slot as usize], true) {
                    index.incoming.push(slot);
                }
            }
        }
        index.agents.push((index.rows.len(), 0));
        let streets = index.find_streets(layout);
        let lanes = index.lengths.len();
        let counts = vec![LaneCounts::default(); lanes + streets];
        Self { index: Arc::new(index), counts, turns: vec![0; lanes], reward_range }
    }

    /// Forgets all vehicles.
    pub fn clear(&mut self) {
        self.counts.fill(LaneCounts::default());
        self.turns.fill(0);
    }

    /// Counts one vehicle: lane id, position of its front from the start of the lane in metres, speed in m/s.
    /// A vehicle on a lane that the layout does not name (inside a junction, say) is not counted. Those on a lane that leads to
    /// several incoming lanes count for one of them by turns: which of them each will take is not known.
    /// So it depends on the order of vehicles, which is SUMO's.
    pub fn add(&mut self, lane: &str, position: f64, speed: f64) {
        if let Some(&slot) = self.index.slot_of_id.get(lane) {
            let slot = slot as usize;
            let distance_to_end = self.index.lengths[slot] - position;
            let stopped = speed < STOPPED_SPEED;
            self.counts[slot].add(distance_to_end, stopped, self.reward_range);
            if self.counts.len() == self.turns.len() {
                // Most networks have no streets beside their lanes.
                return;
            }
            let Parts { approaches, exits } = &self.index.parts[slot];
            let mut add = |&(street, metres): &(u32, f64)| {
                self.counts[street as usize].add(distance_to_end + metres, stopped, self.reward_range);
            };
            exits.iter().for_each(&mut add);
            if !approaches.is_empty() {
                let turn = &mut self.turns[slot];
                add(&approaches[*turn as usize % approaches.len()]);
                *turn = turn.wrapping_add(1);
            }
        }
    }

    /// Counts one vehicle of which only the lane is known, in no street but its lane, so that it is in [`LaneCounts::total`] and,
    /// if it is stopped, in [`LaneCounts::stopped`], but in no count of a part of the lane.
    pub fn add_somewhere(&mut self, lane: &str, speed: f64) {
        if let Some(&slot) = self.index.slot_of_id.get(lane) {
            self.counts[slot as usize].add_somewhere(speed < STOPPED_SPEED);
        }
    }

    /// Number of agents.
    #[must_use]
    pub fn agents(&self) -> usize {
        self.index.agents.len() - 1
    }

    /// Counts of one lane row of the layout: agents in order, in each incoming lanes then outgoing ones.
    ///
    /// # Panics
    /// If there are not so many rows.
    #[must_use]
    pub fn row(&self, row: usize) -> &LaneCounts {
        &self.counts[self.index.rows[row] as usize]
    }

    /// Counts of an agent's n-th incoming lane, as [`Movement::incoming`](crate::layout::Movement) numbers them.
    ///
    /// # Panics
    /// If the agent or the lane does not exist.
    #[must_use]
    pub fn incoming(&self, agent: usize, lane: usize) -> &LaneCounts {
        self.row(self.index.agents[agent].0 + lane)
    }

    /// Counts of an agent's n-th outgoing lane, as [`Movement::outgoing`](crate::layout::Movement) numbers them.
    ///
    /// # Panics
    /// If the agent or the lane does not exist.
    #[must_use]
    pub fn outgoing(&self, agent: usize, lane: usize) -> &LaneCounts {
        let (first, incoming) = self.index.agents[agent];
        self.row(first + incoming + lane)
    }

    /// Counts of all rows in layout order.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &LaneCounts> {
        self.index.rows.iter().map(|&slot| &self.counts[slot as usize])
    }

    /// Counts of all rows in layout order as agents see them: with the vehicles behind and beyond their lanes.
    pub fn seen(&self) -> impl ExactSizeIterator<Item = &LaneCounts> {
        self.index.seen.iter().map(|&slot| &self.counts[slot as usize])
    }

    /// The same of the incoming lanes of one agent.
    pub fn seen_incoming_of(&self, agent: usize) -> impl ExactSizeIterator<Item = &LaneCounts> {
        let (first, incoming) = self.index.agents[agent];
        self.index.seen[first..first + incoming].iter().map(|&slot| &self.counts[slot as usize])
    }

    /// Counts of the incoming lanes of one agent.
    pub fn incoming_of(&self, agent: usize) -> impl ExactSizeIterator<Item = &LaneCounts> {
        let (first, incoming) = self.index.agents[agent];
        self.index.rows[first..first + incoming].iter().map(|&slot| &self.counts[slot as usize])
    }

    /// Counts of every signalised incoming lane of the network, each lane once: what queue length is measured on.
    pub fn signalised_incoming(&self) -> impl ExactSizeIterator<Item = &LaneCounts> {
        self.index.incoming.iter().map(|&slot| &self.counts[slot as usize])
    }
}
