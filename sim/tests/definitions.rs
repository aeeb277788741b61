//! Scenario definitions: what they may say, where they are found, and how their mistakes are reported.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cross_sim::scenario::{Scenario, ScenarioError, ScenarioPath};
use proptest::prelude::*;
use std::path::Path;

const NET: &str = "<net/>";
const ROUTES: &str = "<routes>\n\
    <vehicle id=\"early\" depart=\"50\"/><vehicle id=\"a\" depart=\"100\"/><trip id=\"b\" depart=\"120.5\"/>\n\
    <flow id=\"c\" number=\"7\" begin=\"100\" end=\"200\"/>\n\
    <flow id=\"d\" vehsPerHour=\"360\" begin=\"0\" end=\"150\"/>\n\
    <flow id=\"e\" period=\"2\" begin=\"100\" end=\"110\"/><flow id=\"f\" probability=\"0.5\" begin=\"100\" end=\"104\"/>\n\
    </routes>";
const DEFINITION: &str = "net = \"town.net.xml\"\nroutes = [\"town.rou.xml\"]\nbegin = 100\nend = 200\n";

/// A scenarios folder with one scenario, `town`.
fn folder(definition: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let town = folder.path().join("town");
    std::fs::create_dir(&town).unwrap();
    std::fs::write(town.join("scenario.toml"), definition).unwrap();
    std::fs::write(town.join("town.net.xml"), NET).unwrap();
    std::fs::write(town.join("town.rou.xml"), ROUTES).unwrap();
    folder
}

fn load(definition: &str) -> Result<Scenario, ScenarioError> {
    Scenario::from_directory(&folder(definition).path().join("town"))
}

#[test]
fn a_short_definition_has_the_defaults_that_published_numbers_need() {
    let folder = folder(DEFINITION);
    let scenario = ScenarioPath::locate(Some(folder.path())).load("town").unwrap();
    assert_eq!((scenario.name.as_str(), scenario.begin, scenario.end), ("town", 100, 200));
    assert_eq!(scenario.sumo.time_to_teleport, -1.0);
    assert_eq!((scenario.sumo.depart_speed.as_str(), scenario.sumo.depart_lane.as_str()), ("0", "first"));
    assert_eq!(scenario.net, folder.path().join("town/town.net.xml"));
    assert_eq!(scenario.net_hash.len(), 64);
}

#[test]
fn more_than_a_year_is_taken_for_a_mistake() {
    let year = |end: u32| DEFINITION.replace("end = 200", &format!("end = {end}"));
    assert!(load(&year(100 + 366 * 86_400)).is_ok());
    // Its arrivals by the minute would take half a gigabyte.
    let error = load(&year(u32::MAX)).unwrap_err().to_string();
    assert!(error.contains("scenario.toml") && error.contains("more than a year"), "{error}");
}

#[test]
fn a_directory_loads_as_well_as_a_name() {
    let folder = folder(DEFINITION);
    let town = folder.path().join("town");
    assert_eq!(Scenario::load(town.to_str().unwrap()).unwrap().name, "town");
}

#[test]
fn files_decide_the_hashes() {
    let folder = folder(DEFINITION);
    let town = folder.path().join("town");
    let before = Scenario::from_directory(&town).unwrap();
    std::fs::write(town.join("town.rou.xml"), "<routes/>").unwrap();
    let after = Scenario::from_directory(&town).unwrap();
    assert_eq!(before.net_hash, after.net_hash);
    assert_ne!(before.demand_hash, after.demand_hash);
}

#[test]
fn vehicles_trips_and_flows_are_counted_between_begin_and_end() {
    let folder = folder(DEFINITION);
    let scenario = Scenario::from_directory(&folder.path().join("town")).unwrap();
    // a, b; 7 of c; 50 s of d at one in ten seconds; 5 of e; 2 of f.
    assert_eq!(scenario.vehicles().unwrap(), 2 + 7 + 5 + 5 + 2);
}

#[test]
fn mistakes_name_file_and_key() {
    for (definition, words) in [
        (DEFINITION.replace("routes", "route"), "route"),
        (format!("{DEFINITION}[sumo]\nteleport = 3\n"), "teleport"),
        (format!("{DEFINITION}[reference.max_pressure]\noutgoing = \"none\"\n"), "none"),
        (DEFINITION.replace("end = 200", "end = 100"), "end is 100"),
        (DEFINITION.replace("[\"town.rou.xml\"]", "[]"), "routes is empty"),
        (DEFINITION.replace("net = ", "net "), "line 1"),
    ] {
        let error = load(&definition).unwrap_err();
        assert!(matches!(error, ScenarioError::Parse { .. }), "{error}");
        let error = error.to_string();
        assert!(error.contains("scenario.toml") && error.contains(words), "{error}");
    }
}

#[test]
fn missing_files_say_what_to_do() {
    let error = load(&DEFINITION.replace("town.net.xml", "gone.net.xml")).unwrap_err().to_string();
    assert!(error.contains("\"town\"") && error.contains("gone.net.xml"), "{error}");
    let error = load(&DEFINITION.replace("town.net.xml", "@deps/nowhere/at.all")).unwrap_err().to_string();
    assert!(error.contains(".deps/nowhere/at.all") && error.contains("make build"), "{error}");
}

#[test]
fn an_unknown_name_lists_the_known_ones() {
    let folder = folder(DEFINITION);
    let error = ScenarioPath::locate(Some(folder.path())).load("city").unwrap_err().to_string();
    assert!(error.contains("\"city\"") && error.contains("town") && error.contains("grid4x4"), "{error}");
    for odd in ["", "../..", "/", "a/b"] {
        assert!(Scenario::load(odd).is_err(), "{odd:?}");
    }
    assert!(matches!(Scenario::from_directory(Path::new("/nowhere")), Err(ScenarioError::Read { .. })));
}

/// A whole definition with every table that there is.
const WHOLE: &str = include_str!("../../scenarios/grid4x4/scenario.toml");

/// Lines left out, doubled or out of place, and values of all kinds where others belong.
fn damaged_definition() -> impl Strategy<Value = String> {
    let line = prop_oneof![
        prop::sample::select(WHOLE.lines().chain(DEFINITION.lines()).collect::<Vec<_>>())
            .prop_map(str::to_owned),
        "[a-z_.]{1,12} = (-?[0-9]{1,20}|[0-9]e[0-9]{1,3}|nan|inf|true|\"[^\"\\\\]{0,12}\"|\\[\\]|\\{\\})",
        prop::sample::select(vec!["begin", "end", "net", "routes", "time_to_teleport", "depart_lane"])
            .prop_flat_map(|key| prop::sample::select(vec![
                "-1",
                "nan",
                "1e999",
                "99999999999999999999",
                "\"\"",
                "[]",
                "[\"\"]",
                "\"@deps/../..\""
            ])
            .prop_map(move |value| format!("{key} = {value}"))),
        any::<String>(),
    ];
    prop::collection::vec(line, 0..12).prop_map(|lines| lines.join("\n"))
}

proptest! {
    #[test]
    fn whatever_a_definition_says_loading_ends_with_a_scenario_or_a_sentence(text in damaged_definition()) {
        if let Err(error) = load(&text) {
            let message = error.to_string();
            prop_assert!(!message.is_empty() && !message.contains('\n'), "{message:?}");
        }
    }

    #[test]
    fn a_definition_whose_lines_are_cut_or_gone_ends_likewise(gone in prop::collection::vec(any::<prop::sample::Index>(), 1..4), cut in 0..20_usize) {
        let mut lines: Vec<&str> = WHOLE.lines().collect();
        for index in gone {
            let at = index.index(lines.len());
            lines[at] = lines[at].get(..cut).unwrap_or_default();
        }
        if let Err(error) = load(&lines.join("\n")) {
            prop_assert!(!error.to_string().contains('\n'), "{error}");
        }
    }
}
