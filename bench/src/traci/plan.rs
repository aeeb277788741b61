//! The signal plan that all clients follow.

use super::job::{Job, Leg, Way};
use crate::command_line;
use crate::env::drive::by_rule;
use crate::error::BenchError;
use cross_config::EnvConfig;
use cross_sim::SimError;
use cross_sim::controller::RuleBased;
use cross_sim::env::Env;
use cross_sim::layout::NetworkLayout;
use cross_sim::net::Net;
use cross_sim::signal::{Command, SignalTiming};
use std::ffi::OsString;

/// Metres around the anchor within which other clients see vehicles: no network reaches farther.
const EVERYWHERE: f64 = 1e7;

/// What an episode shows on its signals, and the SUMO that it ran on.
#[derive(Debug)]
pub(super) struct Plan {
    /// Max-Pressure's choices `[steps][agents]`.
    pub(super) actions: Vec<Vec<u8>>,
    /// SUMO's arguments without those for a client.
    pub(super) arguments: Vec<OsString>,
    first: Vec<(String, String)>,
    decisions: Vec<Vec<Leg>>,
    anchor: String,
    begin: u32,
}

impl Plan {
    /// Drives an episode by Max-Pressure to have its plan.
    pub(super) fn drive(env: &mut Env, seed: u32) -> Result<Self, BenchError> {
        env.reset(seed)?;
        let arguments = env.sumo_pid().map_or_else(|| Ok(Vec::new()), command_line::of_process)?;
        let mut rule = RuleBased::MaxPressure.controller(env.scenario().reference.max_pressure);
        let actions = by_rule(env, &mut *rule, seed, None)?;
        env.finish()?;
        let net = Net::read(&env.scenario().net).map_err(SimError::from)?;
        let (first, decisions) = legs(env.layout(), &env.options().config, &actions)?;
        Ok(Self {
            actions,
            arguments: command_line::without(&arguments, &command_line::CLIENT),
            first,
            decisions,
            // Any will do; a net without junctions has no environment.
            anchor: net.junctions.into_keys().min().unwrap_or_default(),
            begin: env.scenario().begin,
        })
    }

    /// The same for another client.
    pub(super) fn job(&self, way: Way) -> Job {
        Job {
            way,
            anchor: self.anchor.clone(),
            range: EVERYWHERE,
            begin: f64::from(self.begin),
            first: self.first.clone(),
            decisions: self.decisions.clone(),
        }
    }
}

/// What lights show at the beginning, and the legs of each decision.
type Legs = (Vec<(String, String)>, Vec<Vec<Leg>>);

/// The commands that come of an episode's actions `[steps][agents]`, with the names of the lights.
fn legs(layout: &NetworkLayout, config: &EnvConfig, actions: &[Vec<u8>]) -> Result<Legs, BenchError> {
    let mut timing = SignalTiming::new(layout, config.decision_seconds, config.yellow_seconds);
    let mut show = Vec::new();
    let follow = |command: Command<'_>, show: &mut Vec<(String, String)>| match command {
        Command::Show { agent, state } => {
            show.push((layout.intersections[agent].id.clone(), state.to_owned()));
            None
        }
        Command::Run { seconds } => Some(Leg { show: std::mem::take(show), seconds }),
    };
    for command in timing.reset() {
        follow(command, &mut show);
    }
    let first = std::mem::take(&mut show);
    let mut decisions = Vec::with_capacity(actions.len());
    for actions in actions {
        let commands = timing.decide(actions).map_err(SimError::from)?;
        decisions.push(commands.filter_map(|command| follow(command, &mut show)).collect());
    }
    Ok((first, decisions))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::update::data::{Shape, network};

    #[test]
    fn each_decision_has_its_legs_and_only_what_changes_is_shown() {
        let layout = network(&[Shape { agents: 2, phases: 2, movements: 4, lanes: 2 }]);
        let config = EnvConfig::default();
        let (first, decisions) = legs(&layout, &config, &[vec![0, 1], vec![0, 1]]).unwrap();
        assert_eq!(first.len(), 2);
        let seconds: Vec<Vec<u32>> =
            decisions.iter().map(|legs| legs.iter().map(|leg| leg.seconds).collect()).collect();
        assert_eq!(seconds, [vec![3, 7], vec![10]]);
        let second = &layout.intersections[1];
        assert_eq!(decisions[0][1].show, [(second.id.clone(), second.phases[1].state.clone())]);
        assert_eq!(decisions[1][0].show, []);
    }

    #[test]
    fn other_programs_read_these_names() {
        let job = Job {
            way: Way::EverySecond,
            anchor: "a".to_owned(),
            range: 1.0,
            begin: 5.0,
            first: vec![("x".to_owned(), "G".to_owned())],
            decisions: vec![vec![Leg { show: vec![], seconds: 10 }]],
        };
        let text = r#"{"way":"every-second","anchor":"a","range":1.0,"begin":5.0,"first":[["x","G"]],"decisions":[[{"show":[],"seconds":10}]]}"#;
        assert_eq!(serde_json::to_string(&job).unwrap(), text);
    }
}
