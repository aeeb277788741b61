//! Protocols of other benchmarks: the settings under which their figures were made.
//!
//! Figures compare only under one protocol. A [`Preset`] sets what protocols differ in, the interval of decisions, the
//! yellow and SUMO's teleports, and leaves the rest (length, detection bands, departure defaults) to configuration and
//! scenario. `docs/protocols.md` has the table and what the presets cannot reproduce.

use crate::scenario::{Benchmark, Scenario};
use cross_config::EnvConfig;
use std::str::FromStr;

/// A named protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Preset {
    /// The one of the paper: a decision every 10 s with 3 s of yellow, teleports as the scenario says.
    Paper,
    /// RESCO (Ault and Sharon, 2021).
    Resco,
    /// Unicorn (Zhang et al., 2025).
    Unicorn,
}

/// What a preset sets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Seconds between two decisions.
    pub decision_seconds: u32,
    /// Seconds of yellow at a change of phase, inside that interval.
    pub yellow_seconds: u32,
    /// Seconds of standing after which SUMO moves a vehicle on, -1 never.
    pub time_to_teleport: f64,
}

/// A protocol that does not go with what is to be evaluated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PresetError {
    /// No such preset.
    #[error("there is no protocol {name:?}; choose one of {}", Preset::names().join(", "))]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// The protocol is only defined for the maps of certain benchmarks.
    #[error(
        "the protocol {} differs between benchmarks, and {scenario} belongs to none; say which it is like with benchmark = \
         \"resco\", \"ma2c\" or \"cityflow\" under [reference] in its scenario.toml",
        preset.name()
    )]
    NoBenchmark {
        /// The protocol.
        preset: Preset,
        /// The scenario.
        scenario: String,
    },
    /// The episode does not end at a decision.
    #[error(
        "the protocol {} decides every {interval} s, of which env.episode_seconds, {episode}, is no multiple; change that",
        preset.name()
    )]
    Episode {
        /// The protocol.
        preset: Preset,
        /// Its decision interval, seconds.
        interval: u32,
        /// Length of the episode, seconds.
        episode: u32,
    },
}

/// Decision interval and yellow of the paper, seconds.
const PAPER: (u32, u32) = (10, 3);
/// What a protocol that is no preset is called.
const CUSTOM: &str = "custom";

impl Preset {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Paper, Self::Resco, Self::Unicorn];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Resco => "resco",
            Self::Unicorn => "unicorn",
        }
    }

    /// The names of all of them.
    #[must_use]
    pub fn names() -> Vec<&'static str> {
        Self::ALL.into_iter().map(Self::name).collect()
    }

    /// What it sets, in a line: decision interval / yellow, and the time after which vehicles teleport.
    #[must_use]
    pub fn summary(self) -> &'static str {
        match self {
            Self::Paper => "10/3 s, as the scenario says",
            Self::Resco => "10/3 s, never; arterial4x4 and grid5x5 5/2 s, never",
            Self::Unicorn => "RESCO's maps 15/5 s, never; MA2C's 10/3 s, 300 s; CityFlow's 15/5 s, 600 s",
        }
    }

    /// What it sets on a scenario.
    ///
    /// # Errors
    /// [`PresetError::NoBenchmark`] where the protocol says nothing of such a scenario.
    pub fn timing(self, scenario: &Scenario) -> Result<Timing, PresetError> {
        let timing = |(decision_seconds, yellow_seconds), time_to_teleport| Timing {
            decision_seconds,
            yellow_seconds,
            time_to_teleport,
        };
        let benchmark = scenario.reference.benchmark;
        Ok(match (self, benchmark) {
            (Self::Paper, _) => timing(PAPER, scenario.sumo.time_to_teleport),
            // RESCO's map_config.py: the maps that come from MA2C, with blocks of 200 m, are decided upon twice as often.
            (Self::Resco, Some(Benchmark::RescoArterial | Benchmark::Ma2c)) => timing((5, 2), -1.0),
            (Self::Resco, _) => timing((10, 3), -1.0),
            // Unicorn's README; its "green" is the whole interval, the yellow within it (env/matsc.py).
            (Self::Unicorn, Some(Benchmark::Resco | Benchmark::RescoArterial)) => timing((15, 5), -1.0),
            (Self::Unicorn, Some(Benchmark::Ma2c)) => timing((10, 3), 300.0),
            (Self::Unicorn, Some(Benchmark::Cityflow)) => timing((15, 5), 600.0),
            (Self::Unicorn, None) => {
                return Err(PresetError::NoBenchmark { preset: self, scenario: scenario.name.clone() });
            }
        })
    }

    /// Puts a scenario and the environment it is run in under this protocol.
    ///
    /// # Errors
    /// [`PresetError`]; nothing has changed then.
    pub fn apply(self, scenario: &mut Scenario, env: &mut EnvConfig) -> Result<(), PresetError> {
        let timing = self.timing(scenario)?;
        if !env.episode_seconds.is_multiple_of(timing.decision_seconds) {
            return Err(PresetError::Episode {
                preset: self,
                interval: timing.decision_seconds,
                episode: env.episode_seconds,
            });
        }
        env.decision_seconds = timing.decision_seconds;
        env.yellow_seconds = timing.yellow_seconds;
        scenario.sumo.time_to_teleport = timing.time_to_teleport;
        Ok(())
    }
}

/// What to call the protocol of an environment that no preset was asked for: `paper` where interval and yellow are the
/// paper's, else `custom`.
#[must_use]
pub fn name_of(env: &EnvConfig) -> &'static str {
    if (env.decision_seconds, env.yellow_seconds) == PAPER { Preset::Paper.name() } else { CUSTOM }
}

impl FromStr for Preset {
    type Err = PresetError;

    fn from_str(name: &str) -> Result<Self, PresetError> {
        let named = Self::ALL.into_iter().find(|preset| preset.name() == name);
        named.ok_or_else(|| PresetError::Unknown { name: name.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Reference, SumoOptions};

    fn scenario(benchmark: Option<Benchmark>) -> Scenario {
        Scenario {
            name: "town".to_owned(),
            description: String::new(),
            source: String::new(),
            directory: "town".into(),
            net: "town.net.xml".into(),
            routes: vec![],
            additional: vec![],
            begin: 0,
            end: 3600,
            sumo: SumoOptions { time_to_teleport: 77.0, ..SumoOptions::default() },
            reference: Reference { benchmark, ..Reference::default() },
            net_hash: String::new(),
            demand_hash: String::new(),
        }
    }

    #[test]
    fn each_protocol_has_its_times_on_each_benchmark() {
        use Benchmark::{Cityflow, Ma2c, Resco, RescoArterial};
        for (preset, benchmark, expected) in [
            (Preset::Paper, None, (10, 3, 77.0)),
            (Preset::Paper, Some(Ma2c), (10, 3, 77.0)),
            (Preset::Resco, None, (10, 3, -1.0)),
            (Preset::Resco, Some(Resco), (10, 3, -1.0)),
            (Preset::Resco, Some(RescoArterial), (5, 2, -1.0)),
            (Preset::Resco, Some(Ma2c), (5, 2, -1.0)),
            (Preset::Resco, Some(Cityflow), (10, 3, -1.0)),
            (Preset::Unicorn, Some(Resco), (15, 5, -1.0)),
            (Preset::Unicorn, Some(RescoArterial), (15, 5, -1.0)),
            (Preset::Unicorn, Some(Ma2c), (10, 3, 300.0)),
            (Preset::Unicorn, Some(Cityflow), (15, 5, 600.0)),
        ] {
            let (mut scenario, mut env) = (scenario(benchmark), EnvConfig::default());
            preset.apply(&mut scenario, &mut env).unwrap();
            let found = (env.decision_seconds, env.yellow_seconds, scenario.sumo.time_to_teleport);
            assert_eq!(found, expected, "{preset:?} {benchmark:?}");
            assert_eq!(env.episode_seconds, 3600);
        }
    }

    #[test]
    fn what_does_not_go_together_is_refused_and_changes_nothing() {
        let (mut unknown, mut env) = (scenario(None), EnvConfig::default());
        let error = Preset::Unicorn.apply(&mut unknown, &mut env).unwrap_err().to_string();
        assert!(
            error.contains("unicorn") && error.contains("town") && error.contains("scenario.toml"),
            "{error}"
        );

        let mut resco = scenario(Some(Benchmark::Resco));
        env.episode_seconds = 200;
        let error = Preset::Unicorn.apply(&mut resco, &mut env).unwrap_err().to_string();
        assert!(error.contains("200") && error.contains("15"), "{error}");
        assert_eq!(env, EnvConfig { episode_seconds: 200, ..EnvConfig::default() });
        assert_eq!(resco, scenario(Some(Benchmark::Resco)));
    }

    #[test]
    fn names_lead_back_and_an_unknown_one_is_answered_with_them() {
        for preset in Preset::ALL {
            assert_eq!(preset.name().parse(), Ok(preset));
        }
        let error = "Paper".parse::<Preset>().unwrap_err().to_string();
        assert!(error.contains("paper, resco, unicorn"), "{error}");
    }

    #[test]
    fn only_the_papers_times_are_called_so() {
        assert_eq!(name_of(&EnvConfig::default()), "paper");
        assert_eq!(name_of(&EnvConfig { yellow_seconds: 2, ..EnvConfig::default() }), "custom");
        assert_eq!(name_of(&EnvConfig { decision_seconds: 5, ..EnvConfig::default() }), "custom");
    }
}
