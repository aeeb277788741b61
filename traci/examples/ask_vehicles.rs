//! Reads every vehicle of a network in two ways, by turns, and tells what each takes: a context subscription around a
//! junction for the moment, and getters in one message behind the list of ids.
//!
//! ```text
//! cargo run --release -p cross-traci --example ask_vehicles -- grid4x4.net.xml grid4x4_1.rou.xml
//! ```

use cross_traci::constants::vehicle;
use cross_traci::{Client, Domain, Sumo, SumoCommand, SumoHome, TraciError};
use std::error::Error;
use std::io::Write;
use std::time::{Duration, Instant};

const WANTED: [u8; 3] = [vehicle::LANE_ID, vehicle::LANE_POSITION, vehicle::SPEED];
/// Seconds between two looks: SUMO forgets a subscription that has ended with its next step only.
const PERIOD: f64 = 10.0;

/// By a subscription; gives the number of vehicles.
fn look_around(client: &mut Client, anywhere: &str) -> Result<usize, TraciError> {
    Ok(client.look_around(Domain::Junction, anywhere, 1e9, Domain::Vehicle, &WANTED)?.len())
}

/// By getters.
fn ask(client: &mut Client, ids: &mut Vec<String>) -> Result<usize, TraciError> {
    ids.clear();
    ids.extend(client.ids(Domain::Vehicle)?);
    let mut batch = client.batch();
    for id in ids.iter() {
        for variable in WANTED {
            batch.get(Domain::Vehicle, variable, id);
        }
    }
    Ok(batch.send()?.len() / WANTED.len())
}

fn median(times: &mut [Duration]) -> Duration {
    times.sort();
    times.get(times.len() / 2).copied().unwrap_or_default()
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(net), Some(routes)) = (arguments.next(), arguments.next()) else {
        return Err("usage: ask_vehicles NET.net.xml ROUTES.rou.xml".into());
    };
    let home = SumoHome::locate(None)?;
    let command = SumoCommand::new().option("-n", net).option("-r", routes);
    let mut sumo = Sumo::start(&home, &command, Duration::from_secs(60))?;
    let client = sumo.client();
    let anywhere = client.ids(Domain::Junction)?.into_iter().next().ok_or("the network has no junction")?;
    let mut out = std::io::stdout();
    writeln!(out, "{:>14}  {:>8}  {:>14}  {:>14}", "seconds", "vehicles", "subscription", "getters")?;
    let (mut time, mut ids) = (client.time()?, Vec::new());
    for _ in 0..6 {
        let (from, mut seen) = (time, 0);
        let (mut by_subscription, mut by_getters) = (Vec::new(), Vec::new());
        for _ in 0..60 {
            time += PERIOD;
            client.simulation_step(time)?;
            let begun = Instant::now();
            seen += look_around(client, &anywhere)?;
            by_subscription.push(begun.elapsed());
            let begun = Instant::now();
            ask(client, &mut ids)?;
            by_getters.push(begun.elapsed());
        }
        writeln!(
            out,
            "{:>14}  {:>8}  {:>11.3} ms  {:>11.3} ms",
            format!("{from} to {time}"),
            seen / 60,
            median(&mut by_subscription).as_secs_f64() * 1e3,
            median(&mut by_getters).as_secs_f64() * 1e3
        )?;
    }
    sumo.close()?;
    Ok(())
}
