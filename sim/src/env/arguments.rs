//! SUMO's command line.

use super::EnvOptions;
use crate::scenario::Scenario;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Everything but the TraCI port, which is chosen at start. `programs` is a file of signal programs.
pub(super) fn arguments(
    scenario: &Scenario,
    options: &EnvOptions,
    programs: Option<&Path>,
    seed: u32,
) -> Vec<OsString> {
    let mut arguments = Arguments::default();
    arguments.pair("--net-file", &scenario.net);
    arguments.pair("--route-files", list(scenario.routes.iter().map(PathBuf::as_path)));
    // SUMO runs the signal program that it loads last, so that ours come after those that a scenario may bring.
    let additional: Vec<_> = scenario.additional.iter().map(PathBuf::as_path).chain(programs).collect();
    if !additional.is_empty() {
        arguments.pair("--additional-files", list(additional));
    }
    arguments.pair("--begin", scenario.begin.to_string());
    arguments.pair("--seed", seed.to_string());
    arguments.pair("--time-to-teleport", scenario.sumo.time_to_teleport.to_string());
    arguments.pair("--default.departspeed", &scenario.sumo.depart_speed);
    arguments.pair("--default.departlane", &scenario.sumo.depart_lane);
    // The files are known; checking them against schemas costs time at every start.
    for option in ["--xml-validation", "--xml-validation.net", "--xml-validation.routes"] {
        arguments.pair(option, "never");
    }
    for option in ["--no-step-log", "--no-warnings", "--duration-log.disable"] {
        arguments.pair(option, "true");
    }
    if let Some(path) = &options.tripinfo {
        arguments.pair("--tripinfo-output", path);
        arguments.pair("--tripinfo-output.write-unfinished", "true");
        arguments.pair("--tripinfo-output.write-undeparted", "true");
    }
    arguments.0.extend(options.extra_args.iter().map(OsString::from));
    arguments.0
}

#[derive(Default)]
struct Arguments(Vec<OsString>);

impl Arguments {
    fn pair(&mut self, option: &str, value: impl AsRef<std::ffi::OsStr>) {
        self.0.push(option.into());
        self.0.push(value.as_ref().to_owned());
    }
}

/// SUMO separates files by commas.
fn list<'p>(files: impl IntoIterator<Item = &'p Path>) -> OsString {
    files.into_iter().map(Path::as_os_str).collect::<Vec<_>>().join(",".as_ref())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::SumoOptions;

    fn scenario() -> Scenario {
        Scenario {
            name: "town".to_owned(),
            description: String::new(),
            source: String::new(),
            directory: PathBuf::new(),
            net: "town.net.xml".into(),
            routes: vec!["a.rou.xml".into(), "b.rou.xml".into()],
            additional: vec![],
            begin: 25_200,
            end: 28_800,
            sumo: SumoOptions::default(),
            reference: crate::scenario::Reference::default(),
            net_hash: String::new(),
            demand_hash: String::new(),
        }
    }

    fn value_of<'a>(arguments: &'a [OsString], option: &str) -> Option<&'a str> {
        let at = arguments.iter().position(|argument| argument == option)?;
        arguments.get(at + 1)?.to_str()
    }

    #[test]
    fn what_published_numbers_depend_on_is_set() {
        let arguments = arguments(&scenario(), &EnvOptions::default(), None, 7);
        for (option, value) in [
            ("--route-files", "a.rou.xml,b.rou.xml"),
            ("--begin", "25200"),
            ("--seed", "7"),
            ("--time-to-teleport", "-1"),
            ("--default.departspeed", "0"),
            ("--default.departlane", "first"),
        ] {
            assert_eq!(value_of(&arguments, option), Some(value), "{option}");
        }
        assert_eq!(value_of(&arguments, "--tripinfo-output"), None);
    }

    #[test]
    fn trip_records_hold_vehicles_that_never_finished_or_departed() {
        let options = EnvOptions { tripinfo: Some("t.xml".into()), ..EnvOptions::default() };
        let arguments = arguments(&scenario(), &options, None, 7);
        assert_eq!(value_of(&arguments, "--tripinfo-output"), Some("t.xml"));
        assert_eq!(value_of(&arguments, "--tripinfo-output.write-unfinished"), Some("true"));
        assert_eq!(value_of(&arguments, "--tripinfo-output.write-undeparted"), Some("true"));
    }

    #[test]
    fn signal_programs_come_after_the_scenarios_own_additional_files() {
        let mut scenario = scenario();
        let programs = Some(Path::new("p.add.xml"));
        let alone = arguments(&scenario, &EnvOptions::default(), programs, 7);
        assert_eq!(value_of(&alone, "--additional-files"), Some("p.add.xml"));
        scenario.additional = vec!["poly.xml".into()];
        let both = arguments(&scenario, &EnvOptions::default(), programs, 7);
        assert_eq!(value_of(&both, "--additional-files"), Some("poly.xml,p.add.xml"));
    }
}
