//! An episode through the crate traci-rs, for `cross bench traci`, which starts this program; `bench/src/traci/program.rs`
//! explains the conversation.
//!
//! Without arguments it says what it is. With the file of a job and one to write to, it drives an episode.
//!
//! It is an example because traci-rs is under the Eclipse Public License 2.0, which asks more of whoever passes a program on
//! than our own licences do: examples are built for those who measure, and are in nothing that is given on.

#![expect(clippy::print_stdout, reason = "standard output is what it answers on")]

#[expect(unreachable_pub, reason = "the file is a public part of the library, too")]
#[path = "../src/traci/job.rs"]
mod job;

use job::{Job, Way};
use rustix::time::{ClockId, clock_gettime};
use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use traci_rs::constants::{CMD_GET_VEHICLE_VARIABLE, VAR_LANE_ID, VAR_LANEPOSITION, VAR_SPEED};
use traci_rs::{JunctionScope, TraciClient, TraciError, TraciValue, TrafficLightScope, VehicleScope};

/// The version that Cargo.toml names.
const TITLE: &str = "traci-rs 0.2.0";
/// What is read of each vehicle.
const VALUES: [u8; 3] = [VAR_LANE_ID, VAR_LANEPOSITION, VAR_SPEED];
/// As long as a SUMO that starts on a busy machine may take.
const PATIENCE: Duration = Duration::from_secs(60);
/// Begin and end of a subscription that stands, seconds; as in the crate's own example.
const ALWAYS: (f64, f64) = (0.0, 1e9);

/// Position on the lane in metres, speed in m/s, lane.
type Vehicle = (f64, f64, String);

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let outcome = match arguments.as_slice() {
        [] => {
            println!("{TITLE}");
            Ok(())
        }
        [job, seen] => answer(job.as_ref(), seen.as_ref()),
        _ => Err("call it with the file of a job and a file to write to".into()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn answer(job: &std::path::Path, seen: &std::path::Path) -> Result<(), Box<dyn Error>> {
    let job: Job = serde_json::from_slice(&std::fs::read(job)?)?;
    println!("ready");
    let mut line = String::new();
    std::io::stdin().read_line(&mut line)?;
    let port = line.trim().parse()?;
    let before = cpu_seconds();
    let decisions = episode(&mut connect(port)?, &job)?;
    println!("cpu {}", cpu_seconds() - before);
    std::io::stdin().read_to_end(&mut Vec::new())?;
    let mut file = BufWriter::new(File::create(seen)?);
    for vehicles in decisions {
        writeln!(file, "{}", vehicles.len())?;
        for (position, speed, lane) in vehicles {
            writeln!(file, "{position} {speed} {lane}")?;
        }
    }
    Ok(file.flush()?)
}

/// CPU time of this process so far.
fn cpu_seconds() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Connects as soon as SUMO listens.
fn connect(port: u16) -> Result<TraciClient, TraciError> {
    let begun = Instant::now();
    loop {
        match TraciClient::connect("127.0.0.1", port) {
            Err(_) if begun.elapsed() < PATIENCE => std::thread::sleep(Duration::from_millis(5)),
            outcome => return outcome,
        }
    }
}

/// What was seen at each decision.
fn episode(client: &mut TraciClient, job: &Job) -> Result<Vec<Vec<Vehicle>>, Box<dyn Error>> {
    let by_second = matches!(job.way, Way::Polling | Way::EverySecond);
    let mut now = job.begin;
    let mut seen = Vec::with_capacity(job.decisions.len());
    show(client, &job.first)?;
    if matches!(job.way, Way::EverySecond | Way::EveryDecision) {
        subscribe(client, job, ALWAYS)?;
    }
    for legs in &job.decisions {
        for (number, leg) in legs.iter().enumerate() {
            show(client, &leg.show)?;
            now += f64::from(leg.seconds);
            if by_second {
                for _ in 0..leg.seconds {
                    client.simulation_step(0.0)?;
                }
                continue;
            }
            if job.way == Way::Momentary && number + 1 == legs.len() {
                subscribe(client, job, (now, now))?;
            }
            client.simulation_step(now)?;
        }
        seen.push(match job.way {
            Way::Polling => poll(client)?,
            _ => subscribed(client, &job.anchor)?,
        });
    }
    client.close()?;
    Ok(seen)
}

// The crate's scopes cannot be borrowed from a client and called with it at the same time; they have no state that calls
// need, so that a fresh one does.

fn show(client: &mut TraciClient, states: &[(String, String)]) -> Result<(), TraciError> {
    let lights = TrafficLightScope::default();
    states.iter().try_for_each(|(light, state)| lights.set_red_yellow_green_state(client, light, state))
}

fn subscribe(client: &mut TraciClient, job: &Job, (begin, end): (f64, f64)) -> Result<(), TraciError> {
    let junction = JunctionScope::default();
    junction.subscribe_context(client, &job.anchor, CMD_GET_VEHICLE_VARIABLE, job.range, &VALUES, begin, end)
}

/// Every vehicle by getters.
fn poll(client: &mut TraciClient) -> Result<Vec<Vehicle>, TraciError> {
    let scope = VehicleScope::default();
    let ids = scope.get_id_list(client)?;
    let one = |id: &String| {
        Ok((
            scope.get_lane_position(client, id)?,
            scope.get_speed(client, id)?,
            scope.get_lane_id(client, id)?,
        ))
    };
    ids.iter().map(one).collect()
}

/// The same, from what the last step brought.
fn subscribed(client: &TraciClient, anchor: &str) -> Result<Vec<Vehicle>, Box<dyn Error>> {
    let Some(found) = client.junction.get_context_subscription_results(anchor) else { return Ok(Vec::new()) };
    let one = |(id, values): (&String, &traci_rs::TraciResults)| match VALUES.map(|value| values.get(&value))
    {
        [
            Some(TraciValue::String(lane)),
            Some(TraciValue::Double(position)),
            Some(TraciValue::Double(speed)),
        ] => Ok((*position, *speed, lane.clone())),
        other => Err(format!("the subscription brought {other:?} of vehicle {id}").into()),
    };
    found.iter().map(one).collect()
}
