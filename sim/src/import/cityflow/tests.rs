//! One crossing of CityFlow, imported for real, and everything that may be wrong with it.

use super::*;
use crate::generate::GenerateError;
use crate::layout::NetworkLayout;
use crate::scenario::Scenario;
use cross_config::EnvConfig;
use proptest::prelude::*;
use serde_json::{Value, json};
use tempfile::TempDir;

/// Where the roads of the crossing come from: name, and position of the outer end.
const ARMS: [(&str, f64, f64); 4] =
    [("w", -300.0, 0.0), ("s", 0.0, -200.0), ("e", 300.0, 0.0), ("n", 0.0, 200.0)];

/// A crossing of four roads with three lanes each, in CityFlow's order: lane 0 turns left, 2 right, and all lead to all lanes.
fn roadnet() -> Value {
    let mut intersections = vec![];
    let mut roads = vec![];
    let mut links = vec![];
    for (index, (arm, x, y)) in ARMS.into_iter().enumerate() {
        intersections.push(json!({"id": arm, "point": {"x": x, "y": y}, "width": 0, "roads": [], "roadLinks": [],
            "trafficLight": {"roadLinkIndices": [], "lightphases": [{"time": 5, "availableRoadLinks": []}]}, "virtual": true}));
        let lanes = vec![json!({"width": 4, "maxSpeed": 11.111}); 3];
        let (outer, inner) = (json!({"x": x, "y": y}), json!({"x": 0, "y": 0}));
        roads.push(json!({"id": format!("{arm}_in"), "points": [outer, inner], "lanes": lanes,
            "startIntersection": arm, "endIntersection": "J"}));
        roads.push(json!({"id": format!("{arm}_out"), "points": [inner, outer], "lanes": lanes,
            "startIntersection": "J", "endIntersection": arm}));
        // Counter-clockwise from the arm itself: right, straight on, left.
        for (turn, name, lane) in [(1, "turn_right", 2), (2, "go_straight", 1), (3, "turn_left", 0)] {
            let lane_links: Vec<_> =
                (0..3).map(|to| json!({"startLaneIndex": lane, "endLaneIndex": to, "points": []})).collect();
            links.push(json!({"type": name, "startRoad": format!("{arm}_in"), "direction": index,
                "endRoad": format!("{}_out", ARMS[(index + turn) % 4].0), "laneLinks": lane_links}));
        }
    }
    // Road links: three of each arm in the order w, s, e, n; the first of each turns right.
    let phases = [
        (5, vec![0, 3, 6, 9]),
        (30, vec![0, 3, 6, 9, 1, 7]),
        (20, vec![0, 3, 6, 9, 4, 10]),
        (10, vec![0, 3, 6, 9, 2, 8]),
    ];
    let phases: Vec<_> =
        phases.iter().map(|(time, links)| json!({"time": time, "availableRoadLinks": links})).collect();
    intersections
        .push(json!({"id": "J", "point": {"x": 0, "y": 0}, "width": 15, "roads": [], "roadLinks": links,
        "trafficLight": {"roadLinkIndices": [], "lightphases": phases}, "virtual": false}));
    json!({"intersections": intersections, "roads": roads})
}

fn flow(route: &[&str], interval: f64, start: f64, end: f64) -> Value {
    json!({"vehicle": {"length": 5.0, "maxSpeed": 11.111}, "route": route, "interval": interval, "startTime": start, "endTime": end})
}

fn flows() -> Value {
    json!([
        flow(&["w_in", "e_out"], 1.0, 70.0, 70.0),
        flow(&["w_in", "e_out"], 1.0, 3.0, 3.0),
        flow(&["n_in", "w_out"], 10.0, 0.0, 40.0),
        flow(&["s_in", "w_out"], 5.0, 100.0, 130.0),
    ])
}

struct Files {
    folder: TempDir,
}

impl Files {
    fn new(roadnet: &str, flow: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("roadnet.json"), roadnet).unwrap();
        std::fs::write(folder.path().join("flow.json"), flow).unwrap();
        Self { folder }
    }

    fn import(&self) -> Result<Imported, ImportError> {
        let new = NewScenario {
            name: "town".to_owned(),
            description: String::new(),
            source: String::new(),
            folder: self.folder.path().join("town"),
            replace: false,
            end: 120,
            time_to_teleport: -1.0,
        };
        let home = SumoHome::locate(None).expect("run `make build` first: it fetches SUMO");
        import(&home, &self.folder.path().join("roadnet.json"), &self.folder.path().join("flow.json"), &new)
    }

    /// Everything but netconvert.
    fn read(&self) -> Result<(), ImportError> {
        let roads = RoadNet::read(&self.folder.path().join("roadnet.json"))?;
        flow::read(&self.folder.path().join("flow.json"), &roads, 3600.0)?;
        convert::convert(&roads);
        Ok(())
    }
}

#[test]
fn a_crossing_keeps_its_lanes_turns_phases_and_vehicles() {
    let files = Files::new(&roadnet().to_string(), &flows().to_string());
    let imported = files.import().unwrap();
    let scenario = Scenario::from_directory(&imported.folder).unwrap();
    let net = Net::read(&scenario.net).unwrap();
    let layout = NetworkLayout::from_net(&net, &EnvConfig::default()).unwrap();
    assert_eq!(layout.agents(), 1);
    let crossing = &layout.intersections[0];
    assert_eq!((crossing.id.as_str(), crossing.position), ("J", (0.0, 0.0)));
    assert_eq!((crossing.movements.len(), crossing.incoming.len(), crossing.outgoing.len()), (36, 12, 12));
    // Letters clockwise from north; CityFlow's lane 2, which turns right, is SUMO's lane 0. The all-yellow phase is gone.
    let states: Vec<_> = crossing.phases.iter().map(|phase| phase.state.as_str()).collect();
    assert_eq!(
        states,
        [
            "GGGrrrrrrGGGGGGrrrGGGrrrrrrGGGGGGrrr",
            "GGGGGGrrrGGGrrrrrrGGGGGGrrrGGGrrrrrr",
            "GGGrrrrrrGGGrrrGGGGGGrrrrrrGGGrrrGGG",
        ]
    );
    let lanes: Vec<_> = crossing.incoming.iter().map(|lane| lane.id.as_str()).collect();
    assert_eq!(lanes[..4], ["n_in_0", "n_in_1", "n_in_2", "e_in_0"]);
    let right = crossing.movements[0];
    assert_eq!(crossing.outgoing[right.outgoing].id, "w_out_0");
    assert_eq!(crossing.incoming[0].speed, 11.11);
    // Its own program has CityFlow's greens, and its yellow of 5 s for what ends.
    let program = net.traffic_lights[0].program().unwrap();
    assert_eq!(program.states.len(), 6);
    assert_eq!(program.states[1], "GGGrrrrrrGGGyyyrrrGGGrrrrrrGGGyyyrrr");
    // Vehicles at 3 and 70; 0, 10, ..., 40; 100, 105, ..., 115, while three more come too late.
    let arrivals = scenario.arrivals().unwrap();
    assert_eq!(arrivals.per_minute, [6.0, 5.0]);
    let routes = std::fs::read_to_string(&scenario.routes[0]).unwrap();
    assert!(!routes.contains("vType"), "vehicles are SUMO's default cars");
    assert!(routes.contains("<vehicle id=\"flow_2.4\" route=\"route_1\" depart=\"40\"/>"), "{routes}");
    assert!(routes.contains("<route id=\"route_0\" edges=\"w_in e_out\"/>"), "{routes}");
}

#[test]
fn the_report_says_what_was_kept_changed_and_lost() {
    let imported = Files::new(&roadnet().to_string(), &flows().to_string()).import().unwrap();
    let counts: Vec<_> = imported
        .report
        .iter()
        .map(|item| (item.what, item.read, item.kept, item.changed, item.lost))
        .collect();
    assert_eq!(
        counts,
        [
            ("intersections", 5, 5, 0, 0),
            ("signals", 1, 1, 0, 0),
            ("phases", 4, 3, 0, 1),
            ("roads", 8, 8, 0, 0),
            ("lanes", 24, 24, 24, 0),
            ("turns", 12, 12, 0, 0),
            ("lane links", 36, 36, 0, 0),
            ("flows", 4, 4, 0, 0),
            ("vehicles", 14, 11, 11, 3),
        ]
    );
    for item in &imported.report {
        assert_eq!(item.notes.is_empty(), item.changed + item.lost == 0, "{item:?}");
    }
}

#[test]
fn a_crossing_without_a_choice_becomes_one_without_a_signal() {
    let mut roadnet = roadnet();
    roadnet["intersections"][4]["trafficLight"]["lightphases"] =
        json!([{"time": 30, "availableRoadLinks": [1, 7]}]);
    let files = Files::new(&roadnet.to_string(), &flows().to_string());
    let imported = files.import().unwrap();
    let signals = imported.report.iter().find(|item| item.what == "signals").unwrap();
    assert_eq!((signals.read, signals.kept, signals.lost), (1, 0, 1));
    let net = Net::read(&imported.folder.join(NET_FILE)).unwrap();
    assert!(net.traffic_lights.is_empty());
}

#[test]
fn left_turns_yield_to_what_comes_against_them() {
    let mut roadnet = roadnet();
    // East and west: all of both.
    roadnet["intersections"][4]["trafficLight"]["lightphases"][1]["availableRoadLinks"] =
        json!([0, 1, 2, 3, 6, 7, 8, 9]);
    let files = Files::new(&roadnet.to_string(), &flows().to_string());
    let roads = RoadNet::read(&files.folder.path().join("roadnet.json")).unwrap();
    let converted = convert::convert(&roads);
    assert_eq!(converted.net.programs[0].phases[0], (30, "GGGrrrrrrGGGGGGgggGGGrrrrrrGGGGGGggg".to_owned()));
}

#[test]
fn an_endless_flow_lasts_until_the_end() {
    let flow = json!([flow(&["w_in"], 50.0, 0.0, -1.0)]);
    let imported = Files::new(&roadnet().to_string(), &flow.to_string()).import().unwrap();
    let vehicles = imported.report.last().unwrap();
    assert_eq!((vehicles.what, vehicles.kept, vehicles.lost), ("vehicles", 3, 0));
}

/// Asserts that files are refused with these words, and that nothing is left behind.
fn refused(roadnet: &str, flow: &str, words: &[&str]) {
    let files = Files::new(roadnet, flow);
    let error = files.import().unwrap_err().to_string();
    for word in words {
        assert!(error.contains(word), "{word:?} is not in: {error}");
    }
    assert_eq!(std::fs::read_dir(files.folder.path()).unwrap().count(), 2, "{error}");
}

#[test]
fn odd_flows_are_refused_by_name() {
    let net = roadnet().to_string();
    let refused =
        |flows: Value, words: &[&str]| refused(&net, &flows.to_string(), &[&["flow.json"], words].concat());
    let good = || flow(&["w_in", "e_out"], 1.0, 0.0, 0.0);
    refused(json!([good(), flow(&["w_in", "gone"], 1.0, 0.0, 0.0)]), &["flow 1", "\"gone\""]);
    refused(
        json!([flow(&["w_in", "w_out"], 1.0, 0.0, 0.0)]),
        &["flow 0", "\"w_in\"", "\"w_out\"", "no lane"],
    );
    refused(json!([flow(&[], 1.0, 0.0, 0.0)]), &["flow 0", "empty route"]);
    refused(json!([flow(&["w_in"], -1.0, 0.0, 10.0)]), &["flow 0", "interval -1"]);
    refused(json!([flow(&["w_in"], 0.0, 0.0, 10.0)]), &["flow 0", "interval 0"]);
    refused(json!([flow(&["w_in"], 1.0, -5.0, 10.0)]), &["flow 0", "startTime -5"]);
    refused(json!([flow(&["w_in"], 1.0, 9.0, 3.0)]), &["flow 0", "endTime 3", "startTime 9"]);
    refused(json!([flow(&["w_in"], 1e-9, 0.0, 3600.0)]), &["flow 0", "500000 vehicles"]);
    refused(json!([flow(&["w_in"], 1.0, 5000.0, 5000.0)]), &["no vehicle departs"]);
    refused(json!([]), &["no vehicle departs"]);
    refused(json!({"flows": []}), &["not a CityFlow flow file"]);
    refused(
        json!([{"route": ["w_in"], "startTime": 0, "endTime": 0}]),
        &["not a CityFlow flow file", "interval"],
    );
    refused(
        json!([{"route": "w_in", "interval": 1, "startTime": 0, "endTime": 0}]),
        &["not a CityFlow flow file"],
    );
}

#[test]
fn a_million_flows_are_refused() {
    let one = flow(&["w_in", "e_out"], 1.0, 0.0, 0.0).to_string();
    let flows = format!("[{}]", vec![one.as_str(); 1_000_000].join(","));
    refused(&roadnet().to_string(), &flows, &["flow.json", "more than 500000 vehicles"]);
}

#[test]
fn what_is_no_json_or_ends_too_early_is_told_apart() {
    let (net, flow) = (roadnet().to_string(), flows().to_string());
    for (roadnet, flow, file) in [
        ("hello", flow.as_str(), "roadnet.json"),
        ("\u{0}\u{1}", &flow, "roadnet.json"),
        (&net, "<routes/>", "flow.json"),
        (&net, "[} ", "flow.json"),
        (&net, &format!("{flow} and more"), "flow.json"),
    ] {
        refused(roadnet, flow, &[file, "is not JSON"]);
    }
    refused(&net[..net.len() / 2], &flow, &["roadnet.json", "cut off"]);
    refused(&net, &flow[..flow.len() - 1], &["flow.json", "cut off"]);
    refused(&net, "", &["flow.json", "cut off"]);
    refused("", &flow, &["roadnet.json", "cut off"]);
    let deep = "[".repeat(100_000);
    refused(&deep, &flow, &["roadnet.json"]);
    refused(&net, &deep, &["flow.json"]);
}

#[test]
fn odd_road_networks_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut Value), words: &[&str]| {
        let mut net = roadnet();
        change(&mut net);
        refused(&net.to_string(), &flows().to_string(), &[&["roadnet.json"], words].concat());
    };
    let link =
        |net: &mut Value, key: &str, value: Value| net["intersections"][4]["roadLinks"][1][key] = value;
    refused(&|net| link(net, "endRoad", json!("gone")), &["roadLink 1", "\"J\"", "\"gone\"", "missing"]);
    refused(&|net| link(net, "endRoad", json!("s_in")), &["roadLink 1", "do not meet"]);
    refused(
        &|net| link(net, "laneLinks", json!([{"startLaneIndex": 3, "endLaneIndex": 0}])),
        &["lane 3", "\"w_in\"", "3 lanes"],
    );
    refused(
        &|net| link(net, "laneLinks", json!([{"startLaneIndex": 0, "endLaneIndex": -1}])),
        &["lane -1", "\"e_out\""],
    );
    refused(&|net| net["roads"][0]["endIntersection"] = json!("gone"), &["\"w_in\"", "\"gone\""]);
    refused(&|net| net["roads"][0]["endIntersection"] = json!("w"), &["\"w_in\"", "starts and ends"]);
    refused(&|net| net["roads"][0]["lanes"] = json!([]), &["\"w_in\"", "0 lanes"]);
    refused(&|net| net["roads"][0]["lanes"][1]["maxSpeed"] = json!(-3), &["\"w_in\"", "maxSpeed -3"]);
    refused(&|net| net["roads"][0]["points"] = json!([{"x": 0, "y": 0}]), &["\"w_in\"", "two points"]);
    refused(&|net| net["roads"][0]["points"][0]["x"] = json!(1e300), &["\"w_in\"", "places"]);
    refused(&|net| net["roads"][1]["id"] = json!("w_in"), &["two roads", "\"w_in\""]);
    refused(&|net| net["roads"][0]["id"] = json!("a b"), &["\"a b\"", "rename"]);
    refused(&|net| net["intersections"][0]["id"] = json!("J"), &["two intersections", "\"J\""]);
    refused(&|net| net["roads"] = json!([]), &["no roads"]);
    refused(&|net| net["roads"] = json!(7), &["not a CityFlow roadnet file"]);
    let phase = |net: &mut Value, key: &str, value: Value| {
        net["intersections"][4]["trafficLight"]["lightphases"][1][key] = value;
    };
    refused(&|net| phase(net, "time", json!(-30)), &["phase 1", "\"J\"", "-30"]);
    refused(
        &|net| phase(net, "availableRoadLinks", json!([12])),
        &["phase 1", "roadLink 12", "12 roadLinks"],
    );
}

#[test]
fn a_file_larger_than_any_city_is_refused_unread() {
    let files = Files::new(&roadnet().to_string(), "");
    // A hole in the file: it takes no room, but reading it would.
    let file = std::fs::File::create(files.folder.path().join("flow.json")).unwrap();
    file.set_len(1 << 40).unwrap();
    let error = files.import().unwrap_err();
    assert!(matches!(error, ImportError::TooLarge { .. }), "{error}");
    let missing = import(
        &SumoHome::locate(None).unwrap(),
        &files.folder.path().join("nowhere.json"),
        files.folder.path(),
        &NewScenario {
            name: String::new(),
            description: String::new(),
            source: String::new(),
            folder: files.folder.path().join("town"),
            replace: false,
            end: 120,
            time_to_teleport: -1.0,
        },
    );
    assert!(missing.unwrap_err().to_string().contains("nowhere.json"));
}

#[test]
fn what_exists_is_not_overwritten() {
    let files = Files::new(&roadnet().to_string(), &flows().to_string());
    files.import().unwrap();
    assert!(matches!(files.import(), Err(ImportError::Generate(GenerateError::Exists { .. }))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Whatever happens to the bytes of a file, the answer is a result.
    #[test]
    fn damaged_files_never_panic(damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8), which in any::<bool>(), cut in any::<prop::sample::Index>()) {
        let (mut net, mut flow) = (roadnet().to_string().into_bytes(), flows().to_string().into_bytes());
        let bytes = if which { &mut net } else { &mut flow };
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        let cut = cut.index(4 * bytes.len()).max(1);
        bytes.truncate(cut);
        let files = Files::new("", "");
        std::fs::write(files.folder.path().join("roadnet.json"), net).unwrap();
        std::fs::write(files.folder.path().join("flow.json"), flow).unwrap();
        if let Err(error) = files.read() {
            prop_assert!(!error.to_string().is_empty());
        }
    }

    /// Whatever number or word stands at any place, the answer is a result; what is accepted has only departures in time.
    #[test]
    fn odd_values_never_panic(place in any::<prop::sample::Index>(), value in odd_value(), which in any::<bool>()) {
        let (mut net, mut flow) = (roadnet(), flows());
        let document = if which { &mut net } else { &mut flow };
        let count = leaves(document).len();
        *leaves(document).swap_remove(place.index(count)) = value;
        let files = Files::new(&net.to_string(), &flow.to_string());
        if let Err(error) = files.read() {
            prop_assert!(error.to_string().contains(".json"), "{error}");
        }
    }
}

fn odd_value() -> impl Strategy<Value = Value> {
    prop_oneof![
        any::<f64>().prop_map(|value| json!(value)),
        any::<i64>().prop_map(|value| json!(value)),
        (-3..40_i64).prop_map(|value| json!(value)),
        ".{0,6}".prop_map(|value| json!(value)),
        prop_oneof![Just("w_in"), Just("e_out"), Just("J"), Just("n")].prop_map(|value| json!(value)),
        Just(json!(null)),
        Just(json!([])),
        Just(json!({})),
    ]
}

/// Every value of a document that holds no other.
fn leaves(value: &mut Value) -> Vec<&mut Value> {
    match value {
        Value::Array(values) => values.iter_mut().flat_map(leaves).collect(),
        Value::Object(values) => values.values_mut().flat_map(leaves).collect(),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => vec![value],
    }
}
