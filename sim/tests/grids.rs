//! Grids: the scenarios that are generated on first use, and grids of a user's own, built and driven by the real SUMO.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cross_config::EnvConfig;
use cross_sim::env::{Env, EnvOptions};
use cross_sim::generate::{Demand, GenerateError, GridOptions, NewScenario, RoadOptions, generate_grid};
use cross_sim::layout::{NetworkLayout, load_layout};
use cross_sim::net::Net;
use cross_sim::scenario::Scenario;
use cross_traci::SumoHome;
use std::path::Path;

fn layout(scenario: &Scenario) -> NetworkLayout {
    (*load_layout(scenario, &EnvConfig::default()).unwrap()).clone()
}

fn new(folder: &Path) -> NewScenario {
    NewScenario {
        name: "mine".to_owned(),
        description: String::new(),
        source: String::new(),
        folder: folder.join("mine"),
        replace: false,
        end: 600,
        time_to_teleport: -1.0,
    }
}

fn generate(options: &GridOptions) -> (tempfile::TempDir, Scenario) {
    let folder = tempfile::tempdir().unwrap();
    let home = SumoHome::locate(None).expect("run `make build` first: it fetches SUMO");
    let path = generate_grid(&home, options, &new(folder.path())).unwrap();
    let scenario = Scenario::from_directory(&path).unwrap();
    (folder, scenario)
}

#[test]
fn grid5x5_is_as_published() {
    let scenario = Scenario::load("grid5x5").unwrap();
    assert_eq!((scenario.vehicles().unwrap(), scenario.sumo.time_to_teleport), (3682, 300.0));
    let layout = layout(&scenario);
    assert_eq!(layout.agents(), 25);
    assert_eq!(layout.intersections.iter().map(|at| at.incoming.len()).sum::<usize>(), 150);
    for intersection in &layout.intersections {
        assert_eq!(intersection.movements.len(), 12);
        let states: Vec<_> = intersection.phases.iter().map(|phase| phase.state.as_str()).collect();
        assert_eq!(states, ["GGgrrrGGgrrr", "rrrGrGrrrGrG", "rrrGGrrrrGGr", "rrrGGGrrrrrr", "rrrrrrrrrGGG"]);
    }
    let find = |id: &str| layout.intersections.iter().find(|at| at.id == id).unwrap();
    assert_eq!(
        (find("nt1").position, find("nt5").position, find("nt6").position),
        ((200.0, 200.0), (1000.0, 200.0), (200.0, 400.0))
    );
    let net = Net::read(&scenario.net).unwrap();
    assert_eq!(net.edges.iter().map(|edge| edge.lanes.len()).sum::<usize>(), 180);
    for (edge, lanes, length, speed) in [
        ("nt1_nt2", 2, 185.6, 20.0),
        ("nt1_nt6", 1, 179.2, 11.0),
        ("np20_nt1", 2, 192.8, 20.0),
        ("np1_nt1", 1, 189.6, 11.0),
    ] {
        let edge = net.edge(edge).unwrap();
        assert_eq!(
            (edge.lanes.len(), edge.lanes[0].length, edge.lanes[0].speed),
            (lanes, length, speed),
            "{}",
            edge.id
        );
    }
    // An avenue's lane turns right into the outer lane of the street and left into its inner one.
    let north = &find("nt7").movements;
    let lane = |movement: usize| find("nt7").outgoing[north[movement].outgoing].id.clone();
    assert_eq!([lane(0), lane(1), lane(2)], ["nt7_nt6_0", "nt7_nt2_0", "nt7_nt8_1"]);
}

#[test]
fn grid5x5_heavy_has_the_published_volume() {
    let scenario = Scenario::load("grid5x5-heavy").unwrap();
    let arrivals = scenario.arrivals().unwrap();
    let rounded = [arrivals.volume(), arrivals.mean(), arrivals.max(), arrivals.min()]
        .map(|value| (value * 100.0).round());
    assert_eq!(rounded, [729_600.0, 12_160.0, 75_200.0, 3_200.0]);
    for name in ["grid5x5", "grid5x5-mid", "grid5x5-light"] {
        let other = Scenario::load(name).unwrap();
        assert_eq!(scenario.net_hash, other.net_hash, "{name}: only the demand differs");
        assert_eq!(scenario.reference, other.reference, "{name}");
        assert!(other.vehicles().unwrap() < scenario.vehicles().unwrap(), "{name}");
    }
}

#[test]
fn the_varied_grids_are_those_that_are_pinned_and_differ_in_shape() {
    let shapes = [1, 2, 3, 4].map(|number| {
        // Loading compares the files that are built with the pins.
        let scenario = Scenario::load(&format!("varied{number}")).unwrap();
        let layout = layout(&scenario);
        let first = &layout.intersections[0];
        assert!(layout.intersections.iter().all(|at| at.movements.len() == 12), "varied{number}");
        (layout.agents(), first.phases.len(), first.incoming.len(), scenario.vehicles().unwrap())
    });
    assert_eq!(shapes, [(9, 8, 12, 4500), (8, 8, 10, 3000), (6, 8, 8, 2500), (9, 2, 4, 2400)]);
}

#[test]
fn the_irregular_ones_have_junctions_of_three_arms_and_phases_for_left_turns_alone() {
    for (number, agents, three_arms, protected) in [(5, 16, 8, 16), (6, 12, 7, 9)] {
        let scenario = Scenario::load(&format!("varied{number}")).unwrap();
        let layout = layout(&scenario);
        assert_eq!((layout.agents(), scenario.vehicles().unwrap()), (agents, 1800), "varied{number}");
        assert!(layout.intersections.iter().all(|at| (3..=4).contains(&at.roads_in.len())));
        let three = layout.intersections.iter().filter(|at| at.roads_in.len() == 3);
        assert_eq!(three.count(), three_arms, "varied{number}");
        // A phase in which nobody goes but some of a lane, the others of the same lane wait, and its left turns are protected:
        // those who turn left have the last link of their lane.
        let alone = layout.intersections.iter().filter(|at| {
            at.phases.iter().any(|phase| {
                let last_of_a_shared_lane = |link: usize| {
                    let lane = at.movements[link].incoming;
                    let of_lane = |other: usize| at.movements[other].incoming == lane;
                    (0..link).any(of_lane) && !(link + 1..at.movements.len()).any(of_lane)
                };
                let mut goes = (0..at.movements.len()).filter(|&link| phase.green[link] > 0.0);
                goes.all(|link| last_of_a_shared_lane(link) && phase.green[link] == 1.0)
            })
        });
        assert_eq!(alone.count(), protected, "varied{number}");
    }
}

#[test]
fn arrivals_are_described_as_published() {
    for (name, published) in
        [("grid4x4", [1473.0, 24.55, 13.89, 72.0, 6.0]), ("arterial4x4", [2484.0, 41.4, 24.69, 88.0, 10.0])]
    {
        let arrivals = Scenario::load(name).unwrap().arrivals().unwrap();
        let found = [arrivals.volume(), arrivals.mean(), arrivals.std(), arrivals.max(), arrivals.min()];
        assert_eq!(found.map(|value| (value * 100.0).round() / 100.0), published, "{name}");
    }
}

#[test]
fn the_same_options_give_the_same_files() {
    let demand = Demand::Uniform { vehicles_per_hour: 600, duration: 600 };
    let options = GridOptions { columns: 2, rows: 3, demand, ..GridOptions::default() };
    let (_first, first) = generate(&options);
    let (_second, second) = generate(&options);
    assert_eq!((&first.net_hash, &first.demand_hash), (&second.net_hash, &second.demand_hash));
    let (_third, third) = generate(&GridOptions { seed: 1, ..options });
    assert_eq!(first.net_hash, third.net_hash);
    assert_ne!(first.demand_hash, third.demand_hash);
}

#[test]
fn grids_of_many_shapes_are_built_as_asked_for() {
    let road = |lanes| RoadOptions { lanes, speed: 14.0 };
    for (columns, rows, streets, avenues, movements, phases) in [
        (1, 1, 1, 1, 12, 2),
        (1, 4, 2, 2, 12, 8),
        (3, 1, 3, 1, 12, 5),
        (2, 2, 4, 3, 14, 8),
        (2, 2, 6, 6, 24, 8),
    ] {
        let options = GridOptions {
            columns,
            rows,
            streets: road(streets),
            avenues: road(avenues),
            right_on_red: columns == 3,
            ..GridOptions::default()
        };
        let (_folder, scenario) = generate(&options);
        let layout = layout(&scenario);
        assert_eq!(layout.agents(), (columns * rows) as usize);
        for intersection in &layout.intersections {
            let shape =
                (intersection.movements.len(), intersection.phases.len(), intersection.incoming.len());
            assert_eq!(shape, (movements, phases, 2 * (streets + avenues) as usize), "{columns}x{rows}");
            // Nobody waits for ever.
            let served = |link: usize| intersection.phases.iter().any(|phase| phase.green[link] > 0.0);
            assert!((0..movements).all(served), "{columns}x{rows}");
        }
    }
}

#[test]
fn irregular_grids_are_built_as_asked_for_and_everybody_is_served() {
    let road = |lanes| RoadOptions { lanes, speed: 14.0 };
    for (streets, avenues, seed) in [(1, 1, 1), (2, 1, 2), (3, 3, 3), (4, 2, 4)] {
        let demand = Demand::Uniform { vehicles_per_hour: 900, duration: 600 };
        let options = GridOptions {
            columns: 3,
            rows: 3,
            closed: 0.3,
            jitter: 30.0,
            streets: road(streets),
            avenues: road(avenues),
            protected_left: true,
            right_on_red: seed == 2,
            demand,
            seed,
            ..GridOptions::default()
        };
        let (_folder, scenario) = generate(&options);
        let layout = layout(&scenario);
        assert_eq!(layout.agents(), 9);
        assert!(layout.intersections.iter().any(|at| at.roads_in.len() == 3));
        for intersection in &layout.intersections {
            assert!((2..=8).contains(&intersection.phases.len()), "{:?}", intersection.phases);
            let served = |link: usize| intersection.phases.iter().any(|phase| phase.green[link] > 0.0);
            assert!((0..intersection.movements.len()).all(served), "{}", intersection.id);
        }
        let env = EnvOptions::default();
        let mut env = Env::new(&SumoHome::locate(None).unwrap(), &scenario, env).unwrap();
        env.reset(1).unwrap();
        for step in 0..60 {
            let phases: Vec<u8> =
                layout.intersections.iter().map(|at| (step % at.phases.len()) as u8).collect();
            env.step(&phases).unwrap();
        }
        env.close().unwrap();
        let (_again, again) = generate(&options);
        assert_eq!(scenario.net_hash, again.net_hash, "the same options give the same net");
    }
}

#[test]
fn a_generated_grid_can_be_driven() {
    let demand = Demand::Peak { vehicles_per_hour: 1800, duration: 300 };
    let road = RoadOptions { lanes: 3, speed: 13.89 };
    let options = GridOptions {
        columns: 2,
        rows: 2,
        streets: road.clone(),
        avenues: road,
        demand,
        ..GridOptions::default()
    };
    let (_folder, scenario) = generate(&options);
    let home = SumoHome::locate(None).unwrap();
    let tripinfo = scenario.directory.join("tripinfo.xml");
    let env = EnvOptions { tripinfo: Some(tripinfo.clone()), ..EnvOptions::default() };
    let mut env = Env::new(&home, &scenario, env).unwrap();
    env.reset(1).unwrap();
    for step in 0..60_u8 {
        env.step(&[step % 8; 4]).unwrap();
    }
    env.close().unwrap();
    let trips = std::fs::read_to_string(tripinfo).unwrap();
    let arrived = |line: &&str| line.contains("<tripinfo ") && !line.contains("arrival=\"-1");
    let finished = trips.lines().filter(arrived).count();
    assert!(finished > 75, "of 150 vehicles {finished} arrived");
}

#[test]
fn impossible_grids_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let home = SumoHome::locate(None).unwrap();
    for (options, words) in [
        (GridOptions { columns: 0, ..GridOptions::default() }, "columns is 0"),
        (GridOptions { rows: 51, ..GridOptions::default() }, "rows is 51"),
        (GridOptions { spacing: f64::INFINITY, ..GridOptions::default() }, "spacing is inf"),
        (
            GridOptions { streets: RoadOptions { lanes: 9, speed: 20.0 }, ..GridOptions::default() },
            "streets.lanes is 9",
        ),
        (
            GridOptions { avenues: RoadOptions { lanes: 1, speed: -1.0 }, ..GridOptions::default() },
            "avenues.speed is -1",
        ),
        (
            GridOptions {
                spacing: 50.0,
                streets: RoadOptions { lanes: 8, speed: 20.0 },
                ..GridOptions::default()
            },
            "too short",
        ),
    ] {
        let error = generate_grid(&home, &options, &new(folder.path())).unwrap_err();
        assert!(matches!(error, GenerateError::Option { .. }), "{error}");
        assert!(error.to_string().contains(words), "{error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn files_that_are_not_the_pinned_ones_are_refused() {
    let demand = Demand::Uniform { vehicles_per_hour: 600, duration: 600 };
    let (_folder, scenario) =
        generate(&GridOptions { columns: 1, rows: 1, demand, ..GridOptions::default() });
    let path = scenario.directory.join("scenario.toml");
    let pin = |net: &str| {
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.split("[pin]").next().unwrap().to_owned();
        std::fs::write(
            &path,
            format!("{text}[pin]\nnet = \"{net}\"\ndemand = \"{}\"\n", scenario.demand_hash),
        )
        .unwrap();
    };
    pin(&scenario.net_hash);
    assert_eq!(Scenario::from_directory(&scenario.directory).unwrap().net_hash, scenario.net_hash);
    pin("0123");
    let error = Scenario::from_directory(&scenario.directory).unwrap_err().to_string();
    assert!(error.contains("the net of scenario \"mine\"") && error.contains("0123"), "{error}");
    pin(&scenario.net_hash);
    std::fs::write(&scenario.routes[0], "<routes/>").unwrap();
    let error = Scenario::from_directory(&scenario.directory).unwrap_err().to_string();
    assert!(error.contains("the demand of scenario \"mine\""), "{error}");
}

#[test]
fn a_data_set_that_was_not_imported_is_known_but_not_listed() {
    let folder = tempfile::tempdir().unwrap();
    let town = folder.path().join("faraway");
    std::fs::create_dir(&town).unwrap();
    std::fs::write(
        town.join("scenario.toml"),
        "net = \"@deps/scenarios/faraway/net.net.xml\"\nroutes = [\"@deps/scenarios/faraway/demand.rou.xml\"]\nend = 60\n\
         [import.cityflow]\nroadnet = \"roads.json\"\nflow = \"cars.json\"\n",
    )
    .unwrap();
    let path = cross_sim::scenario::ScenarioPath::locate(Some(folder.path()));
    assert!(path.list().iter().all(|entry| entry.name != "faraway"));
    assert!(path.catalogue().iter().any(|entry| entry.name == "faraway"));
    let error = path.load("faraway").unwrap_err().to_string();
    assert!(
        error.contains("cross scenario import cityflow --roadnet roads.json --flow cars.json --name faraway"),
        "{error}"
    );
}
