//! Small nets written by hand.
#![allow(dead_code, clippy::unwrap_used, reason = "each test file uses its own part, and may panic")]

use std::fmt::Write;

/// A net with one signalised junction `J`: `lanes_in` incoming lanes on edge `in`, `lanes_out` outgoing ones on edge `out`,
/// and the given `tlLogic` elements and connections.
pub(crate) fn net(lanes_in: usize, lanes_out: usize, programs: &str, connections: &str) -> String {
    let mut text = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<net version=\"1.20\">\n");
    text.push_str("<edge id=\":J_0\" function=\"internal\"><lane id=\":J_0_0\" index=\"0\" speed=\"5\" length=\"9\"/></edge>\n");
    for (edge, from, to, lanes) in [("in", "W", "J", lanes_in), ("out", "J", "E", lanes_out)] {
        writeln!(text, "<edge id=\"{edge}\" from=\"{from}\" to=\"{to}\" priority=\"1\">").unwrap();
        for lane in 0..lanes {
            writeln!(
                text,
                "<lane id=\"{edge}_{lane}\" index=\"{lane}\" speed=\"13.89\" length=\"{}.5\"/>",
                100 + lane
            )
            .unwrap();
        }
        text.push_str("</edge>\n");
    }
    text.push_str(programs);
    for (id, x) in [("W", "-120.0"), ("J", "0.5"), ("E", "120.0")] {
        writeln!(text, "<junction id=\"{id}\" type=\"priority\" x=\"{x}\" y=\"7\" shape=\"0,0\"/>").unwrap();
    }
    text.push_str("<junction id=\":J_0\" type=\"internal\"/>\n");
    text.push_str(connections);
    text.push_str("</net>\n");
    text
}

/// A program `0` of light `id` with these states.
pub(crate) fn program(id: &str, program: &str, states: &[&str]) -> String {
    let mut text = format!("<tlLogic id=\"{id}\" type=\"static\" programID=\"{program}\" offset=\"0\">\n");
    for state in states {
        writeln!(text, "<phase duration=\"10\" state=\"{state}\"/>").unwrap();
    }
    text + "</tlLogic>\n"
}

/// A connection from a lane of `in` to a lane of `out`.
pub(crate) fn link(light: &str, index: usize, from_lane: usize, to_lane: usize) -> String {
    format!(
        "<connection from=\"in\" to=\"out\" fromLane=\"{from_lane}\" toLane=\"{to_lane}\" via=\":J_0_0\" tl=\"{light}\" \
         linkIndex=\"{index}\" dir=\"s\" state=\"o\"/>\n"
    )
}
