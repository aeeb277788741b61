//! Starts SUMO on a scenario, prints its process id, and simulates slowly until this program is killed.
//!
//! ```text
//! cargo run --release -p cross-traci --example hold_sumo -- grid4x4.net.xml grid4x4_1.rou.xml
//! ```
//!
//! Kill it in any way, `kill -9` included: SUMO ends with it.

use cross_traci::{Sumo, SumoCommand, SumoHome};
use std::error::Error;
use std::io::Write;
use std::time::Duration;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(net), Some(routes)) = (arguments.next(), arguments.next()) else {
        return Err("usage: hold_sumo NET.net.xml ROUTES.rou.xml".into());
    };
    let home = SumoHome::locate(None)?;
    let command = SumoCommand::new().option("-n", net).option("-r", routes);
    let mut sumo = Sumo::start(&home, &command, Duration::from_secs(60))?;
    writeln!(std::io::stdout(), "this process {}, SUMO {}", std::process::id(), sumo.pid())?;
    loop {
        // Zero makes one step.
        sumo.client().simulation_step(0.0)?;
        std::thread::sleep(Duration::from_millis(100));
    }
}
