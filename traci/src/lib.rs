//! SUMO over TraCI: the wire protocol at full speed, and supervision of the SUMO process.

pub mod batch;
pub mod client;
pub mod codec;
mod connection;
pub mod constants;
pub mod error;
mod read;
mod reply;
pub mod subscription;
pub mod sumo;
pub mod value;

pub use batch::{Batch, Replies, Reply};
pub use client::{Client, Statistics};
pub use codec::DecodeError;
pub use constants::Domain;
pub use error::{ErrorKind, Evidence, TraciError};
pub use read::SimulationState;
pub use subscription::{Object, Objects, Subscription, SubscriptionResults};
pub use sumo::{ExitReport, LocateError, Origin, Sumo, SumoCommand, SumoHome};
pub use value::{Argument, Compound, DoubleList, Polygon, StrList, Value};
