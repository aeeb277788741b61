//! The numbers of the protocol, under SUMO's terms, and their names for error messages.

/// Newest TraCI API version this crate was written and tested for; SUMO 1.28 has it.
pub const API_VERSION: i32 = 22;

/// Oldest API version that is accepted.
pub const OLDEST_API_VERSION: i32 = 22;

/// What SUMO puts where a number is not defined, such as the lane position of a vehicle that is off the road.
pub const INVALID_DOUBLE: f64 = -1_073_741_824.0;

/// Commands that belong to no [`Domain`].
pub mod command {
    /// Asks for API version and SUMO version.
    pub const GET_VERSION: u8 = 0x00;
    /// Replaces the simulation.
    pub const LOAD: u8 = 0x01;
    /// Simulates up to a time.
    pub const SIMULATION_STEP: u8 = 0x02;
    /// Sets this client's place among several.
    pub const SET_ORDER: u8 = 0x03;
    /// Ends the connection.
    pub const CLOSE: u8 = 0x7f;
}

/// Type ids in front of values.
pub mod types {
    /// Longitude and latitude.
    pub const POSITION_GEO: u8 = 0x00;
    /// x and y.
    pub const POSITION_2D: u8 = 0x01;
    /// Longitude, latitude, altitude.
    pub const POSITION_GEO_ALTITUDE: u8 = 0x02;
    /// x, y, z.
    pub const POSITION_3D: u8 = 0x03;
    /// Edge, position, lane index.
    pub const POSITION_ROADMAP: u8 = 0x04;
    /// Points.
    pub const POLYGON: u8 = 0x06;
    /// Unsigned byte.
    pub const UBYTE: u8 = 0x07;
    /// Signed byte.
    pub const BYTE: u8 = 0x08;
    /// 32-bit integer.
    pub const INTEGER: u8 = 0x09;
    /// Double.
    pub const DOUBLE: u8 = 0x0b;
    /// Text.
    pub const STRING: u8 = 0x0c;
    /// Texts.
    pub const STRING_LIST: u8 = 0x0e;
    /// Several values.
    pub const COMPOUND: u8 = 0x0f;
    /// Doubles.
    pub const DOUBLE_LIST: u8 = 0x10;
    /// Four channels.
    pub const COLOR: u8 = 0x11;
}

/// Result codes in a status.
pub mod result {
    /// Done.
    pub const OK: u8 = 0x00;
    /// SUMO does not know the command.
    pub const NOT_IMPLEMENTED: u8 = 0x01;
    /// SUMO will not do it; the status says why.
    pub const ERROR: u8 = 0xff;
}

/// The kinds of things that SUMO can be asked about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Domain {
    /// Induction loops (E1).
    InductionLoop = 0xa0,
    /// Multi-entry, multi-exit detectors (E3).
    MultiEntryExit = 0xa1,
    /// Traffic lights.
    TrafficLight = 0xa2,
    /// Lanes.
    Lane = 0xa3,
    /// Vehicles.
    Vehicle = 0xa4,
    /// Vehicle types.
    VehicleType = 0xa5,
    /// Routes.
    Route = 0xa6,
    /// Points of interest.
    Poi = 0xa7,
    /// Polygons.
    Polygon = 0xa8,
    /// Junctions.
    Junction = 0xa9,
    /// Edges.
    Edge = 0xaa,
    /// The simulation as a whole; its object id is empty.
    Simulation = 0xab,
    /// The graphical interface.
    Gui = 0xac,
    /// Lane-area detectors (E2).
    LaneArea = 0xad,
    /// Persons.
    Person = 0xae,
    /// Bus stops.
    BusStop = 0xaf,
    /// Parking areas.
    ParkingArea = 0x24,
    /// Charging stations.
    ChargingStation = 0x25,
    /// Route probes.
    RouteProbe = 0x26,
    /// Calibrators.
    Calibrator = 0x27,
    /// Rerouters.
    Rerouter = 0x28,
    /// Variable speed signs.
    VariableSpeedSign = 0x29,
    /// Mean data.
    MeanData = 0x2a,
    /// Overhead wires.
    OverheadWire = 0x2b,
}

/// How far a response's id lies above its command's.
pub const RESPONSE: u8 = 0x10;

impl Domain {
    /// Every domain.
    pub const ALL: [Self; 24] = [
        Self::InductionLoop,
        Self::MultiEntryExit,
        Self::TrafficLight,
        Self::Lane,
        Self::Vehicle,
        Self::VehicleType,
        Self::Route,
        Self::Poi,
        Self::Polygon,
        Self::Junction,
        Self::Edge,
        Self::Simulation,
        Self::Gui,
        Self::LaneArea,
        Self::Person,
        Self::BusStop,
        Self::ParkingArea,
        Self::ChargingStation,
        Self::RouteProbe,
        Self::Calibrator,
        Self::Rerouter,
        Self::VariableSpeedSign,
        Self::MeanData,
        Self::OverheadWire,
    ];

    /// The command that gets a variable; SUMO also names the domain by it.
    pub const fn get(self) -> u8 {
        self as u8
    }

    /// The command that sets a variable.
    pub const fn set(self) -> u8 {
        self as u8 + 0x20
    }

    /// The command that subscribes to variables of one object.
    pub const fn subscribe(self) -> u8 {
        self as u8 + 0x30
    }

    /// The command that subscribes to variables of whatever is near one object.
    pub const fn subscribe_context(self) -> u8 {
        self as u8 - 0x20
    }

    /// The domain with this get command.
    pub fn from_get(id: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|domain| domain.get() == id)
    }

    /// What an error message calls an object of the domain.
    pub fn noun(self) -> &'static str {
        match self {
            Self::InductionLoop => "induction loop",
            Self::MultiEntryExit => "multi-entry-exit detector",
            Self::TrafficLight => "traffic light",
            Self::Lane => "lane",
            Self::Vehicle => "vehicle",
            Self::VehicleType => "vehicle type",
            Self::Route => "route",
            Self::Poi => "point of interest",
            Self::Polygon => "polygon",
            Self::Junction => "junction",
            Self::Edge => "edge",
            Self::Simulation => "simulation",
            Self::Gui => "view",
            Self::LaneArea => "lane-area detector",
            Self::Person => "person",
            Self::BusStop => "bus stop",
            Self::ParkingArea => "parking area",
            Self::ChargingStation => "charging station",
            Self::RouteProbe => "route probe",
            Self::Calibrator => "calibrator",
            Self::Rerouter => "rerouter",
            Self::VariableSpeedSign => "variable speed sign",
            Self::MeanData => "mean data",
            Self::OverheadWire => "overhead wire",
        }
    }
}

/// Declares the variables of a domain, and the table that names them.
macro_rules! variables {
    ($(#[$doc:meta])* $module:ident { $($(#[$item:meta])* $name:ident = $id:literal,)* }) => {
        $(#[$doc])*
        pub mod $module {
            $($(#[$item])* pub const $name: u8 = $id;)*
            pub(super) const NAMES: &[(u8, &str)] = &[$(($id, stringify!($name)),)*];
        }
    };
}

variables! {
    /// Variables that every domain has.
    any {
        /// Ids of all objects (string list; the object id is empty).
        ID_LIST = 0x00,
        /// Number of objects (integer).
        ID_COUNT = 0x01,
        /// A named parameter (string, with the key as parameter).
        PARAMETER = 0x7e,
    }
}

variables! {
    /// Variables of [`Domain::Simulation`]. Counts and ids of events cover the whole of the last `simulationStep`
    /// command, all its seconds, read or subscribed.
    simulation {
        /// Time, seconds (double).
        TIME = 0x66,
        /// Length of a step, seconds (double).
        DELTA_T = 0x7b,
        /// End time, seconds (double), −1 if none was given.
        END = 0x1d,
        /// A global option's value (string; the option's name is the object id).
        OPTION = 0x32,
        /// Vehicles loaded (integer).
        LOADED_NUMBER = 0x71,
        /// Their ids (string list).
        LOADED_IDS = 0x72,
        /// Vehicles inserted (integer).
        DEPARTED_NUMBER = 0x73,
        /// Their ids (string list).
        DEPARTED_IDS = 0x74,
        /// Vehicles that began to teleport (integer).
        TELEPORT_STARTING_NUMBER = 0x75,
        /// Their ids (string list).
        TELEPORT_STARTING_IDS = 0x76,
        /// Vehicles that ended a teleport (integer).
        TELEPORT_ENDING_NUMBER = 0x77,
        /// Their ids (string list).
        TELEPORT_ENDING_IDS = 0x78,
        /// Vehicles that arrived (integer).
        ARRIVED_NUMBER = 0x79,
        /// Their ids (string list).
        ARRIVED_IDS = 0x7a,
        /// Network's bounding box (polygon of two points).
        NET_BOUNDING_BOX = 0x7c,
        /// Vehicles and persons running or still to come (integer).
        MIN_EXPECTED_NUMBER = 0x7d,
        /// Vehicles in a collision (integer).
        COLLIDING_NUMBER = 0x80,
        /// Their ids (string list).
        COLLIDING_IDS = 0x81,
        /// Vehicles braking hard to stop (integer).
        EMERGENCY_STOPPING_NUMBER = 0x89,
        /// Vehicles whose departure time has come but which found no room yet (string list).
        PENDING_VEHICLES = 0x94,
        /// Factor on the demand (double).
        SCALE = 0x8e,
        /// Writes the simulation's state to a file (set: string).
        SAVE_STATE = 0x95,
        /// Reads a state back (set: string).
        LOAD_STATE = 0x96,
    }
}

variables! {
    /// Variables of [`Domain::TrafficLight`].
    traffic_light {
        /// The signal of every link (string of `rRyYgGsuoO`; get and set). Setting it starts a program of its own.
        RED_YELLOW_GREEN_STATE = 0x20,
        /// Index of the phase (set: integer).
        PHASE_INDEX = 0x22,
        /// Program (set: string).
        PROGRAM = 0x23,
        /// Time the phase has left (set: double, seconds).
        PHASE_DURATION = 0x24,
        /// Lane of every link (string list).
        CONTROLLED_LANES = 0x26,
        /// Links of every signal (compound).
        CONTROLLED_LINKS = 0x27,
        /// Index of the phase (integer).
        CURRENT_PHASE = 0x28,
        /// Program (string).
        CURRENT_PROGRAM = 0x29,
        /// Junctions (string list).
        CONTROLLED_JUNCTIONS = 0x2a,
        /// All programs (compound).
        COMPLETE_DEFINITION = 0x2b,
        /// Assumed time of the next switch, seconds (double).
        NEXT_SWITCH = 0x2d,
        /// Seconds spent in the phase (double).
        SPENT_DURATION = 0x38,
    }
}

variables! {
    /// Variables of [`Domain::Vehicle`].
    vehicle {
        /// Metres per second (double).
        SPEED = 0x40,
        /// Centre of the front bumper, metres (position).
        POSITION = 0x42,
        /// Heading, degrees clockwise from north (double).
        ANGLE = 0x43,
        /// Metres (double).
        LENGTH = 0x44,
        /// Metres (double).
        MIN_GAP = 0x4c,
        /// Vehicle type (string).
        TYPE = 0x4f,
        /// Edge (string).
        ROAD_ID = 0x50,
        /// Lane (string; empty while teleporting).
        LANE_ID = 0x51,
        /// Index of the lane, 0 is the rightmost (integer).
        LANE_INDEX = 0x52,
        /// Route (string).
        ROUTE_ID = 0x53,
        /// Edges of the route (string list).
        EDGES = 0x54,
        /// Metres from the lane's beginning to the front bumper (double).
        LANE_POSITION = 0x56,
        /// Index of the edge within the route (integer).
        ROUTE_INDEX = 0x69,
        /// Milligrams per second (double).
        CO2_EMISSION = 0x60,
        /// Milligrams per second (double).
        FUEL_CONSUMPTION = 0x65,
        /// Metres per second squared (double).
        ACCELERATION = 0x72,
        /// Highest speed the lane and the driver allow, metres per second (double).
        ALLOWED_SPEED = 0xb7,
        /// Seconds at rest without a break (double).
        WAITING_TIME = 0x7a,
        /// Seconds at rest within the configured memory (double).
        ACCUMULATED_WAITING_TIME = 0x87,
        /// Seconds lost since departure (double).
        TIME_LOSS = 0x8c,
        /// Metres driven (double).
        DISTANCE = 0x84,
        /// Time of departure, seconds (double).
        DEPARTURE = 0x3a,
        /// Seconds waited for departure (double).
        DEPART_DELAY = 0x3b,
        /// Upcoming traffic lights (compound).
        NEXT_TLS = 0x70,
        /// Vehicle in front and the gap to it (compound; needs a distance as parameter).
        LEADER = 0x68,
    }
}

variables! {
    /// Variables of [`Domain::Lane`] and, where they have them, [`Domain::Edge`] and the detectors.
    lane {
        /// Vehicles on it (integer).
        LAST_STEP_VEHICLE_NUMBER = 0x10,
        /// Their mean speed, metres per second (double).
        LAST_STEP_MEAN_SPEED = 0x11,
        /// Their ids (string list).
        LAST_STEP_VEHICLE_IDS = 0x12,
        /// Percentage of the length that is occupied (double).
        LAST_STEP_OCCUPANCY = 0x13,
        /// Vehicles slower than 0.1 m/s (integer).
        LAST_STEP_HALTING_NUMBER = 0x14,
        /// Mean vehicle length, metres (double).
        LAST_STEP_LENGTH = 0x15,
        /// Number of outgoing links (integer; lanes).
        LINK_NUMBER = 0x30,
        /// Edge (string; lanes).
        EDGE_ID = 0x31,
        /// Outgoing links (compound; lanes).
        LINKS = 0x33,
        /// Metres per second (double).
        MAX_SPEED = 0x41,
        /// Metres (double).
        LENGTH = 0x44,
        /// Centre line (polygon).
        SHAPE = 0x4e,
        /// Sum of the waiting times of the vehicles on it, seconds (double).
        WAITING_TIME = 0x7a,
        /// Vehicles waiting to be inserted on it (string list).
        PENDING_VEHICLES = 0x94,
    }
}

variables! {
    /// Variables of [`Domain::Junction`].
    junction {
        /// Centre, metres (position).
        POSITION = 0x42,
        /// Outline (polygon).
        SHAPE = 0x4e,
        /// Edges that lead in (string list).
        INCOMING_EDGES = 0x7b,
        /// Edges that lead out (string list).
        OUTGOING_EDGES = 0x7c,
    }
}

/// The name of a variable, for messages.
pub fn variable_name(domain: Domain, variable: u8) -> Option<&'static str> {
    let own = match domain {
        Domain::Simulation => simulation::NAMES,
        Domain::TrafficLight => traffic_light::NAMES,
        Domain::Vehicle => vehicle::NAMES,
        Domain::Lane | Domain::Edge | Domain::LaneArea | Domain::InductionLoop => lane::NAMES,
        Domain::Junction => junction::NAMES,
        _ => &[],
    };
    own.iter().chain(any::NAMES).find(|(id, _)| *id == variable).map(|(_, name)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_of_a_domain_has_the_id_that_sumo_defines() {
        assert_eq!(Domain::TrafficLight.set(), 0xc2);
        assert_eq!(Domain::Vehicle.subscribe(), 0xd4);
        assert_eq!(Domain::Junction.subscribe_context(), 0x89);
        assert_eq!(Domain::ParkingArea.subscribe_context(), 0x04);
        assert_eq!(Domain::ParkingArea.subscribe(), 0x54);
        assert_eq!(Domain::OverheadWire.set(), 0x4b);
    }

    #[test]
    fn no_two_commands_share_an_id() {
        let mut ids: Vec<u8> = Domain::ALL
            .into_iter()
            .flat_map(|domain| [domain.get(), domain.set(), domain.subscribe(), domain.subscribe_context()])
            .collect();
        ids.sort_unstable();
        let count = ids.len();
        ids.dedup();
        assert_eq!(ids.len(), count);
    }
}
