//! Soft assignment of phases to cluster centres for one observation; the same as the training's `net::pcc`, without the
//! prediction, which only the loss needs.

use super::norm::Norm;
use super::weights::Weights;
use crate::error::ModelError;
use crate::features::{AgentSpec, NetworkSpec, Track};
use crate::vector::math::{dot, sigmoid, softmax};
use crate::vector::{Dense, Isa, Matrix, Work};
use cross_config::{Gfe, ModelConfig};

#[derive(Debug)]
pub(super) struct Pcc {
    isa: Isa,
    gfe: Gfe,
    phase: Dense,
    state: Dense,
    topology: Dense,
    /// Latent and its projection in one, since nothing is between them.
    project: Dense,
    norm: Norm,
    /// Centres of length 1 over the temperature.
    directions: Dense,
    centres: Matrix,
}

/// What no observation on a network changes.
#[derive(Debug, Default)]
pub(super) struct PccConstant {
    /// Topology's part of the first layer `[agents, 2 * hidden]`.
    topology: Vec<f32>,
    /// `paper`: the phases' part of it `[rows, 2 * hidden]`.
    phases: Vec<f32>,
}

/// Buffers of [`Pcc::assign`].
#[derive(Debug, Default)]
pub(super) struct PccWork {
    phases: Vec<f32>,
    state: Vec<f32>,
    gated: Vec<f32>,
    projected: Vec<f32>,
    normed: Vec<f32>,
}

impl Pcc {
    pub(super) fn new(isa: Isa, weights: &Weights<'_>, config: &ModelConfig) -> Result<Self, ModelError> {
        let dense = |(weight, bias): (Matrix, Vec<f32>)| Dense::new(isa, &weight, Some(&bias));
        let part = |name: &str| -> Result<Dense, ModelError> {
            Ok(Dense::new(isa, &weights.sub(name).matrix("weight")?, None))
        };
        let ((second, second_bias), (project, bias)) =
            (weights.linear("second")?, weights.linear("project")?);
        let centres = weights.matrix("centres")?;
        let directions = (0..centres.rows).flat_map(|k| {
            let length = centres.row(k).iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().max(1e-12).sqrt();
            centres.row(k).iter().map(move |&v| (f64::from(v) / (length * config.tau_k)) as f32)
        });
        let directions = Matrix::new(centres.rows, centres.columns, directions.collect());
        Ok(Self {
            isa,
            gfe: config.gfe,
            phase: part("phase")?,
            state: part("state")?,
            topology: dense(weights.linear("topology")?),
            project: Dense::new(isa, &project.times(&second), Some(&project.apply(&second_bias, &bias))),
            norm: Norm::new(isa, &weights.sub("norm"))?,
            directions: Dense::new(isa, &directions, None),
            centres,
        })
    }

    /// The centres `[clusters, latent]`.
    pub(super) fn centres(&self) -> &Matrix {
        &self.centres
    }

    pub(super) fn constant(&self, network: &NetworkSpec) -> PccConstant {
        let mut constant = PccConstant::default();
        let topology: Vec<f32> =
            network.agents.iter().flat_map(|agent| agent.topology.iter().copied()).collect();
        self.topology.forward(&topology, &mut constant.topology);
        if self.gfe == Gfe::Paper {
            self.phase.forward(&network.phase_states(), &mut constant.phases);
        }
        constant
    }

    /// Soft assignment of every phase `[rows, clusters]`.
    pub(super) fn assign(
        &self,
        network: &NetworkSpec,
        constant: &PccConstant,
        seen: &Track,
        work: &mut PccWork,
        weights: &mut Vec<f32>,
    ) {
        let phases = match self.gfe {
            Gfe::Paper => {
                self.state.forward(&seen.states, &mut work.state);
                &constant.phases
            }
            Gfe::Movement => {
                self.state.forward(&seen.context, &mut work.state);
                self.phase.forward(&seen.phases, &mut work.phases);
                &work.phases
            }
        };
        for (state, topology) in work.state.iter_mut().zip(&constant.topology) {
            *state += topology;
        }
        let width = self.phase.outputs();
        work.gated.resize(phases.len() / 2, 0.0);
        self.isa.run(Gate {
            width,
            agents: &network.agents,
            phases,
            state: &work.state,
            out: &mut work.gated,
        });
        self.project.forward(&work.gated, &mut work.projected);
        self.norm.forward(&work.projected, &mut work.normed);
        self.directions.forward(&work.normed, weights);
        self.isa.run(Assign {
            latent: self.project.outputs(),
            clusters: self.directions.outputs(),
            normed: &work.normed,
            weights,
        });
    }
}

/// Gated linear unit of each phase's part plus its agent's part.
struct Gate<'a> {
    /// Width of the parts, twice that of the result.
    width: usize,
    agents: &'a [AgentSpec],
    phases: &'a [f32],
    state: &'a [f32],
    out: &'a mut [f32],
}

impl Work for Gate<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let half = self.width / 2;
        let mut rows = self.phases.chunks_exact(self.width).zip(self.out.chunks_exact_mut(half));
        for (agent, state) in self.agents.iter().zip(self.state.chunks_exact(self.width)) {
            let (state, state_gate) = state.split_at(half);
            for (phase, out) in rows.by_ref().take(agent.phases) {
                let (phase, phase_gate) = phase.split_at(half);
                let (phase, phase_gate, state, state_gate) =
                    (&phase[..half], &phase_gate[..half], &state[..half], &state_gate[..half]);
                for (i, out) in out.iter_mut().enumerate() {
                    *out = (phase[i] + state[i]) * sigmoid::<FUSED>(phase_gate[i] + state_gate[i]);
                }
            }
        }
    }
}

/// Products with the centres' directions to soft assignments.
struct Assign<'a> {
    latent: usize,
    clusters: usize,
    /// `[rows, latent]`.
    normed: &'a [f32],
    /// `[rows, clusters]`, in and out.
    weights: &'a mut [f32],
}

impl Work for Assign<'_> {
    #[inline(always)]
    fn run<const WIDTH: usize, const FUSED: bool>(self) {
        let rows = self.weights.chunks_exact_mut(self.clusters).zip(self.normed.chunks_exact(self.latent));
        for (weights, normed) in rows {
            let scale = 1.0 / dot::<FUSED>(normed, normed).max(1e-12).sqrt();
            for weight in weights.iter_mut() {
                *weight *= scale;
            }
            softmax::<FUSED>(weights);
        }
    }
}
