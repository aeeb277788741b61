//! Sees every vehicle of a network every ten seconds, one message for the seconds and one for the vehicles.
//!
//! ```text
//! cargo run --release -p cross-traci --example watch_vehicles -- grid4x4.net.xml grid4x4_1.rou.xml
//! ```

use cross_traci::constants::vehicle;
use cross_traci::{Domain, Sumo, SumoCommand, SumoHome};
use std::error::Error;
use std::io::Write;
use std::time::{Duration, Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(net), Some(routes)) = (arguments.next(), arguments.next()) else {
        return Err("usage: watch_vehicles NET.net.xml ROUTES.rou.xml [SECONDS] [PERIOD]".into());
    };
    let mut number = |default: f64| -> Result<f64, Box<dyn Error>> {
        match arguments.next() {
            Some(text) => Ok(text.to_string_lossy().parse()?),
            None => Ok(default),
        }
    };
    let (end, period) = (number(600.0)?, number(10.0)?);

    let home = SumoHome::locate(None)?;
    let command = SumoCommand::new().option("-n", net).option("-r", routes);
    let mut sumo = Sumo::start(&home, &command, Duration::from_secs(60))?;
    let begun = Instant::now();

    let client = sumo.client();
    let anywhere = client.ids(Domain::Junction)?.into_iter().next().ok_or("the network has no junction")?;
    let wanted = [vehicle::LANE_ID, vehicle::LANE_POSITION, vehicle::SPEED];

    let (mut time, mut seen) = (client.time()?, 0u64);
    let mut out = std::io::stdout();
    while time < end {
        time += period;
        client.simulation_step(time)?;
        let vehicles = client.look_around(Domain::Junction, &anywhere, 1e9, Domain::Vehicle, &wanted)?;
        let (mut stopped, mut running) = (0, 0);
        for vehicle in vehicles.objects() {
            running += 1;
            if vehicle
                .get(vehicle::SPEED)
                .and_then(|speed| speed.double().ok())
                .is_some_and(|speed| speed < 0.1)
            {
                stopped += 1;
            }
        }
        seen += running;
        writeln!(out, "{time:>6} s  {running:>4} vehicles, {stopped} of them stopped")?;
    }
    let statistics = client.statistics();
    sumo.close()?;
    writeln!(out, "{seen} vehicle readings in {:?}; {statistics:?}", begun.elapsed())?;
    Ok(())
}
