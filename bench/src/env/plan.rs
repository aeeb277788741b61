//! The signal plan of an episode, written out as SUMO's static programs.

use cross_config::EnvConfig;
use cross_sim::layout::NetworkLayout;
use cross_sim::signal::{ActionError, Command, SignalTiming};
use std::fmt::Write;
use std::sync::Arc;

/// What every traffic light showed, and for how long.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    layout: Arc<NetworkLayout>,
    /// Time at which the episode began, seconds.
    begin: u32,
    /// Of every agent its states in turn, each with its seconds.
    shown: Vec<Vec<(u32, String)>>,
}

impl Plan {
    /// The plan that comes of an episode's actions `[steps][agents]`.
    pub(super) fn new(
        layout: &Arc<NetworkLayout>,
        config: &EnvConfig,
        begin: u32,
        actions: &[Vec<u8>],
    ) -> Result<Self, ActionError> {
        let mut timing = SignalTiming::new(layout, config.decision_seconds, config.yellow_seconds);
        let mut now = vec![String::new(); layout.agents()];
        let mut plan = Self { layout: Arc::clone(layout), begin, shown: vec![Vec::new(); layout.agents()] };
        for command in timing.reset() {
            plan.follow(command, &mut now);
        }
        for actions in actions {
            for command in timing.decide(actions)? {
                plan.follow(command, &mut now);
            }
        }
        Ok(plan)
    }

    fn follow(&mut self, command: Command<'_>, now: &mut [String]) {
        match command {
            Command::Show { agent, state } => state.clone_into(&mut now[agent]),
            Command::Run { seconds } => {
                for (shown, now) in self.shown.iter_mut().zip(now) {
                    match shown.last_mut() {
                        Some((length, state)) if state == now => *length += seconds,
                        _ => shown.push((seconds, now.clone())),
                    }
                }
            }
        }
    }

    /// SUMO's additional file.
    pub(super) fn xml(&self) -> String {
        let mut text = String::from("<additional>\n");
        for (intersection, shown) in self.layout.intersections.iter().zip(&self.shown) {
            // The cycle is the whole episode; shifted by its begin, it starts with it. Writing to a string cannot fail.
            let id = escaped(&intersection.id);
            let _ = writeln!(
                text,
                "  <tlLogic id=\"{id}\" type=\"static\" programID=\"replay\" offset=\"{}\">",
                self.begin
            );
            for (seconds, state) in shown {
                let _ = writeln!(text, "    <phase duration=\"{seconds}\" state=\"{state}\"/>");
            }
            text.push_str("  </tlLogic>\n");
        }
        text.push_str("</additional>\n");
        text
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::update::data::{Shape, network};

    #[test]
    fn yellows_and_greens_follow_one_another_and_fill_the_episode() {
        let layout = Arc::new(network(&[Shape { agents: 2, phases: 2, movements: 4, lanes: 2 }]));
        let config = EnvConfig::default();
        let (all, yellow) = (config.decision_seconds, config.yellow_seconds);
        let plan = Plan::new(&layout, &config, 60, &[vec![0, 1], vec![0, 0], vec![0, 0]]).unwrap();
        let lengths =
            |agent: usize| plan.shown[agent].iter().map(|(seconds, _)| *seconds).collect::<Vec<_>>();
        assert_eq!(lengths(0), [3 * all]);
        assert_eq!(lengths(1), [yellow, all - yellow, yellow, 2 * all - yellow]);
        let [first, second] = [0, 1].map(|phase| layout.intersections[1].phases[phase].state.clone());
        let states: Vec<&str> = plan.shown[1].iter().map(|(_, state)| state.as_str()).collect();
        let yellow_of = cross_sim::signal::yellow;
        assert_eq!(states, [&yellow_of(&first), &second, &yellow_of(&second), &first]);
        let xml = plan.xml();
        assert_eq!(xml.matches("<phase ").count(), 5);
        assert!(xml.contains("programID=\"replay\" offset=\"60\""), "{xml}");
    }

    #[test]
    fn odd_names_stay_whole() {
        let mut layout = network(&[Shape { agents: 1, phases: 2, movements: 4, lanes: 2 }]);
        layout.intersections[0].id = "a<\"&b".to_owned();
        let plan = Plan::new(&Arc::new(layout), &EnvConfig::default(), 0, &[vec![0]]).unwrap();
        assert!(plan.xml().contains("id=\"a&lt;&quot;&amp;b\""));
    }
}
