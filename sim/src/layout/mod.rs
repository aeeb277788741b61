//! What is fixed about a network's intersections: lanes, movements, phases, roads.
//!
//! ```text
//!   NetworkLayout ── Intersection (agent) ── lanes: incoming first, then outgoing
//!                                         ├─ movements: links of the signal, in link order (in lane -> out lane)
//!                                         ├─ phases: green states of the net's own program, in order
//!                                         └─ roads: incoming and outgoing, with what the topology vector needs
//! ```
//! A [`NetworkLayout`] is read from the net alone, so that learner and actors compute the same one independently; its
//! [hash](NetworkLayout::hash) is what they compare when an actor joins.

mod error;
mod extract;
mod load;
mod stretches;

pub use error::LayoutError;
pub use extract::FixedSignal;
pub use load::load_layout;
pub(crate) use load::read;

use serde::Serialize;
use sha2::{Digest, Sha256};

/// A lane that a signal controls or feeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lane {
    /// SUMO lane id.
    pub id: String,
    /// Length, metres.
    pub length: f32,
    /// Speed limit, m/s.
    pub speed: f32,
    /// Of an incoming lane: lanes that lead to its road alone, those that lead to theirs alone, and so on, with no signal between.
    // Not written where there are none, so that networks without them keep their hash.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub behind: Vec<Stretch>,
    /// Of an outgoing lane: lanes of the one road that it leads to, and so on, up to a signal or a lane that leads to several
    /// roads.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub beyond: Vec<Stretch>,
}

impl Lane {
    /// A lane with nothing behind or beyond it; metres and m/s.
    #[must_use]
    pub fn new(id: impl Into<String>, length: f32, speed: f32) -> Self {
        Self { id: id.into(), length, speed, behind: Vec::new(), beyond: Vec::new() }
    }

    /// Length of all that is counted with it, metres.
    #[must_use]
    pub fn reach(&self) -> f32 {
        let far =
            |stretches: &[Stretch]| stretches.iter().map(|own| own.metres + own.length).fold(0.0, f32::max);
        self.length.max(far(&self.behind)) + far(&self.beyond)
    }
}

/// A lane that is a part of the same street as an intersection's own lane.
///
/// A map of a real town cuts a street into edges wherever something about it changes, so that the last one before a stop line may
/// be a few metres long: whoever waits for its green stands on the lanes behind it. So may the first one after it: a queue that
/// comes back from the next signal is seen on the lanes beyond it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stretch {
    /// SUMO lane id.
    pub id: String,
    /// Length, metres.
    pub length: f32,
    /// From its end to the stop line, or to the end of all that is beyond the outgoing lane, metres; what lies inside junctions
    /// between them is not counted.
    pub metres: f32,
}

/// A lane-to-lane link of the signal (paper, definition 2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Movement {
    /// Index into [`Intersection::incoming`].
    pub incoming: usize,
    /// Index into [`Intersection::outgoing`].
    pub outgoing: usize,
    /// Whether it turns round, back along the road that it came from. SUMO's networks have such links at many junctions, and
    /// hardly a vehicle takes them.
    // Not written where it is false, so that networks without such links keep their hash.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub turnaround: bool,
}

impl Movement {
    /// A movement onwards, between an incoming and an outgoing lane.
    #[must_use]
    pub fn new(incoming: usize, outgoing: usize) -> Self {
        Self { incoming, outgoing, turnaround: false }
    }
}

/// A green phase (paper, definition 3).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Phase {
    /// SUMO signal state string, one letter per link index.
    pub state: String,
    /// For each movement: 1 protected green (`G`), 0.5 permissive (`g`), 0 otherwise.
    pub green: Vec<f32>,
}

/// A road (SUMO edge) at an intersection, for the topology vector.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Road {
    /// SUMO edge id.
    pub id: String,
    /// Mean length of its lanes, metres.
    pub length: f32,
    /// Speed limit, m/s.
    pub speed: f32,
    /// Number of lanes.
    pub lanes: usize,
    /// Number of movements that start (incoming) or end (outgoing) on it.
    pub movements: usize,
}

/// One agent: a signalised intersection (one SUMO `tlLogic`).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Intersection {
    /// SUMO traffic light id.
    pub id: String,
    /// Position of the junction in the net, metres.
    pub position: (f32, f32),
    /// Distinct incoming lanes, in order of their first link.
    pub incoming: Vec<Lane>,
    /// Distinct outgoing lanes, in order of their first link.
    pub outgoing: Vec<Lane>,
    /// Movements in link order.
    pub movements: Vec<Movement>,
    /// Green phases in program order.
    pub phases: Vec<Phase>,
    /// Roads that lead in, in order of their first link.
    pub roads_in: Vec<Road>,
    /// Roads that lead out, in order of their first link.
    pub roads_out: Vec<Road>,
}

impl Intersection {
    /// Incoming plus outgoing lanes: the rows of this agent's observation.
    #[must_use]
    pub fn lanes(&self) -> usize {
        self.incoming.len() + self.outgoing.len()
    }
}

/// All agents of a scenario, in the net's order of traffic lights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NetworkLayout {
    /// Agents.
    pub intersections: Vec<Intersection>,
}

impl NetworkLayout {
    /// Number of agents N.
    #[must_use]
    pub fn agents(&self) -> usize {
        self.intersections.len()
    }

    /// Lane rows of all agents together: an observation holds this many times the number of bands counts.
    #[must_use]
    pub fn lane_rows(&self) -> usize {
        self.intersections.iter().map(Intersection::lanes).sum()
    }

    /// 16 hex digits of SHA-256 over everything in the layout.
    #[must_use]
    pub fn hash(&self) -> String {
        // Plain data serialises.
        let json = serde_json::to_vec(self).expect("a layout serialises");
        hex::encode(&Sha256::digest(json)[..8])
    }
}
