//! Signal timing: which state strings to show, and when.
//!
//! ```text
//!   decision ──[changed: yellow of the old green]── yellow_seconds ──[changed: new green]── rest ── next decision
//! ```
//! Plain code without I/O: [`SignalTiming::decide`] returns [`Command`]s, the environment carries them out. A signal whose
//! phase does not change shows the same green throughout.

use crate::layout::NetworkLayout;

/// What to do next with the simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command<'a> {
    /// Show a state string.
    Show {
        /// Agent whose signal it is.
        agent: usize,
        /// One letter per link index.
        state: &'a str,
    },
    /// Let so many seconds pass.
    Run {
        /// Simulated seconds, at least 1.
        seconds: u32,
    },
}

/// Actions that cannot be carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ActionError {
    /// Not one action for each agent.
    #[error("got {given} actions for {agents} agents; give one for each")]
    Length {
        /// Number of actions.
        given: usize,
        /// Number of agents.
        agents: usize,
    },
    /// A phase that the agent does not have.
    #[error("agent {agent} has {phases} phases, numbered from 0, and cannot take action {action}")]
    Range {
        /// Index of the agent.
        agent: usize,
        /// The action.
        action: u8,
        /// How many phases it has.
        phases: usize,
    },
}

/// The signals of a network.
#[derive(Debug, Clone)]
pub struct SignalTiming {
    decision_seconds: u32,
    yellow_seconds: u32,
    lights: Vec<Light>,
    current: Vec<u8>,
    previous: Vec<u8>,
}

#[derive(Debug, Clone)]
struct Light {
    green: Vec<String>,
    /// Yellow that ends the green phase of the same index.
    yellow: Vec<String>,
}

impl SignalTiming {
    /// Timing for a layout: seconds between decisions, and of yellow inside them when a phase changes (0: none).
    #[must_use]
    pub fn new(layout: &NetworkLayout, decision_seconds: u32, yellow_seconds: u32) -> Self {
        let light = |phases: &[crate::layout::Phase]| Light {
            green: phases.iter().map(|phase| phase.state.clone()).collect(),
            yellow: phases.iter().map(|phase| yellow(&phase.state)).collect(),
        };
        Self {
            decision_seconds,
            yellow_seconds,
            lights: layout.intersections.iter().map(|intersection| light(&intersection.phases)).collect(),
            current: vec![0; layout.agents()],
            previous: vec![0; layout.agents()],
        }
    }

    /// Starts an episode: every agent shows its phase 0, at once and without yellow.
    pub fn reset(&mut self) -> impl Iterator<Item = Command<'_>> {
        self.current.fill(0);
        self.lights
            .iter()
            .enumerate()
            .filter_map(|(agent, light)| Some(Command::Show { agent, state: light.green.first()? }))
    }

    /// Current green phase of each agent.
    #[must_use]
    pub fn phases(&self) -> &[u8] {
        &self.current
    }

    /// Notes what a light shows that somebody else sets: its phase, if it is one; else the phase before stays.
    pub fn follow(&mut self, agent: usize, state: &str) {
        let Some(light) = self.lights.get(agent) else { return };
        // A layout has at most 255 phases an agent.
        let phase = (0_u8..).zip(&light.green).find(|(_, green)| *green == state);
        if let (Some((phase, _)), Some(current)) = (phase, self.current.get_mut(agent)) {
            *current = phase;
        }
    }

    /// Takes one action, a phase index, for each agent, and says how to get from this decision to the next.
    ///
    /// # Errors
    /// [`ActionError`] for a wrong number of actions or a phase that does not exist; nothing has changed then.
    pub fn decide(&mut self, actions: &[u8]) -> Result<impl Iterator<Item = Command<'_>>, ActionError> {
        if actions.len() != self.lights.len() {
            return Err(ActionError::Length { given: actions.len(), agents: self.lights.len() });
        }
        for (agent, (light, &action)) in self.lights.iter().zip(actions).enumerate() {
            let phases = light.green.len();
            if usize::from(action) >= phases {
                return Err(ActionError::Range { agent, action, phases });
            }
        }
        self.previous.copy_from_slice(&self.current);
        self.current.copy_from_slice(actions);
        let with_yellow = self.yellow_seconds > 0 && self.previous != self.current;
        let yellow_seconds = if with_yellow { self.yellow_seconds } else { 0 };
        let yellows = self
            .changes()
            .filter(move |_| with_yellow)
            .map(|(agent, light, from, _)| Command::Show { agent, state: &light.yellow[from] });
        let greens =
            self.changes().map(|(agent, light, _, to)| Command::Show { agent, state: &light.green[to] });
        let run = |seconds: u32| (seconds > 0).then_some(Command::Run { seconds });
        let rest = self.decision_seconds.saturating_sub(yellow_seconds);
        Ok(yellows.chain(run(yellow_seconds)).chain(greens).chain(run(rest)))
    }

    /// Agent, light, old and new phase of every agent that changes.
    fn changes(&self) -> impl Iterator<Item = (usize, &Light, usize, usize)> {
        let phases = self.previous.iter().zip(&self.current);
        self.lights
            .iter()
            .zip(phases)
            .enumerate()
            .filter(|(_, (_, (from, to)))| from != to)
            .map(|(agent, (light, (&from, &to)))| (agent, light, usize::from(from), usize::from(to)))
    }
}

/// The yellow that ends a green state: whatever was not red turns yellow, right turns on red (`s`) included, because
/// they too have to clear before cross traffic starts.
#[must_use]
pub fn yellow(green: &str) -> String {
    green.chars().map(|letter| if letter == 'r' { 'r' } else { 'y' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{Intersection, Phase};

    fn layout(states: &[&[&str]]) -> NetworkLayout {
        let intersection = |states: &&[&str]| Intersection {
            id: String::new(),
            position: (0.0, 0.0),
            incoming: vec![],
            outgoing: vec![],
            movements: vec![],
            phases: states.iter().map(|state| Phase { state: (*state).to_owned(), green: vec![] }).collect(),
            roads_in: vec![],
            roads_out: vec![],
        };
        NetworkLayout { intersections: states.iter().map(intersection).collect() }
    }

    fn two_lights() -> SignalTiming {
        SignalTiming::new(&layout(&[&["Ggrs", "rrGG"], &["Gr", "rG", "gg"]]), 10, 3)
    }

    #[test]
    fn yellow_spares_only_red() {
        assert_eq!(yellow("GgrsuyoO"), "yyryyyyy");
        assert_eq!(yellow(""), "");
    }

    #[test]
    fn reset_shows_phase_zero_everywhere_without_yellow() {
        let mut timing = two_lights();
        assert_eq!(timing.decide(&[1, 2]).unwrap().count(), 6);
        let commands: Vec<_> = timing.reset().collect();
        let expected = [Command::Show { agent: 0, state: "Ggrs" }, Command::Show { agent: 1, state: "Gr" }];
        assert_eq!(commands, expected);
        assert_eq!(timing.phases(), [0, 0]);
    }

    #[test]
    fn an_unchanged_decision_only_passes_time() {
        let mut timing = two_lights();
        let commands: Vec<_> = timing.decide(&[0, 0]).unwrap().collect();
        assert_eq!(commands, [Command::Run { seconds: 10 }]);
    }

    #[test]
    fn only_the_light_that_changes_turns_yellow() {
        let mut timing = two_lights();
        let commands: Vec<_> = timing.decide(&[0, 2]).unwrap().collect();
        let expected = [
            Command::Show { agent: 1, state: "yr" },
            Command::Run { seconds: 3 },
            Command::Show { agent: 1, state: "gg" },
            Command::Run { seconds: 7 },
        ];
        assert_eq!(commands, expected);
        assert_eq!(timing.phases(), [0, 2]);
        // The next change leaves from the phase now shown.
        assert_eq!(timing.decide(&[0, 1]).unwrap().next(), Some(Command::Show { agent: 1, state: "yy" }));
    }

    #[test]
    fn without_yellow_the_green_changes_at_once() {
        let mut timing = SignalTiming::new(&layout(&[&["Gr", "rG"]]), 5, 0);
        let commands: Vec<_> = timing.decide(&[1]).unwrap().collect();
        assert_eq!(commands, [Command::Show { agent: 0, state: "rG" }, Command::Run { seconds: 5 }]);
    }

    #[test]
    fn a_light_that_somebody_else_sets_is_followed_from_green_to_green() {
        let mut timing = two_lights();
        for (state, phase) in [("rG", 1), ("ry", 1), ("rr", 1), ("gg", 2), ("Gr", 0)] {
            timing.follow(1, state);
            assert_eq!(timing.phases(), [0, phase], "{state}");
        }
        // A light that does not exist is none of ours.
        timing.follow(7, "Gr");
    }

    #[test]
    fn impossible_actions_change_nothing() {
        let mut timing = two_lights();
        let length = timing.decide(&[1]).err();
        assert_eq!(length, Some(ActionError::Length { given: 1, agents: 2 }));
        let range = timing.decide(&[1, 3]).err();
        assert_eq!(range, Some(ActionError::Range { agent: 1, action: 3, phases: 3 }));
        assert_eq!(timing.phases(), [0, 0]);
    }
}
