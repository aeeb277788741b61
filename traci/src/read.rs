//! Reading: one variable a message, and what is asked for most often.

use crate::argument::Argument;
use crate::client::Client;
use crate::codec::DecodeError;
use crate::constants::{Domain, any, simulation};
use crate::error::TraciError;
use crate::value::Value;

/// What the simulation as a whole looks like, read in one message by [`Client::simulation_state`]. Counts of events
/// cover everything since the `simulationStep` before the last, all seconds of a long one included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulationState {
    /// Simulated time, seconds.
    pub time: f64,
    /// Vehicles and persons running or still to come; zero means that nothing more will happen.
    pub min_expected: i32,
    /// Vehicles read from the route files. SUMO reads them in portions ahead of time.
    pub loaded: i32,
    /// Vehicles inserted into the network.
    pub departed: i32,
    /// Vehicles that reached their destination.
    pub arrived: i32,
    /// Vehicles that began to teleport, having been stuck.
    pub teleports_started: i32,
    /// Vehicles that came back from a teleport.
    pub teleports_ended: i32,
    /// Vehicles that collided.
    pub colliding: i32,
    /// Vehicles whose time to depart has come but which found no room yet, now.
    pub pending: usize,
}

impl Client {
    /// Reads a variable.
    ///
    /// # Errors
    /// [`TraciError::Refused`] with SUMO's message; others end the connection. So for all the calls below.
    pub fn get(&mut self, domain: Domain, variable: u8, object: &str) -> Result<Value<'_>, TraciError> {
        self.get_with(domain, variable, object, &[])
    }

    /// Reads a variable that needs parameters.
    ///
    /// # Errors
    /// As [`get`](Self::get).
    pub fn get_with(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
        parameters: &[Argument<'_>],
    ) -> Result<Value<'_>, TraciError> {
        let mut batch = self.batch();
        batch.get_with(domain, variable, object, parameters);
        batch.send()?.value(0)
    }

    /// Reads a real number.
    ///
    /// # Errors
    /// As [`get`](Self::get), and [`TraciError::Protocol`] if the variable is something else; so for those below.
    pub fn get_double(&mut self, domain: Domain, variable: u8, object: &str) -> Result<f64, TraciError> {
        self.read(domain, variable, object, |value| value.double())
    }

    /// Reads an integer.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn get_int(&mut self, domain: Domain, variable: u8, object: &str) -> Result<i32, TraciError> {
        self.read(domain, variable, object, |value| value.int())
    }

    /// Reads a text.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn get_string(&mut self, domain: Domain, variable: u8, object: &str) -> Result<String, TraciError> {
        self.read(domain, variable, object, |value| Ok(value.str()?.to_owned()))
    }

    /// Reads a list of texts.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn get_strings(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
    ) -> Result<Vec<String>, TraciError> {
        self.read(domain, variable, object, |value| Ok(value.strings()?.iter().map(str::to_owned).collect()))
    }

    /// Reads a position, metres.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn get_position(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
    ) -> Result<(f64, f64), TraciError> {
        self.read(domain, variable, object, |value| value.position())
    }

    fn read<T>(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
        convert: impl FnOnce(&Value<'_>) -> Result<T, DecodeError>,
    ) -> Result<T, TraciError> {
        let mut batch = self.batch();
        batch.get(domain, variable, object);
        let replies = batch.send()?;
        convert(&replies.value(0)?).map_err(|source| replies.error(0, source))
    }

    /// Ids of all objects of a domain.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn ids(&mut self, domain: Domain) -> Result<Vec<String>, TraciError> {
        self.get_strings(domain, any::ID_LIST, "")
    }

    /// Simulated time, seconds.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn time(&mut self) -> Result<f64, TraciError> {
        self.get_double(Domain::Simulation, simulation::TIME, "")
    }

    /// Vehicles and persons running or still to come; zero means that nothing more will happen.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn min_expected(&mut self) -> Result<i32, TraciError> {
        self.get_int(Domain::Simulation, simulation::MIN_EXPECTED_NUMBER, "")
    }

    /// Time, vehicles and what happened to them, in one message.
    ///
    /// # Errors
    /// As [`get_double`](Self::get_double).
    pub fn simulation_state(&mut self) -> Result<SimulationState, TraciError> {
        let mut batch = self.batch();
        for variable in [
            simulation::TIME,
            simulation::MIN_EXPECTED_NUMBER,
            simulation::LOADED_NUMBER,
            simulation::DEPARTED_NUMBER,
            simulation::ARRIVED_NUMBER,
            simulation::TELEPORT_STARTING_NUMBER,
            simulation::TELEPORT_ENDING_NUMBER,
            simulation::COLLIDING_NUMBER,
            simulation::PENDING_VEHICLES,
        ] {
            batch.get(Domain::Simulation, variable, "");
        }
        let replies = batch.send()?;
        Ok(SimulationState {
            time: replies.double(0)?,
            min_expected: replies.int(1)?,
            loaded: replies.int(2)?,
            departed: replies.int(3)?,
            arrived: replies.int(4)?,
            teleports_started: replies.int(5)?,
            teleports_ended: replies.int(6)?,
            colliding: replies.int(7)?,
            pending: replies.value(8)?.strings().map_err(|source| replies.error(8, source))?.len(),
        })
    }
}
