//! What a SUMO net says about roads and signals.
//!
//! [`Net::read`] streams a `.net.xml` (or `.net.xml.gz`) once and keeps only what signal control needs: ordinary edges
//! with their lanes, the positions of junctions, traffic light programs, and the connections between them, apart by whether
//! a traffic light controls them.
//! Everything inside junctions (edges whose ids begin with `:`) is skipped.

mod error;
mod reader;

pub use error::NetError;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// A SUMO net, reduced to roads and signals. Everything keeps the order of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct Net {
    /// Where it was read from, as errors name it.
    pub path: PathBuf,
    /// Ordinary edges.
    pub edges: Vec<Edge>,
    /// Junctions outside internal lanes, by id.
    pub junctions: HashMap<String, Junction>,
    /// Traffic lights in order of their first program.
    pub traffic_lights: Vec<TrafficLight>,
    /// Connections between ordinary edges that no traffic light controls, those for turning round left out.
    pub joins: Vec<Join>,
    edge_of_id: HashMap<String, usize>,
}

/// An ordinary edge.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// SUMO edge id.
    pub id: String,
    /// Id of the junction it leads to.
    pub to: String,
    /// Lanes by index, 0 outermost.
    pub lanes: Vec<NetLane>,
}

/// A lane of an ordinary edge.
#[derive(Debug, Clone, PartialEq)]
pub struct NetLane {
    /// SUMO lane id.
    pub id: String,
    /// Length, metres.
    pub length: f64,
    /// Speed limit, m/s.
    pub speed: f64,
    /// Centre line from start to end, metres eastward and northward; empty if the net does not give it.
    pub shape: Vec<[f64; 2]>,
}

/// Position of a junction, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Junction {
    /// Eastward.
    pub x: f64,
    /// Northward.
    pub y: f64,
}

/// A traffic light: its programs and the connections it controls, possibly at several junctions.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrafficLight {
    /// SUMO traffic light id.
    pub id: String,
    /// Programs in file order.
    pub programs: Vec<Program>,
    /// Controlled connections between ordinary edges, by link index, then in file order.
    pub links: Vec<Link>,
}

/// A signal program.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// SUMO program id.
    pub id: String,
    /// Signal states in program order, one letter per link index.
    pub states: Vec<String>,
    /// How long each of these states lasts.
    pub times: Vec<PhaseTimes>,
}

/// How long a program shows a state, seconds; what the net does not say is none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PhaseTimes {
    /// What a program without detectors shows it for.
    pub duration: Option<f64>,
    /// What one with detectors shows it for at least.
    pub shortest: Option<f64>,
    /// What one with detectors shows it for at most.
    pub longest: Option<f64>,
}

/// A connection that a traffic light controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Link {
    /// Position of its letter in the signal states.
    pub index: usize,
    /// Edge and lane it starts from, as indices into [`Net::edges`] and [`Edge::lanes`].
    pub from: (usize, usize),
    /// Edge and lane it leads to.
    pub to: (usize, usize),
    /// Whether it turns round, to where it came from (SUMO's directions `t` and, where traffic keeps left, `T`).
    pub turnaround: bool,
}

/// A connection that no traffic light controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Join {
    /// Edge and lane it starts from, as [`Link::from`].
    pub from: (usize, usize),
    /// Edge and lane it leads to.
    pub to: (usize, usize),
}

impl Net {
    /// Reads a net; compression is recognised by content, not by name.
    ///
    /// # Errors
    /// [`NetError`] names the file and says what is wrong with it: unreadable, cut off, not XML, not a SUMO net, or
    /// contradicting itself.
    pub fn read(path: &Path) -> Result<Self, NetError> {
        reader::read(path)
    }

    /// Parses the text of a net; `path` is how errors call it.
    ///
    /// # Errors
    /// As [`Net::read`].
    pub fn parse(text: impl std::io::BufRead, path: &Path) -> Result<Self, NetError> {
        reader::parse(text, path)
    }

    /// The edge with this id.
    #[must_use]
    pub fn edge(&self, id: &str) -> Option<&Edge> {
        self.edge_of_id.get(id).map(|&index| &self.edges[index])
    }

    /// The lane at an edge and lane index, as [`Link`] holds them.
    #[must_use]
    pub fn lane(&self, (edge, lane): (usize, usize)) -> &NetLane {
        &self.edges[edge].lanes[lane]
    }
}

impl TrafficLight {
    /// The program that defines the phases: `0`, which SUMO's tools write, otherwise the first that has states.
    #[must_use]
    pub fn program(&self) -> Option<&Program> {
        let mut usable = self.programs.iter().filter(|program| !program.states.is_empty());
        let first = usable.clone().next();
        usable.find(|program| program.id == "0").or(first)
    }
}
