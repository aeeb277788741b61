//! Nets as they occur and as they should not: what is read, and what is refused with which words.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{link, net, program};
use cross_config::EnvConfig;
use cross_sim::layout::{LayoutError, NetworkLayout};
use cross_sim::net::{Net, NetError};
use proptest::prelude::*;
use std::io::Write;
use std::path::Path;

const PATH: &str = "town.net.xml";

fn parse(text: &str) -> Result<Net, NetError> {
    Net::parse(text.as_bytes(), Path::new(PATH))
}

fn layout(text: &str) -> Result<NetworkLayout, LayoutError> {
    NetworkLayout::from_net(&parse(text).unwrap(), &EnvConfig::default())
}

fn two_links() -> String {
    link("J", 0, 0, 0) + &link("J", 1, 1, 1)
}

#[test]
fn a_small_net_becomes_the_expected_intersection() {
    let text = net(2, 2, &program("J", "0", &["Gr", "yr", "rg", "ry"]), &two_links());
    let layout = layout(&text).unwrap();
    let at = &layout.intersections[0];
    assert_eq!((at.id.as_str(), at.position), ("J", (0.5, 7.0)));
    assert_eq!(
        at.incoming.iter().map(|lane| (lane.id.as_str(), lane.length)).collect::<Vec<_>>(),
        [("in_0", 100.5), ("in_1", 101.5)]
    );
    assert_eq!(
        at.phases.iter().map(|phase| phase.green.as_slice()).collect::<Vec<_>>(),
        [[1.0, 0.0], [0.0, 0.5]]
    );
    let road = &at.roads_in[0];
    assert_eq!(
        (road.id.as_str(), road.lanes, road.movements, road.length, road.speed),
        ("in", 2, 2, 101.0, 13.89)
    );
}

#[test]
fn links_are_ordered_by_index_and_may_share_one_or_leave_gaps() {
    // Index 3 first in the file, index 1 twice, indices 0 and 2 of no connection, and states longer than any index.
    let connections = link("J", 3, 0, 0) + &link("J", 1, 1, 1) + &link("J", 1, 1, 0);
    let text = net(2, 2, &program("J", "0", &["rGrrrr", "rrrgrr"]), &connections);
    let at = &layout(&text).unwrap().intersections[0];
    assert_eq!(
        at.movements.iter().map(|m| (m.incoming, m.outgoing)).collect::<Vec<_>>(),
        [(0, 0), (0, 1), (1, 1)]
    );
    assert_eq!(at.incoming[0].id, "in_1");
    assert_eq!(at.phases[0].green, [1.0, 1.0, 0.0]);
    assert_eq!(at.phases[1].green, [0.0, 0.0, 0.5]);
    assert_eq!(at.phases[0].state, "rGrrrr");
}

#[test]
fn transitions_all_red_and_repeated_states_are_no_phases() {
    let states = ["Grs", "yrs", "rrr", "rGs", "Gyr", "Grs", "uGr", "rrG"];
    let connections = two_links() + &link("J", 2, 0, 1);
    let at = &layout(&net(2, 2, &program("J", "0", &states), &connections)).unwrap().intersections[0];
    let phases: Vec<_> = at.phases.iter().map(|phase| phase.state.as_str()).collect();
    assert_eq!(phases, ["Grs", "rGs", "rrG"]);
    // Right turn on red is no green.
    assert_eq!(at.phases[0].green, [1.0, 0.0, 0.0]);
}

#[test]
fn the_program_named_0_counts_among_several_wherever_it_stands() {
    let programs = program("J", "night", &["GG", "gg"])
        + &program("J", "off", &[])
        + &program("J", "0", &["Gr", "rG", "rg"]);
    assert_eq!(layout(&net(2, 2, &programs, &two_links())).unwrap().intersections[0].phases.len(), 3);
    let programs =
        program("J", "off", &[]) + &program("J", "day", &["Gr", "rG"]) + &program("J", "night", &["GG"]);
    assert_eq!(layout(&net(2, 2, &programs, &two_links())).unwrap().intersections[0].phases.len(), 2);
}

#[test]
fn one_light_over_two_junctions_is_one_agent_between_them() {
    let second =
        "<edge id=\"in2\" to=\"E\"><lane id=\"in2_0\" index=\"0\" speed=\"5\" length=\"50\"/></edge>";
    let connection = "<connection from=\"in2\" to=\"out\" fromLane=\"0\" toLane=\"0\" tl=\"both\" linkIndex=\"1\" dir=\"s\"/>";
    let text = net(
        1,
        1,
        &(second.to_owned() + &program("both", "0", &["Gr", "rG"])),
        &(link("both", 0, 0, 0) + connection),
    );
    let at = &layout(&text).unwrap().intersections[0];
    assert_eq!(at.position, (60.25, 7.0));
    assert_eq!(at.roads_in.len(), 2);
}

#[test]
fn pedestrian_crossings_are_links_without_movement() {
    let crossing = "<connection from=\":J_w0\" to=\":J_c0\" fromLane=\"0\" toLane=\"0\" tl=\"J\" linkIndex=\"2\" dir=\"s\"/>";
    let text = net(2, 2, &program("J", "0", &["GrG", "rGr"]), &(two_links() + crossing));
    assert_eq!(layout(&text).unwrap().intersections[0].movements.len(), 2);
}

#[test]
fn links_for_turning_round_are_told_apart_and_other_layouts_keep_their_hash() {
    let programs = program("J", "0", &["Gr", "rG"]);
    let onwards = layout(&net(2, 2, &programs, &two_links())).unwrap();
    assert!(onwards.intersections[0].movements.iter().all(|movement| !movement.turnaround));
    // As before there was the field.
    assert!(!serde_json::to_string(&onwards).unwrap().contains("turnaround"));
    for direction in ["t", "T"] {
        let second = link("J", 1, 1, 1).replace("dir=\"s\"", &format!("dir=\"{direction}\""));
        let round = layout(&net(2, 2, &programs, &(link("J", 0, 0, 0) + &second))).unwrap();
        let movements = round.intersections[0].movements.iter();
        assert_eq!(movements.map(|movement| movement.turnaround).collect::<Vec<_>>(), [false, true]);
        assert_ne!(round.hash(), onwards.hash());
    }
}

/// A road with one lane of 60 m, and the connections of it.
fn road(id: &str, to: &[(&str, usize)]) -> String {
    let lane = format!("<lane id=\"{id}_0\" index=\"0\" speed=\"5\" length=\"60\"/>");
    let mut text = format!("<edge id=\"{id}\" to=\"W\">{lane}</edge>");
    for (edge, index) in to {
        text +=
            &format!("<connection from=\"{id}\" to=\"{edge}\" fromLane=\"0\" toLane=\"{index}\" dir=\"s\"/>");
    }
    text
}

/// Ids and metres of what is behind each incoming lane.
fn behind(roads: &str) -> Vec<Vec<(String, f32)>> {
    let programs = program("J", "0", &["Gr", "rG"]) + roads;
    let layout = layout(&net(2, 2, &programs, &two_links())).unwrap();
    let lanes = layout.intersections[0].incoming.iter();
    lanes.map(|lane| lane.behind.iter().map(|behind| (behind.id.clone(), behind.metres)).collect()).collect()
}

#[test]
fn what_leads_to_an_incoming_lanes_road_alone_is_behind_it() {
    // The incoming lanes are 100.5 and 101.5 m long.
    let at = |id: &str, metres: f32| (id.to_owned(), metres);
    assert_eq!(behind(""), [[], []]);
    // The same street three times; the last one begins to be behind it beyond 200 m.
    let street =
        road("near", &[("in", 0)]) + &road("middle", &[("near", 0)]) + &road("far", &[("middle", 0)]);
    assert_eq!(behind(&street), [vec![at("near_0", 100.5), at("middle_0", 160.5)], vec![]]);
    // To both lanes of the road.
    let wide = behind(&road("before", &[("in", 0), ("in", 1)]));
    assert_eq!(wide, [[at("before_0", 100.5)], [at("before_0", 101.5)]]);
    // Who is on a road that leads elsewhere too need not come.
    assert_eq!(behind(&road("before", &[("in", 0), ("out", 0)])), [[], []]);
}

#[test]
fn odd_connections_without_a_signal_are_no_reason_to_refuse_a_net() {
    for odd in [
        "<connection from=\"in\" to=\"nowhere\" fromLane=\"0\" toLane=\"0\" dir=\"s\"/>",
        "<connection from=\"in\" to=\"out\" fromLane=\"7\" toLane=\"0\" dir=\"s\"/>",
        "<connection from=\"in\" to=\"out\" fromLane=\"x\" toLane=\"0\" dir=\"s\"/>",
        "<connection from=\"in\"/>",
    ] {
        assert_eq!(behind(odd), [[], []], "{odd}");
    }
}

#[test]
fn what_is_behind_is_found_once_and_not_without_end() {
    let twice = road("a", &[("in", 0)]) + &road("b", &[("a", 0), ("a", 0)]);
    assert_eq!(behind(&twice)[0], [("a_0".to_owned(), 100.5), ("b_0".to_owned(), 160.5)]);
    // A hundred lanes without length to speak of.
    let mut points = String::new();
    for number in 0..100 {
        let to = if number == 0 { "in".to_owned() } else { format!("p{}", number - 1) };
        points += &road(&format!("p{number}"), &[(&to, 0)]).replace("length=\"60\"", "length=\"0.1\"");
    }
    assert_eq!(behind(&points)[0].len(), 16);
}

#[test]
fn what_an_outgoing_lane_leads_to_is_beyond_it_up_to_a_choice() {
    let onwards = "<connection from=\"out\" to=\"next\" fromLane=\"0\" toLane=\"0\" dir=\"s\"/>";
    let back = "<connection from=\"out\" to=\"in\" fromLane=\"0\" toLane=\"0\" dir=\"t\"/>";
    let roads = road("next", &[("last", 0)]) + &road("last", &[("left", 0), ("right", 0)]);
    let roads = roads + &road("left", &[]) + &road("right", &[]) + onwards + back;
    let layout = layout(&net(2, 2, &(program("J", "0", &["Gr", "rG"]) + &roads), &two_links())).unwrap();
    let behind = |lane: &cross_sim::layout::Lane| lane.behind.is_empty();
    assert!(layout.intersections[0].incoming.iter().all(behind), "turning round leads nowhere");
    let lanes = layout.intersections[0].outgoing.iter();
    let beyond: Vec<Vec<(&str, f32)>> =
        lanes.map(|lane| lane.beyond.iter().map(|own| (own.id.as_str(), own.metres)).collect()).collect();
    // The metres are those to the end of `last`.
    assert_eq!(beyond, [vec![("next_0", 60.0), ("last_0", 0.0)], vec![]]);
    assert_eq!(layout.intersections[0].outgoing[0].reach(), 100.5 + 120.0);
}

#[test]
fn lights_without_a_choice_keep_their_program() {
    let programs = program("J", "0", &["Gr", "rG"])
        + &program("always", "0", &["G"])
        + &program("walkers", "0", &["G", "g"]);
    let text = net(2, 2, &programs, &(two_links() + &link("always", 0, 0, 1)));
    let net = parse(&text).unwrap();
    let layout = NetworkLayout::from_net(&net, &EnvConfig::default()).unwrap();
    assert_eq!(layout.agents(), 1);
    let fixed: Vec<_> =
        NetworkLayout::fixed_signals(&net).into_iter().map(|at| (at.id, at.phases, at.movements)).collect();
    assert_eq!(fixed, [("always".to_owned(), 1, 1), ("walkers".to_owned(), 2, 0)]);
}

#[test]
fn nets_that_leave_nothing_to_control_are_refused() {
    assert!(matches!(layout(&net(2, 2, "", "")), Err(LayoutError::NoSignals { .. })));
    let error = layout(&net(2, 2, &program("J", "0", &["GG", "yy", "rr"]), &two_links())).unwrap_err();
    assert!(matches!(error, LayoutError::NoAgents { lights: 1, .. }), "{error}");
    assert!(error.to_string().contains(PATH), "{error}");
}

#[test]
fn too_many_movements_are_refused_with_both_numbers() {
    let of = |movements: usize| {
        let connections: String = (0..movements).map(|index| link("J", index, index, 0)).collect();
        let states = ["G".repeat(movements), "g".repeat(movements)];
        layout(&net(movements, 1, &program("J", "0", &[&states[0], &states[1]]), &connections))
    };
    assert_eq!(of(36).unwrap().intersections[0].movements.len(), 36);
    let error = of(37).unwrap_err().to_string();
    assert!(["\"J\"", "37 movements", "36", PATH].iter().all(|part| error.contains(part)), "{error}");
}

#[test]
fn too_many_phases_are_refused_with_both_numbers() {
    let of = |phases: usize| {
        let states: Vec<_> =
            (0..phases).map(|phase| format!("{}G{}", "r".repeat(phase), "r".repeat(8 - phase))).collect();
        let states: Vec<_> = states.iter().map(String::as_str).collect();
        layout(&net(2, 2, &program("J", "0", &states), &two_links()))
    };
    assert_eq!(of(8).unwrap().intersections[0].phases.len(), 8);
    let error = of(9).unwrap_err().to_string();
    assert!(["\"J\"", "9 green phases", "8", PATH].iter().all(|part| error.contains(part)), "{error}");
}

#[test]
fn states_that_do_not_fit_the_links_are_refused() {
    let error = layout(&net(2, 2, &program("J", "0", &["G", "g"]), &two_links())).unwrap_err();
    assert!(matches!(error, LayoutError::ShortState { index: 1, .. }), "{error}");
    let error = layout(&net(2, 2, &program("J", "0", &["Gr", "rGr"]), &two_links())).unwrap_err();
    assert!(matches!(error, LayoutError::UnevenStates { lengths: (2, 3), .. }), "{error}");
}

#[test]
fn contradictions_are_named() {
    let good = net(2, 2, &program("J", "0", &["Gr", "rG"]), &two_links());
    for (from, to, words) in [
        ("tl=\"J\" linkIndex=\"1\"", "tl=\"J\"", "linkIndex"),
        ("linkIndex=\"1\"", "linkIndex=\"-1\"", "linkIndex=\"-1\""),
        ("fromLane=\"1\"", "fromLane=\"7\"", "lane 7 of edge \"in\""),
        ("to=\"out\" fromLane", "to=\"gone\" fromLane", "edge \"gone\""),
        ("state=\"Gr\"", "state=\"G?\"", "'?'"),
        ("state=\"Gr\"", "", "state"),
        ("length=\"101.5\"", "length=\"NaN\"", "length"),
        ("length=\"101.5\"", "length=\"-3\"", "length"),
        ("x=\"0.5\"", "x=\"east\"", "x=\"east\""),
        ("index=\"1\"", "index=\"4\"", "not numbered"),
    ] {
        let text = good.replace(from, to);
        assert_ne!(text, good, "{from}");
        let error = parse(&text).unwrap_err();
        assert!(matches!(error, NetError::Content { .. }), "{error}");
        let error = error.to_string();
        assert!(error.contains(words) && error.contains(PATH), "{error}");
    }
}

#[test]
fn shapes_of_lanes_are_read_and_odd_ones_named() {
    let good = net(2, 2, &program("J", "0", &["Gr", "rG"]), &two_links());
    let with = |shape: &str| {
        parse(&good.replace("length=\"101.5\"", &format!("length=\"101.5\" shape=\"{shape}\"")))
    };
    let lane = |shape: &str| with(shape).unwrap().edge("in").unwrap().lanes[1].shape.clone();
    assert_eq!(parse(&good).unwrap().edge("in").unwrap().lanes[1].shape, [[0.0; 2]; 0]);
    assert_eq!(lane("0,1 -2.5,3e1"), [[0.0, 1.0], [-2.5, 30.0]]);
    assert_eq!(lane(" 0,1,7  2,3,8 "), [[0.0, 1.0], [2.0, 3.0]], "the third is height");
    assert_eq!(lane(""), [[0.0; 2]; 0]);
    for odd in ["0", "0,", "0,1 2", "0,north", "NaN,0", "inf,0"] {
        let error = with(odd).unwrap_err().to_string();
        assert!([odd, "in_1", "list of positions", PATH].iter().all(|part| error.contains(part)), "{error}");
    }
}

#[test]
fn files_that_are_no_nets_are_named_and_explained() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.net.xml");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let error = Net::read(&path).unwrap_err();
        assert!(error.to_string().contains("bad.net.xml"), "{error}");
        error
    };
    let good = net(2, 2, &program("J", "0", &["Gr", "rG"]), &two_links());
    assert!(matches!(read(b"PK\x03\x04 not xml at all"), NetError::NotANet { .. }));
    assert!(matches!(read(b""), NetError::NotANet { .. }));
    assert!(
        matches!(read(b"<routes><vehicle/></routes>"), NetError::NotANet { root, .. } if root == "routes")
    );
    assert!(matches!(read(good.replace("</edge>", "</egde>").as_bytes()), NetError::Xml { .. }));
    assert!(matches!(read(&[b"<net>\xff\xfe", good.as_bytes()].concat()), NetError::Xml { .. }));
    assert!(
        matches!(read(good.replace("</net>", "").as_bytes()), NetError::Truncated { element, .. } if element == "net")
    );
    let inside_a_tag = good.find("linkIndex").unwrap();
    assert!(matches!(read(&good.as_bytes()[..inside_a_tag]), NetError::Truncated { .. }));
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(Net::read(&path), Err(NetError::Read { .. })));
    assert!(matches!(Net::read(folder.path()), Err(NetError::Read { .. })));
}

#[test]
fn compressed_nets_read_alike_and_cut_off_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("town.net.xml.gz");
    let good = net(2, 2, &program("J", "0", &["Gr", "rG"]), &two_links());
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(good.as_bytes()).unwrap();
    let bytes = encoder.finish().unwrap();
    std::fs::write(&path, &bytes).unwrap();
    let env = EnvConfig::default();
    let compressed = NetworkLayout::from_net(&Net::read(&path).unwrap(), &env).unwrap();
    assert_eq!(compressed, layout(&good).unwrap());
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let error = Net::read(&path).unwrap_err().to_string();
    assert!(error.contains("town.net.xml.gz"), "{error}");
}

fn mutated() -> impl Strategy<Value = Vec<u8>> {
    let good = net(2, 2, &program("J", "0", &["Gr", "rG"]), &two_links()).into_bytes();
    let length = good.len();
    let edit = (0..length, 0..40usize, prop::collection::vec(any::<u8>(), 0..12));
    (prop::collection::vec(edit, 1..6), 0..=length).prop_map(move |(edits, cut)| {
        let mut bytes = good.clone();
        for (at, removed, inserted) in edits {
            let at = at.min(bytes.len());
            let end = (at + removed).min(bytes.len());
            bytes.splice(at..end, inserted);
        }
        // Half of the cases keep their end.
        if cut % 2 == 0 {
            bytes.truncate(cut);
        }
        bytes
    })
}

/// Numbers and letters changed inside an otherwise sound net, so that what is read contradicts itself.
fn renumbered() -> impl Strategy<Value = Vec<u8>> {
    let good = net(2, 2, &program("J", "0", &["Gr", "rG"]), &two_links());
    let spots: Vec<usize> = good
        .bytes()
        .enumerate()
        .filter(|(_, byte)| byte.is_ascii_digit() || b"Grg".contains(byte))
        .map(|(at, _)| at)
        .collect();
    let letters = prop::sample::select(b"0123456789-.eGgrysuoO\"".to_vec());
    prop::collection::vec((prop::sample::select(spots), letters), 1..8).prop_map(move |edits| {
        let mut bytes = good.clone().into_bytes();
        for (at, letter) in edits {
            bytes[at] = letter;
        }
        bytes
    })
}

#[test]
fn an_element_with_absurdly_many_attributes_is_refused_before_they_are_compared() {
    let attributes: String = (0..200_000).map(|number| format!(" a{number}=''")).collect();
    let error = parse(&format!("<net><edge id='e'{attributes}/></net>")).unwrap_err().to_string();
    assert!(error.contains("more than 256 attributes"), "{error}");
}

#[test]
fn a_small_compressed_file_cannot_fill_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.net.xml.gz");
    let mut file = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    file.write_all(b"<net><!--").unwrap();
    for _ in 0..20 {
        file.write_all(&vec![b' '; 1 << 20]).unwrap();
    }
    std::fs::write(&path, file.finish().unwrap()).unwrap();
    let error = Net::read(&path).unwrap_err().to_string();
    assert!(error.contains("a single tag or text in it has more than"), "{error}");
}

proptest! {
    #[test]
    fn no_input_makes_the_reader_panic(bytes in prop_oneof![mutated(), renumbered()]) {
        if let Ok(net) = Net::parse(bytes.as_slice(), Path::new(PATH)) {
            // Nor does a net that it accepts make the layout panic.
            let _ = NetworkLayout::from_net(&net, &EnvConfig::default());
            let _ = NetworkLayout::fixed_signals(&net);
        }
    }
}
