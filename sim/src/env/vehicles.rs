//! All vehicles of one moment: where each is and how fast.
//!
//! SUMO is asked for their ids, then, in one message, for the values of each. That is two round trips where a context
//! subscription around a junction is one, and yet half of its time, since SUMO searches the network for what a subscription
//! finds (docs/performance.md, "Asking for every vehicle").

use crate::lanes::LaneTable;
use cross_traci::constants::{Domain, any, vehicle};
use cross_traci::{Batch, Client, DecodeError, Replies, StrList, TraciError};

/// How closely SUMO is asked where vehicles are. Answering is most of what a look costs, so that a value that nobody reads
/// is not asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Look {
    /// On which lane: enough to count who stands and who is there. For a second between decisions.
    Lanes,
    /// Where on it, too: all counts of a lane. For a decision.
    Positions,
}

impl Look {
    /// What is read of each vehicle, in this order.
    fn wanted(self) -> &'static [u8] {
        match self {
            Self::Lanes => &[vehicle::LANE_ID, vehicle::SPEED],
            Self::Positions => &[vehicle::LANE_ID, vehicle::SPEED, vehicle::LANE_POSITION],
        }
    }
}

/// Vehicles in the network at one moment.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Traffic {
    pub(super) running: u32,
    pub(super) mean_speed: f64,
}

/// The vehicles that SUMO is asked about. Buffers are kept: none is allocated for a vehicle.
#[derive(Debug, Default)]
pub(super) struct Vehicles {
    /// Their ids, one behind the other.
    text: String,
    /// Where each id ends.
    ends: Vec<usize>,
}

impl Vehicles {
    /// Asks for the ids of the vehicles in the network.
    pub(super) fn ask_who(batch: &mut Batch<'_>) {
        batch.get(Domain::Vehicle, any::ID_LIST, "");
    }

    /// Takes over the ids.
    pub(super) fn are(&mut self, ids: StrList<'_>) {
        self.text.clear();
        self.ends.clear();
        for id in ids.iter() {
            self.text.push_str(id);
            self.ends.push(self.text.len());
        }
    }

    /// Number of vehicles.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Has SUMO asked where each is, without waiting for the answer; nothing is sent if there is none.
    pub(super) fn ask(&self, client: &mut Client, look: Look) -> Result<(), TraciError> {
        let mut batch = client.batch();
        let mut start = 0;
        for &end in &self.ends {
            for &variable in look.wanted() {
                batch.get(Domain::Vehicle, variable, &self.text[start..end]);
            }
            start = end;
        }
        batch.post()
    }

    /// Counts the vehicles into a table, which is emptied first. `replies` answer what was [asked](Self::ask) last, and with
    /// this look.
    pub(super) fn count(
        &self,
        look: Look,
        replies: Replies<'_>,
        lanes: &mut LaneTable,
    ) -> Result<Traffic, TraciError> {
        lanes.clear();
        let mut speeds = 0.0;
        for index in (0..self.len()).map(|vehicle| look.wanted().len() * vehicle) {
            let (lane, speed) = (replies.str(index)?, replies.double(index + 1)?);
            match look {
                Look::Lanes => lanes.add_somewhere(lane, speed),
                Look::Positions => lanes.add(lane, replies.double(index + 2)?, speed),
            }
            speeds += speed;
        }
        let running = self.len();
        Ok(Traffic { running: saturating(running), mean_speed: speeds / running.max(1) as f64 })
    }
}

/// The answer where SUMO was asked for ids is no list of them.
pub(super) fn unreadable(source: DecodeError) -> TraciError {
    let command = "reading the traffic".to_owned();
    TraciError::Protocol { command, source, evidence: Box::default() }
}

pub(super) fn saturating(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
