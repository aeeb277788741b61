//! What holds for every grid that the options allow, without building it: `netconvert` refuses or repairs what contradicts
//! itself, and either would show far from its cause.

use super::demand::{self, Demand};
use super::grid::{self, GridOptions, RoadOptions};
use super::plain::PlainNet;
use proptest::prelude::*;
use quick_xml::events::Event;
use std::collections::{HashMap, HashSet};

fn road() -> impl Strategy<Value = RoadOptions> {
    (1..=8_u32, 1.0..60.0_f64).prop_map(|(lanes, speed)| RoadOptions { lanes, speed })
}

fn demand() -> impl Strategy<Value = Demand> {
    prop_oneof![
        (0..3000_u32, 1..4000_u32)
            .prop_map(|(vehicles_per_hour, duration)| Demand::Uniform { vehicles_per_hour, duration }),
        (0..3000_u32, 1..4000_u32)
            .prop_map(|(vehicles_per_hour, duration)| Demand::Peak { vehicles_per_hour, duration }),
        (0..3000_u32, 0..3000_u32, 30..700_u32, 0..3_u32).prop_map(
            |(first_peak, second_peak, slot_seconds, initial_per_lane)| Demand::TwoWave {
                first_peak,
                second_peak,
                slot_seconds,
                initial_per_lane
            }
        ),
    ]
}

prop_compose! {
    fn options()(
        columns in 1..8_u32,
        rows in 1..7_u32,
        spacing in 40.0..400.0_f64,
        fringe in 40.0..400.0_f64,
        closed in prop_oneof![Just(0.0), 0.0..0.5_f64],
        jitter in prop_oneof![Just(0.0), 0.0..60.0_f64],
        streets in road(),
        avenues in road(),
        right_on_red: bool,
        protected_left: bool,
        green_seconds in 1..90_u32,
        yellow_seconds in 0..6_u32,
        demand in demand(),
        seed: u64,
    ) -> GridOptions {
        GridOptions { columns, rows, spacing, fringe, closed, jitter, streets, avenues, right_on_red, protected_left, green_seconds, yellow_seconds, demand, seed }
    }
}

/// Lanes of each road that is there.
fn lanes(net: &PlainNet) -> HashMap<&str, usize> {
    net.edges.iter().map(|edge| (edge.id.as_str(), edge.lane_speeds.len())).collect()
}

fn route_file(options: &GridOptions) -> String {
    let mut text = Vec::new();
    demand::write(options, &mut text).unwrap();
    String::from_utf8(text).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn every_allowed_grid_hangs_together(options in options()) {
        prop_assume!(options.validate().is_ok());
        let net = grid::network(&options);
        let nodes: HashSet<_> = net.nodes.iter().map(|node| node.id.as_str()).collect();
        prop_assert_eq!(nodes.len(), net.nodes.len(), "no node twice");
        let lanes = lanes(&net);
        prop_assert_eq!(lanes.len(), net.edges.len(), "no road twice");
        for edge in &net.edges {
            prop_assert!(nodes.contains(edge.from.as_str()) && nodes.contains(edge.to.as_str()), "{:?}", edge);
        }
        let mut letters: HashMap<&str, Vec<usize>> = HashMap::new();
        for link in &net.connections {
            prop_assert!(lanes.get(link.from.as_str()).is_some_and(|&lanes| link.from_lane < lanes), "{:?}", link);
            prop_assert!(lanes.get(link.to.as_str()).is_some_and(|&lanes| link.to_lane < lanes), "{:?}", link);
            if let Some((light, letter)) = &link.signal {
                letters.entry(light).or_default().push(*letter);
            }
        }
        prop_assert_eq!(net.programs.len(), (options.columns * options.rows) as usize);
        for program in &net.programs {
            let mut letters = letters.remove(program.light.as_str()).unwrap_or_default();
            letters.sort_unstable();
            prop_assert_eq!(&letters, &(0..letters.len()).collect::<Vec<_>>(), "each link has its letter");
            prop_assert!(program.phases.iter().all(|(seconds, state)| *seconds > 0 && state.len() == letters.len()));
            let goes = |letter: usize| {
                program.phases.iter().any(|(_, state)| matches!(state.as_bytes()[letter], b'G' | b'g'))
            };
            prop_assert!(letters.into_iter().all(goes), "nobody waits for ever: {:?}", program);
        }
        prop_assert!(letters.is_empty(), "a link without a program: {:?}", letters);
    }

    #[test]
    fn demand_drives_on_roads_that_are_there_in_order_and_repeats(options in options()) {
        prop_assume!(options.validate().is_ok());
        let net = grid::network(&options);
        let lanes = lanes(&net);
        let text = route_file(&options);
        prop_assert_eq!(&text, &route_file(&options));
        let mut xml = quick_xml::Reader::from_str(&text);
        let (mut last, mut ids) = (0.0, HashSet::new());
        loop {
            let element = match xml.read_event().unwrap() {
                Event::Eof => break,
                Event::Empty(element) | Event::Start(element) => element,
                _ => continue,
            };
            let value = |key: &str| Some(element.try_get_attribute(key).unwrap()?.value.into_owned());
            if !matches!(element.name().as_ref(), "trip" | "flow") {
                continue;
            }
            prop_assert!(ids.insert(value("id")), "two are called {:?}", value("id"));
            for end in ["from", "to"] {
                prop_assert!(lanes.contains_key(value(end).unwrap().as_str()), "{:?} is no road", value(end));
            }
            let time: f64 = value("depart").or_else(|| value("begin")).unwrap().parse().unwrap();
            prop_assert!(time >= last, "SUMO wants them in order");
            last = time;
        }
    }

    /// Whatever number an option has, the answer is a result, and a refusal names the option.
    #[test]
    fn odd_options_are_refused_with_a_sentence(
        columns: u32, rows: u32, spacing: f64, fringe: f64, closed: f64, jitter: f64, lanes: u32, speed: f64, first in any::<[u32; 4]>(), which in 0..3,
    ) {
        let [a, b, c, d] = first;
        let demand = match which {
            0 => Demand::Uniform { vehicles_per_hour: a, duration: b },
            1 => Demand::Peak { vehicles_per_hour: a, duration: b },
            _ => Demand::TwoWave { first_peak: a, second_peak: b, slot_seconds: c, initial_per_lane: d },
        };
        for options in [
            GridOptions { columns, rows, ..GridOptions::default() },
            GridOptions { spacing, fringe, ..GridOptions::default() },
            GridOptions { closed, jitter, ..GridOptions::default() },
            GridOptions { streets: RoadOptions { lanes, speed }, ..GridOptions::default() },
            GridOptions { demand, ..GridOptions::default() },
        ] {
            if let Err(error) = options.validate() {
                prop_assert!(error.to_string().starts_with("cannot generate this grid: "), "{}", error);
            }
        }
    }
}
