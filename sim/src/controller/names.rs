//! Rule-based controllers by name, as commands and reports call them.

use super::{Controller, FixedTime, Greedy, MaxPressure, Outgoing, Program, Random, Range};
use crate::env::SumoProgram;
use crate::scenario::{ReferenceMaxPressure, ReferenceOutgoing, ReferenceRange};
use std::fmt;
use std::str::FromStr;

/// A rule-based controller that has a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum RuleBased {
    /// [`FixedTime`].
    FixedTime,
    /// [`MaxPressure`] in the variant that reproduces the published numbers of the scenario at hand
    /// (`reference.max_pressure` of its `scenario.toml`).
    MaxPressure,
    /// [`MaxPressure`] against the stopped vehicles downstream, whole lane.
    MaxPressureStopped,
    /// [`MaxPressure`] against all vehicles downstream, whole lane.
    MaxPressureAll,
    /// [`MaxPressure`] against the stopped vehicles downstream, 50 m before the end of each lane.
    MaxPressureStopped50m,
    /// [`Greedy`].
    Greedy,
    /// [`Random`].
    Random,
    /// [`Program`]: what the net has.
    OwnProgram,
    /// [`Program`]: SUMO's `actuated`.
    Actuated,
    /// [`Program`]: SUMO's `delay_based`.
    DelayBased,
}

/// A name that belongs to no rule-based controller.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no rule-based policy {name:?}; choose one of {}", RuleBased::names().join(", "))]
pub struct UnknownPolicy {
    /// What was asked for.
    pub name: String,
}

impl RuleBased {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::FixedTime,
        Self::MaxPressure,
        Self::MaxPressureStopped,
        Self::MaxPressureAll,
        Self::MaxPressureStopped50m,
        Self::Greedy,
        Self::Random,
        Self::OwnProgram,
        Self::Actuated,
        Self::DelayBased,
    ];

    /// The Max-Pressure variants from which the strongest on a scenario is chosen.
    pub const MAX_PRESSURE_VARIANTS: [Self; 3] =
        [Self::MaxPressureStopped, Self::MaxPressureAll, Self::MaxPressureStopped50m];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::FixedTime => "fixed-time",
            Self::MaxPressure => "max-pressure",
            Self::MaxPressureStopped => "max-pressure-stopped",
            Self::MaxPressureAll => "max-pressure-all",
            Self::MaxPressureStopped50m => "max-pressure-stopped-50m",
            Self::Greedy => "greedy",
            Self::Random => "random",
            Self::OwnProgram => "own-program",
            Self::Actuated => "actuated",
            Self::DelayBased => "delay-based",
        }
    }

    /// What it does, in a line.
    #[must_use]
    pub fn summary(self) -> &'static str {
        match self {
            Self::FixedTime => "the next phase at every decision",
            Self::MaxPressure => "Max-Pressure in the variant that the scenario's published rows have",
            Self::MaxPressureStopped => "Max-Pressure: stopped vehicles in less stopped ones out, whole lane",
            Self::MaxPressureAll => "Max-Pressure: stopped vehicles in less all out, whole lane",
            Self::MaxPressureStopped50m => {
                "Max-Pressure: stopped vehicles in less stopped ones out, last 50 m"
            }
            Self::Greedy => "the phase with the most stopped vehicles",
            Self::Random => "any phase with equal probability",
            Self::OwnProgram => "the net's own signal program, run by SUMO",
            Self::Actuated => "SUMO's actuated: green goes on while vehicles follow each other closely",
            Self::DelayBased => "SUMO's delay_based: green goes on while delayed vehicles approach",
        }
    }

    /// Whether SUMO itself controls the signals, so that neither interval nor yellow of the protocol apply.
    #[must_use]
    pub fn is_sumos_program(self) -> bool {
        matches!(self, Self::OwnProgram | Self::Actuated | Self::DelayBased)
    }

    /// The names of all of them.
    #[must_use]
    pub fn names() -> Vec<&'static str> {
        Self::ALL.into_iter().map(Self::name).collect()
    }

    /// A new controller; `reference` is what the scenario says of its published Max-Pressure numbers.
    #[must_use]
    pub fn controller(self, reference: ReferenceMaxPressure) -> Box<dyn Controller> {
        match self {
            Self::FixedTime => Box::new(FixedTime),
            Self::MaxPressure => Box::new(MaxPressure::from(reference)),
            Self::MaxPressureStopped => Box::new(MaxPressure::new(Outgoing::Stopped, Range::WholeLane)),
            Self::MaxPressureAll => Box::new(MaxPressure::new(Outgoing::All, Range::WholeLane)),
            Self::MaxPressureStopped50m => Box::new(MaxPressure::new(Outgoing::Stopped, Range::Last50m)),
            Self::Greedy => Box::new(Greedy::default()),
            Self::Random => Box::new(Random::default()),
            Self::OwnProgram => Box::new(Program(SumoProgram::Own)),
            Self::Actuated => Box::new(Program(SumoProgram::Actuated)),
            Self::DelayBased => Box::new(Program(SumoProgram::DelayBased)),
        }
    }
}

impl fmt::Display for RuleBased {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for RuleBased {
    type Err = UnknownPolicy;

    fn from_str(name: &str) -> Result<Self, UnknownPolicy> {
        Self::ALL
            .into_iter()
            .find(|policy| policy.name() == name)
            .ok_or_else(|| UnknownPolicy { name: name.to_owned() })
    }
}

impl From<ReferenceMaxPressure> for MaxPressure {
    fn from(reference: ReferenceMaxPressure) -> Self {
        let outgoing = match reference.outgoing {
            ReferenceOutgoing::All => Outgoing::All,
            ReferenceOutgoing::Stopped => Outgoing::Stopped,
        };
        let range = match reference.range {
            ReferenceRange::WholeLane => Range::WholeLane,
            ReferenceRange::Last50m => Range::Last50m,
        };
        Self::new(outgoing, range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Signals;

    #[test]
    fn every_name_leads_back_to_its_policy() {
        for policy in RuleBased::ALL {
            assert_eq!(policy.name().parse(), Ok(policy));
            assert_eq!(policy.to_string(), policy.name());
        }
    }

    #[test]
    fn every_controller_bears_its_name() {
        let reference =
            ReferenceMaxPressure { outgoing: ReferenceOutgoing::All, range: ReferenceRange::Last50m };
        for policy in RuleBased::ALL {
            let expected = match policy {
                // By its name it says which variant the scenario asked for.
                RuleBased::MaxPressure => "max-pressure-all-50m",
                other => other.name(),
            };
            assert_eq!(policy.controller(reference).name(), expected);
        }
    }

    #[test]
    fn only_programs_of_sumo_leave_the_lights_to_it() {
        for policy in RuleBased::ALL {
            let programs = [RuleBased::OwnProgram, RuleBased::Actuated, RuleBased::DelayBased];
            let driven = policy.controller(ReferenceMaxPressure::default()).signals() == Signals::Driven;
            assert_eq!(driven, !programs.contains(&policy), "{policy}");
        }
    }

    #[test]
    fn an_unknown_name_is_answered_with_the_known_ones() {
        for name in ["", "maxpressure", "Fixed-Time", "fixed-time "] {
            let message = name.parse::<RuleBased>().unwrap_err().to_string();
            for known in RuleBased::names() {
                assert!(message.contains(known), "{message}");
            }
        }
    }
}
