//! Starts SUMO on a scenario, prints its process id, and lets the simulation run until it is killed.
//!
//! ```text
//! cargo run --release -p cross-traci --example hold_sumo -- grid4x4.net.xml grid4x4_1.rou.xml
//! ```
//!
//! Kill this program in any way, `kill -9` included: SUMO ends with it.

use cross_traci::{Sumo, SumoCommand, SumoHome};
use std::error::Error;
use std::time::Duration;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(net), Some(routes)) = (arguments.next(), arguments.next()) else {
        return Err("usage: hold_sumo NET.net.xml ROUTES.rou.xml [panic|idle]".into());
    };
    let mode = arguments.next();
    let home = SumoHome::locate(None)?;
    let command = SumoCommand::new().option("-n", net).option("-r", routes);
    let mut sumo = Sumo::start(&home, &command, Duration::from_secs(60))?;
    writeln_flushed(&format!("{}", sumo.pid()))?;
    match mode.as_deref().and_then(|mode| mode.to_str()) {
        Some("panic") => panic_on_purpose(&mut sumo),
        Some("idle") => loop {
            std::thread::park();
        },
        _ => loop {
            let time = sumo.client().time()?;
            sumo.client().simulation_step(time + 1.0)?;
            std::thread::sleep(Duration::from_millis(20));
        },
    }
}

#[expect(clippy::panic, reason = "shows that a panic leaves no SUMO behind")]
fn panic_on_purpose(_: &mut Sumo) -> ! {
    panic!("on purpose");
}

fn writeln_flushed(line: &str) -> std::io::Result<()> {
    use std::io::Write;
    let mut out = std::io::stdout();
    writeln!(out, "{line}")?;
    out.flush()
}
