//! From counts and layouts to the numbers that networks read.
//!
//! An [`AgentSpec`] holds what is constant for an intersection; [`Track`] what one agent saw and did along a fragment.
//! None of it depends on weights, so it is computed once however many epochs follow. Scales: counts / 10, lengths /
//! 300 m, speeds / 30 m/s, lane and movement counts / 8.

mod movement;
mod paper;
mod topology;

use crate::error::ModelError;
use cross_config::{EnvConfig, Gfe, ModelConfig};
use cross_sim::layout::{Intersection, NetworkLayout};

/// Vehicles that count as 1.
pub const COUNT_SCALE: f32 = 10.0;
/// Metres that count as 1.
pub const LENGTH_SCALE: f32 = 300.0;
/// Metres a second that count as 1.
pub const SPEED_SCALE: f32 = 30.0;
/// Lanes or movements that count as 1.
pub const NUMBER_SCALE: f32 = 8.0;
/// Roads in a `paper` topology vector.
pub const MAX_ROADS: usize = 7;

/// Widths of the feature vectors, fixed by the configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FeatureSizes {
    /// Detection bands per lane.
    pub bands: i64,
    /// Padded movements of the `paper` form.
    pub movements: i64,
    /// Padded state vector of the `paper` form: movements x 5.
    pub state: i64,
    /// Features of a phase in the `movement` form.
    pub phase: i64,
    /// Of these, the pooled counts that prediction targets.
    pub pooled: i64,
    /// Features of a lane token.
    pub lane: i64,
    /// Topology vector.
    pub topology: i64,
}

impl FeatureSizes {
    /// Sizes under a configuration.
    #[must_use]
    pub fn new(env: &EnvConfig, model: &ModelConfig) -> Self {
        let bands = env.detection.bands();
        let movements = env.max_movements;
        Self {
            bands: bands as i64,
            movements: movements as i64,
            state: (movements * paper::STATE_FEATURES) as i64,
            phase: movement::phase_features(bands) as i64,
            pooled: 2 * bands as i64,
            lane: movement::lane_features(bands) as i64,
            topology: match model.gfe {
                Gfe::Paper => topology::ordered_size(env.max_phases) as i64,
                Gfe::Movement => topology::pooled_size(env.max_phases) as i64,
            },
        }
    }
}

/// What is constant for one agent.
#[derive(Debug, Clone)]
pub struct AgentSpec {
    /// Green phases.
    pub phases: usize,
    /// Incoming lanes, which are the first rows of the agent's counts.
    pub incoming: usize,
    /// Incoming and outgoing lanes.
    pub lanes: usize,
    /// First of the agent's lane rows in an observation.
    pub first_lane_row: usize,
    /// Green of every lane in every phase `[phases, lanes]`, 0 to 1, by [`cross_config::LaneGreen`].
    lane_green: Vec<f32>,
    /// Constant features of the lane tokens `[lanes, lane - bands]`.
    lane_constants: Vec<f32>,
    /// Lane rows (incoming, outgoing) of each movement.
    movements: Vec<(usize, usize)>,
    /// Green of every movement in every phase `[phases, max_movements]`, padded with 0.
    pub phase_state: Vec<f32>,
    /// Topology vector of the configured form.
    pub topology: Vec<f32>,
}

/// Static side of one network for the model.
#[derive(Debug, Clone)]
pub struct NetworkSpec {
    /// Agents in layout order.
    pub agents: Vec<AgentSpec>,
    /// Lane rows of an observation.
    pub lane_rows: usize,
    /// Bands per lane.
    pub bands: usize,
    /// How many of them, the first ones, count stopped vehicles.
    pub stopped_bands: usize,
    /// Form of the features.
    pub gfe: Gfe,
    /// Padded movements of the `paper` form.
    pub max_movements: usize,
}

impl NetworkSpec {
    /// Prepares a layout.
    ///
    /// # Errors
    /// [`ModelError::TooLarge`] or [`ModelError::TooManyRoads`] names the intersection that exceeds the limits.
    pub fn new(layout: &NetworkLayout, env: &EnvConfig, model: &ModelConfig) -> Result<Self, ModelError> {
        let mut first_lane_row = 0;
        let mut agents = Vec::with_capacity(layout.agents());
        for intersection in &layout.intersections {
            agents.push(AgentSpec::new(intersection, first_lane_row, env, model)?);
            first_lane_row += intersection.lanes();
        }
        Ok(Self {
            agents,
            lane_rows: first_lane_row,
            bands: env.detection.bands(),
            stopped_bands: env.detection.stopped_bands(),
            gfe: model.gfe,
            max_movements: env.max_movements,
        })
    }

    /// Features of one observation, counts `[lane rows * bands]` and current phases `[agents]`: those of all agents one
    /// after another, in layout order. What `seen` holds is replaced.
    pub fn look(&self, counts: &[u16], phases: &[u8], seen: &mut Track) {
        seen.clear();
        seen.rows = 1;
        for (spec, &current) in self.agents.iter().zip(phases) {
            let start = spec.first_lane_row * self.bands;
            let own = &counts[start..start + spec.lanes * self.bands];
            seen.push(self, spec, own, usize::from(current));
        }
    }

    /// Green of every movement in every phase of all agents `[all phases, max_movements]`.
    #[must_use]
    pub fn phase_states(&self) -> Vec<f32> {
        self.agents.iter().flat_map(|agent| agent.phase_state.iter().copied()).collect()
    }
}

impl AgentSpec {
    /// Entries of a `paper` state that belong to real movements; the rest is padding.
    #[must_use]
    pub fn state_entries(&self) -> usize {
        self.movements.len() * paper::STATE_FEATURES
    }

    fn new(
        intersection: &Intersection,
        first_lane_row: usize,
        env: &EnvConfig,
        model: &ModelConfig,
    ) -> Result<Self, ModelError> {
        let (movements, phases) = (intersection.movements.len(), intersection.phases.len());
        if movements > env.max_movements || phases > env.max_phases {
            return Err(ModelError::TooLarge {
                id: intersection.id.clone(),
                movements,
                phases,
                max_movements: env.max_movements,
                max_phases: env.max_phases,
            });
        }
        let (roads_in, roads_out) = (intersection.roads_in.len(), intersection.roads_out.len());
        if model.gfe == Gfe::Paper && roads_in.max(roads_out) > MAX_ROADS {
            let id = intersection.id.clone();
            return Err(ModelError::TooManyRoads { id, roads_in, roads_out, max: MAX_ROADS });
        }
        let incoming = intersection.incoming.len();
        Ok(Self {
            phases,
            incoming,
            lanes: intersection.lanes(),
            first_lane_row,
            lane_green: movement::lane_green(intersection, model.lane_green),
            lane_constants: movement::lane_constants(intersection),
            movements: intersection.movements.iter().map(|m| (m.incoming, incoming + m.outgoing)).collect(),
            phase_state: paper::phase_state(intersection, env.max_movements),
            topology: match model.gfe {
                Gfe::Paper => topology::ordered(intersection, env.max_phases),
                Gfe::Movement => topology::pooled(intersection, env.max_phases),
            },
        })
    }
}

/// The features of one agent over `rows` consecutive observations.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Track {
    /// Number of observations.
    pub rows: usize,
    /// `movement`: features of every phase `[rows, phases, phase]`.
    pub phases: Vec<f32>,
    /// `movement`: mean and maximum of these over the phases `[rows, 2 * phase]`.
    pub context: Vec<f32>,
    /// `movement`: lane tokens `[rows, lanes, lane]`.
    pub lanes: Vec<f32>,
    /// `paper`: padded state `[rows, movements * 5]`.
    pub states: Vec<f32>,
}

impl Track {
    /// Features of agent `index` from observations `[rows, lane rows * bands]` and current phases `[rows, agents]`.
    #[must_use]
    pub fn new(network: &NetworkSpec, index: usize, counts: &[u16], phases: &[u8]) -> Self {
        let spec = &network.agents[index];
        let width = network.lane_rows * network.bands;
        let rows = phases.len() / network.agents.len();
        let mut track = Self { rows, ..Self::default() };
        for row in 0..rows {
            let start = row * width + spec.first_lane_row * network.bands;
            let own = &counts[start..start + spec.lanes * network.bands];
            let current = usize::from(phases[row * network.agents.len() + index]);
            track.push(network, spec, own, current);
        }
        track
    }

    /// Appends one observation of one agent: its counts `[lanes * bands]` and its current phase.
    fn push(&mut self, network: &NetworkSpec, spec: &AgentSpec, counts: &[u16], current: usize) {
        match network.gfe {
            Gfe::Paper => paper::push_state(spec, network, counts, current, &mut self.states),
            Gfe::Movement => movement::push(spec, network.bands, counts, current, self),
        }
    }

    fn clear(&mut self) {
        let Self { rows, phases, context, lanes, states } = self;
        *rows = 0;
        for part in [phases, context, lanes, states] {
            part.clear();
        }
    }
}
