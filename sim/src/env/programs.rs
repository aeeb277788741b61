//! SUMO's reactive signal programs, written for a net as an additional file.
//!
//! ```text
//!   net's own program ── phases in order ──> <tlLogic type="actuated" | "delay_based"> for every agent ──> SUMO
//! ```
//! SUMO runs the program of a light that it loaded last. [`follow`] asks it at every decision whether that is ours.

use super::simulation::Simulation;
use super::{Signals, SumoProgram};
use crate::error::SimError;
use crate::generate::xml::{XmlFile, number};
use crate::layout::NetworkLayout;
use crate::net::{Net, PhaseTimes, TrafficLight};
use crate::signal::SignalTiming;
use std::io::{self, Write};
use std::path::PathBuf;
use tempfile::TempDir;

/// Shortest green where the net gives none, seconds; netconvert's default.
const SHORTEST_GREEN: f64 = 5.0;
/// Longest green where the net gives none, seconds; netconvert's default.
const LONGEST_GREEN: f64 = 50.0;

/// SUMO's own defaults, said nevertheless, so that another version's do not change results.
///
/// `detector-gap`: seconds of driving at the speed allowed between detector and stop line. `max-gap`: seconds between two
/// vehicles that end a green. `passing-time`: seconds a vehicle takes to pass, by which queues lengthen the shortest green.
/// `inactive-threshold`: seconds after which a waiting vehicle is served although its detector is silent.
/// `jam-threshold`: seconds of standing after which a vehicle on a detector no longer counts; -1 never.
const ACTUATED: &[(&str, &str)] = &[
    ("detector-gap", "2.0"),
    ("max-gap", "3.0"),
    ("passing-time", "1.9"),
    ("inactive-threshold", "180"),
    ("jam-threshold", "-1"),
];
/// `detectorRange`: metres before the stop line. `minTimeloss`: seconds a vehicle must have lost to count; SUMO reads this
/// spelling, not the one of its manual.
const DELAY_BASED: &[(&str, &str)] = &[("detectorRange", "100"), ("minTimeloss", "1.0")];

/// The file of an environment's program; it goes when this does.
#[derive(Debug)]
pub(super) struct ProgramFile {
    folder: TempDir,
}

impl ProgramFile {
    /// Writes the file that `signals` need, if they need one.
    pub(super) fn write(
        signals: Signals,
        net: &Net,
        layout: &NetworkLayout,
    ) -> Result<Option<Self>, SimError> {
        let Signals::Program(program @ (SumoProgram::Actuated | SumoProgram::DelayBased)) = signals else {
            return Ok(None);
        };
        let lights = agents(net, layout);
        lights.iter().try_for_each(|light| complete(net, light))?;
        let write = || {
            let mut text = Vec::new();
            document(&mut text, program, &lights)?;
            let folder = tempfile::Builder::new().prefix("cross-program-").tempdir()?;
            std::fs::write(folder.path().join(FILE), text)?;
            Ok(Some(Self { folder }))
        };
        write().map_err(|source| SimError::ProgramFile { source })
    }

    /// Where it is.
    pub(super) fn path(&self) -> PathBuf {
        self.folder.path().join(FILE)
    }
}

const FILE: &str = "programs.add.xml";

impl SumoProgram {
    /// What SUMO calls this type of program; none for the net's own, whatever it is.
    fn kind(self) -> Option<&'static str> {
        match self {
            Self::Own => None,
            Self::Actuated => Some("actuated"),
            Self::DelayBased => Some("delay_based"),
        }
    }

    /// What the program is called in SUMO, beside the net's; none for the net's own.
    fn id(self) -> Option<&'static str> {
        match self {
            Self::Own => None,
            Self::Actuated => Some("cross-actuated"),
            Self::DelayBased => Some("cross-delay-based"),
        }
    }

    fn parameters(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Own => &[],
            Self::Actuated => ACTUATED,
            Self::DelayBased => DELAY_BASED,
        }
    }
}

/// The lights of the agents.
fn agents<'n>(net: &'n Net, layout: &NetworkLayout) -> Vec<&'n TrafficLight> {
    let is_agent =
        |light: &&TrafficLight| layout.intersections.iter().any(|intersection| intersection.id == light.id);
    net.traffic_lights.iter().filter(is_agent).collect()
}

/// Every phase needs a length: SUMO would refuse the file with words about a file that nobody knows.
fn complete(net: &Net, light: &TrafficLight) -> Result<(), SimError> {
    let Some(program) = light.program() else { return Ok(()) };
    match program.states.iter().zip(&program.times).find(|(_, times)| times.duration.is_none()) {
        None => Ok(()),
        Some((state, _)) => Err(SimError::ProgramPhase {
            path: net.path.clone(),
            light: light.id.clone(),
            state: state.clone(),
        }),
    }
}

fn document(target: impl Write, program: SumoProgram, lights: &[&TrafficLight]) -> io::Result<()> {
    let (Some(kind), Some(id)) = (program.kind(), program.id()) else { return Ok(()) };
    let mut xml = XmlFile::start(target, "additional")?;
    for light in lights {
        let Some(own) = light.program() else { continue };
        let attributes: [(&str, &dyn std::fmt::Display); 4] =
            [("id", &light.id), ("type", &kind), ("programID", &id), ("offset", &0)];
        xml.nested("tlLogic", &attributes, |xml| {
            for (key, value) in program.parameters() {
                xml.element("param", &[("key", key), ("value", value)])?;
            }
            for (state, times) in own.states.iter().zip(&own.times) {
                phase(xml, state, times)?;
            }
            Ok(())
        })?;
    }
    xml.finish().map(drop)
}

/// Greens may be shortened and lengthened, transitions last as long as in the net.
fn phase<W: Write>(xml: &mut XmlFile<W>, state: &str, times: &PhaseTimes) -> io::Result<()> {
    let duration = times.duration.unwrap_or(SHORTEST_GREEN);
    let text = number(duration);
    if is_transition(state) {
        return xml.element("phase", &[("duration", &text), ("state", &state)]);
    }
    let shortest = times.shortest.unwrap_or(SHORTEST_GREEN.min(duration));
    let longest = times.longest.unwrap_or(LONGEST_GREEN.max(duration)).max(shortest);
    let (shortest, longest) = (number(shortest), number(longest));
    xml.element(
        "phase",
        &[("duration", &text), ("minDur", &shortest), ("maxDur", &longest), ("state", &state)],
    )
}

/// As for agents, whose phases are the others: a state with yellow, or without any green.
fn is_transition(state: &str) -> bool {
    state.contains(['y', 'u']) || !state.contains(['G', 'g'])
}

/// Takes over which phase each light shows, and checks that it runs the program it was given.
///
/// A light that runs another has a plan that switches programs, which an additional file of the scenario can hold.
pub(super) fn follow(
    program: SumoProgram,
    simulation: &mut Simulation,
    layout: &NetworkLayout,
    signals: &mut SignalTiming,
) -> Result<(), SimError> {
    let lights = layout.intersections.iter().map(|intersection| intersection.id.as_str());
    let replies = simulation.programs_and_states(lights)?;
    for (agent, intersection) in layout.intersections.iter().enumerate() {
        let (running, state) = (replies.str(2 * agent)?, replies.str(2 * agent + 1)?);
        if let Some(wanted) = program.id().filter(|wanted| *wanted != running) {
            return Err(SimError::ProgramNotRunning {
                light: intersection.id.clone(),
                wanted: wanted.to_owned(),
                running: running.to_owned(),
            });
        }
        signals.follow(agent, state);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use cross_config::EnvConfig;

    /// A crossing with two greens, a yellow with green in it, an all-red; a light with one green; both on the same lanes.
    fn net(phases: &str) -> (Net, NetworkLayout) {
        let link = |light: &str, index: usize| {
            format!(
                "<connection from=\"in\" to=\"out\" fromLane=\"0\" toLane=\"0\" tl=\"{light}\" linkIndex=\"{index}\"/>"
            )
        };
        let text = format!(
            "<net><edge id=\"in\" to=\"J\"><lane id=\"in_0\" index=\"0\" speed=\"9\" length=\"99\"/></edge>\
             <edge id=\"out\" to=\"K\"><lane id=\"out_0\" index=\"0\" speed=\"9\" length=\"99\"/></edge>\
             <tlLogic id=\"a&amp;b\" programID=\"0\" type=\"static\">{phases}</tlLogic>\
             <tlLogic id=\"one\" programID=\"0\" type=\"static\"><phase duration=\"9\" state=\"G\"/></tlLogic>\
             <junction id=\"J\" x=\"0\" y=\"0\"/>{}{}{}</net>",
            link("a&amp;b", 0),
            link("a&amp;b", 1),
            link("one", 0)
        );
        let net = Net::parse(text.as_bytes(), std::path::Path::new("t.net.xml")).unwrap();
        let layout = NetworkLayout::from_net(&net, &EnvConfig::default()).unwrap();
        (net, layout)
    }

    const PHASES: &str = "<phase duration=\"10\" state=\"Gr\"/><phase duration=\"3\" state=\"yr\"/>\
        <phase duration=\"2\" state=\"rr\"/><phase duration=\"60\" state=\"gG\" minDur=\"7\"/><phase duration=\"4\" state=\"gy\"/>\
        <phase duration=\"3\" state=\"rG\" maxDur=\"20\"/>";

    fn text(program: SumoProgram) -> String {
        let (net, layout) = net(PHASES);
        let file = ProgramFile::write(Signals::Program(program), &net, &layout).unwrap().unwrap();
        std::fs::read_to_string(file.path()).unwrap()
    }

    #[test]
    fn greens_get_a_range_and_transitions_keep_their_length() {
        let text = text(SumoProgram::Actuated);
        let phases: Vec<&str> =
            text.lines().map(str::trim).filter(|line| line.starts_with("<phase")).collect();
        assert_eq!(
            phases,
            [
                "<phase duration=\"10\" minDur=\"5\" maxDur=\"50\" state=\"Gr\"/>",
                "<phase duration=\"3\" state=\"yr\"/>",
                "<phase duration=\"2\" state=\"rr\"/>",
                "<phase duration=\"60\" minDur=\"7\" maxDur=\"60\" state=\"gG\"/>",
                "<phase duration=\"4\" state=\"gy\"/>",
                "<phase duration=\"3\" minDur=\"3\" maxDur=\"20\" state=\"rG\"/>",
            ]
        );
    }

    #[test]
    fn only_agents_are_programmed_with_the_type_and_its_parameters() {
        for (program, kind, parameter) in [
            (SumoProgram::Actuated, "actuated", "<param key=\"max-gap\" value=\"3.0\"/>"),
            (SumoProgram::DelayBased, "delay_based", "<param key=\"detectorRange\" value=\"100\"/>"),
        ] {
            let text = text(program);
            assert_eq!(text.matches("<tlLogic ").count(), 1, "{text}");
            assert!(text.contains(&format!("id=\"a&amp;b\" type=\"{kind}\"")), "{text}");
            assert!(text.contains(parameter), "{text}");
        }
    }

    #[test]
    fn without_a_reactive_program_there_is_no_file() {
        let (net, layout) = net(PHASES);
        for signals in [Signals::Driven, Signals::Program(SumoProgram::Own)] {
            assert!(ProgramFile::write(signals, &net, &layout).unwrap().is_none());
        }
    }

    #[test]
    fn a_phase_of_unknown_length_is_refused_by_light_and_state() {
        let phases = PHASES.replace("duration=\"2\"", "duration=\"00:00:02\"");
        let (net, layout) = net(&phases);
        let error = ProgramFile::write(Signals::Program(SumoProgram::Actuated), &net, &layout)
            .unwrap_err()
            .to_string();
        assert!(error.contains("a&b") && error.contains("\"rr\"") && error.contains("t.net.xml"), "{error}");
        assert!(ProgramFile::write(Signals::Driven, &net, &layout).unwrap().is_none());
    }
}
