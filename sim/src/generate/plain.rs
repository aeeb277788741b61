//! A road network in SUMO's plain form: what `netconvert` builds a net from.

use super::xml::{XmlFile, number};
use std::io::{self, Write};

/// Nodes, edges, connections and signal programs, in the order in which they are written.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct PlainNet {
    pub(crate) nodes: Vec<Node>,
    pub(crate) edges: Vec<Edge>,
    pub(crate) connections: Vec<Connection>,
    pub(crate) programs: Vec<Program>,
    /// Width of all lanes, metres.
    pub(crate) lane_width: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Node {
    pub(crate) id: String,
    /// Eastward and northward, metres.
    pub(crate) at: (f64, f64),
    pub(crate) kind: NodeKind,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NodeKind {
    Priority,
    Signal,
    /// A signal at which `s` lets vehicles turn right on red after a stop.
    SignalWithRightOnRed,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Edge {
    pub(crate) id: String,
    pub(crate) from: String,
    pub(crate) to: String,
    pub(crate) priority: u32,
    /// Speed limit of each lane, lane 0 outermost, m/s.
    pub(crate) lane_speeds: Vec<f64>,
    /// Points between its ends; empty for a straight edge.
    pub(crate) bends: Vec<(f64, f64)>,
}

/// A lane-to-lane link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Connection {
    pub(crate) from: String,
    pub(crate) from_lane: usize,
    pub(crate) to: String,
    pub(crate) to_lane: usize,
    /// The traffic light that controls it, and its letter in the states.
    pub(crate) signal: Option<(String, usize)>,
}

/// The program of a traffic light.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Program {
    pub(crate) light: String,
    /// Seconds and state, yellows included.
    pub(crate) phases: Vec<(u32, String)>,
}

impl Program {
    /// A program that shows each green state for its seconds, with yellow for what ends between two of them.
    pub(crate) fn with_yellows(light: String, greens: &[(u32, String)], yellow_seconds: u32) -> Self {
        let mut phases = Vec::with_capacity(2 * greens.len());
        for (index, (seconds, state)) in greens.iter().enumerate() {
            phases.push((*seconds, state.clone()));
            let (_, next) = &greens[(index + 1) % greens.len()];
            if let Some(yellow) = yellow(state, next).filter(|_| yellow_seconds > 0) {
                phases.push((yellow_seconds, yellow));
            }
        }
        Self { light, phases }
    }
}

/// The state between two greens; none if nothing that is green ends.
fn yellow(now: &str, next: &str) -> Option<String> {
    let is_green = |letter| matches!(letter, 'G' | 'g');
    let ends = |(now, next): (char, char)| is_green(now) && !is_green(next);
    now.chars()
        .zip(next.chars())
        .any(ends)
        .then(|| now.chars().zip(next.chars()).map(|pair| if ends(pair) { 'y' } else { pair.0 }).collect())
}

impl PlainNet {
    pub(crate) fn write_nodes(&self, target: impl Write) -> io::Result<()> {
        let mut xml = XmlFile::start(target, "nodes")?;
        for node in &self.nodes {
            let kind = match node.kind {
                NodeKind::Priority => "priority",
                NodeKind::Signal => "traffic_light",
                NodeKind::SignalWithRightOnRed => "traffic_light_right_on_red",
            };
            let (x, y) = (number(node.at.0), number(node.at.1));
            xml.element("node", &[("id", &node.id), ("x", &x), ("y", &y), ("type", &kind)])?;
        }
        xml.finish().map(drop)
    }

    pub(crate) fn write_edges(&self, target: impl Write) -> io::Result<()> {
        let mut xml = XmlFile::start(target, "edges")?;
        for edge in &self.edges {
            let limit = edge.lane_speeds.iter().copied().fold(0.0, f64::max);
            let (lanes, speed, width) = (edge.lane_speeds.len(), number(limit), number(self.lane_width));
            let shape = self.shape(edge);
            let mut attributes: Vec<(&str, &dyn std::fmt::Display)> = vec![
                ("id", &edge.id),
                ("from", &edge.from),
                ("to", &edge.to),
                ("priority", &edge.priority),
                ("numLanes", &lanes),
                ("speed", &speed),
                ("width", &width),
            ];
            if !edge.bends.is_empty() {
                attributes.push(("shape", &shape));
            }
            xml.nested("edge", &attributes, |xml| {
                for (index, &speed) in edge.lane_speeds.iter().enumerate() {
                    if speed < limit {
                        xml.element("lane", &[("index", &index), ("speed", &number(speed))])?;
                    }
                }
                Ok(())
            })?;
        }
        xml.finish().map(drop)
    }

    fn shape(&self, edge: &Edge) -> String {
        if edge.bends.is_empty() {
            return String::new();
        }
        let node = |id: &str| self.nodes.iter().find(|node| node.id == id).map(|node| node.at);
        let points = node(&edge.from).into_iter().chain(edge.bends.iter().copied()).chain(node(&edge.to));
        points.map(|(x, y)| format!("{},{}", number(x), number(y))).collect::<Vec<_>>().join(" ")
    }

    pub(crate) fn write_connections(&self, target: impl Write) -> io::Result<()> {
        let mut xml = XmlFile::start(target, "connections")?;
        for connection in &self.connections {
            xml.element(
                "connection",
                &[
                    ("from", &connection.from),
                    ("to", &connection.to),
                    ("fromLane", &connection.from_lane),
                    ("toLane", &connection.to_lane),
                ],
            )?;
        }
        let linked: std::collections::HashSet<_> =
            self.connections.iter().map(|connection| connection.from.as_str()).collect();
        // Without a word about an edge netconvert would guess where it leads.
        for edge in self.edges.iter().filter(|edge| !linked.contains(edge.id.as_str())) {
            xml.element("connection", &[("from", &edge.id)])?;
        }
        xml.finish().map(drop)
    }

    pub(crate) fn write_programs(&self, target: impl Write) -> io::Result<()> {
        let mut xml = XmlFile::start(target, "tlLogics")?;
        for program in &self.programs {
            let attributes: [(&str, &dyn std::fmt::Display); 4] =
                [("id", &program.light), ("type", &"static"), ("programID", &"0"), ("offset", &0)];
            xml.nested("tlLogic", &attributes, |xml| {
                for (seconds, state) in &program.phases {
                    xml.element("phase", &[("duration", seconds), ("state", state)])?;
                }
                Ok(())
            })?;
        }
        for connection in &self.connections {
            let Some((light, index)) = &connection.signal else { continue };
            xml.element(
                "connection",
                &[
                    ("from", &connection.from),
                    ("to", &connection.to),
                    ("fromLane", &connection.from_lane),
                    ("toLane", &connection.to_lane),
                    ("tl", light),
                    ("linkIndex", index),
                ],
            )?;
        }
        xml.finish().map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yellow_is_shown_to_what_ends_and_to_nothing_else() {
        let greens = [(30, "GGrr".to_owned()), (20, "rGgr".to_owned())];
        let program = Program::with_yellows("J".to_owned(), &greens, 3);
        let expected = [(30, "GGrr"), (3, "yGrr"), (20, "rGgr"), (3, "rGyr")];
        assert_eq!(program.phases, expected.map(|(seconds, state)| (seconds, state.to_owned())));
    }

    #[test]
    fn greens_that_only_grow_need_no_yellow() {
        let greens = [(30, "Gr".to_owned()), (20, "GG".to_owned())];
        let phases = Program::with_yellows("J".to_owned(), &greens, 3).phases;
        assert_eq!(phases.len(), 3, "{phases:?}");
    }
}
