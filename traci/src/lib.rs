//! SUMO over TraCI: the wire protocol at full speed, and supervision of the SUMO process.
//!
//! This crate knows SUMO and nothing of traffic-signal control. It speaks the TraCI protocol of SUMO 1.28 over TCP
//! itself, without SUMO's own libraries.
//!
//! ```text
//!   Sumo::start ── locate ─> spawn ─> port ─> listening ─> handshake          sumo/*, client
//!        │
//!        │   commands                            one message, one deadline
//!   Client, Batch ──── codec, argument ─────> connection ═══ TCP ═══> SUMO (child process)
//!        │                                        │                      │  stderr, exit code
//!        │   borrowed values                      ▼                      ▼
//!   Replies, Subscription <──── reply, subscription, value      sumo::output, sumo::process
//!        │                                        │                      │
//!        └──── TraciError: SUMO's own words, its last lines, its end, the last command
//! ```
//!
//! # Use
//! ```no_run
//! use cross_traci::constants::vehicle;
//! use cross_traci::{Domain, Sumo, SumoCommand, SumoHome};
//! use std::time::Duration;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let home = SumoHome::locate(None)?;
//! let command = SumoCommand::new().option("-n", "town.net.xml").option("-r", "town.rou.xml");
//! let mut sumo = Sumo::start(&home, &command, Duration::from_secs(30))?;
//! let client = sumo.client();
//!
//! for decision in 1..=360 {
//!     // All lights in one message.
//!     let mut batch = client.batch();
//!     batch.set_traffic_light_state("J0", "GGrr").set_traffic_light_state("J1", "rrGG");
//!     batch.send()?;
//!     // Ten seconds in one message.
//!     client.simulation_step(10.0 * f64::from(decision))?;
//!     // Every vehicle, however far from J0, in one message.
//!     let wanted = [vehicle::LANE_ID, vehicle::SPEED];
//!     let seen = client.look_around(Domain::Junction, "J0", 1e9, Domain::Vehicle, &wanted)?;
//!     for vehicle in seen.objects() {
//!         for (variable, value) in vehicle.values() {
//!             println!("{} 0x{variable:02x} {value:?}", vehicle.id());
//!         }
//!     }
//! }
//! sumo.close()?;
//! # Ok(())
//! # }
//! ```
//!
//! # Speed
//! A round trip costs more than any value in it, so the crate is built around few messages:
//! - [`Client::simulation_step`] goes any number of seconds at once.
//! - Values of many objects are read cheapest in one batch: of all vehicles, their ids asked for before, in half the time
//!   of a subscription to them for the moment ([`Client::look_around`]), since SUMO searches the network for those.
//!   Standing subscriptions are worked out after every simulated second, however many of them one step covers.
//! - [`Client::batch`] sends any number of commands in one message.
//! - [`Batch::post`] and [`Client::post_step`] send a message without waiting for its answer, so that SUMO goes from a
//!   light to the seconds after it and on without us: ten seconds, each with its subscriptions, are one round trip.
//! - Results are read where they were received. Buffers are kept: steady traffic allocates nothing (there is a test).
//!
//! # Faults
//! Every call has a deadline, which covers the whole answer. [`TraciError`] tells what SUMO said, what it printed last,
//! how it ended and during which command; [`TraciError::kind`] is one of five words. After [`ErrorKind::Refused`] the
//! connection is as good as before. After any other kind it is ended, since commands and answers would be out of step;
//! drop the [`Sumo`] and start another.
//!
//! # Processes
//! A [`Sumo`] owns its process: dropping it kills and reaps. On Linux the kernel kills SUMO also when the owner gets no
//! chance to, after `SIGKILL` or an abort: see [`sumo`]. SUMO is kept out of the owner's process group, so that Ctrl-C
//! reaches the owner, who closes SUMO in order. SUMO accepts its client on every network interface and offers no option
//! to change that; it takes one client, and that is this one a moment after it listens.
//!
//! Calls block. Keep them on a thread of their own, away from an async runtime's workers.

mod ahead;
pub mod argument;
pub mod batch;
pub mod client;
pub mod codec;
mod connection;
pub mod constants;
pub mod error;
mod intake;
mod outbox;
mod read;
pub mod recorded;
mod reply;
pub mod subscription;
pub mod sumo;
pub mod value;

pub use argument::Argument;
pub use batch::{Batch, Replies, Reply};
pub use client::{Client, Statistics};
pub use codec::DecodeError;
pub use constants::Domain;
pub use error::{ErrorKind, Evidence, TraciError};
pub use intake::Intake;
pub use read::SimulationState;
pub use recorded::Recorded;
pub use subscription::{Object, Objects, Subscription, SubscriptionResults};
pub use sumo::{ExitReport, LocateError, Origin, Sumo, SumoCommand, SumoHome};
pub use value::{Compound, DoubleList, Polygon, StrList, Value};
