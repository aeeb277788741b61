//! Packing ragged agents into tensors: sequences of equal length, grouped by their number of phases.
//!
//! Order, with `S` sequences of `L` steps: sequences sorted by group, a *sample* is (sequence, step), sequence-major; a
//! *row* is (sample, phase). A group's samples and rows are contiguous, so that what concerns one junction's phases is a
//! view and no padded phase exists. Lanes are padded inside a group and masked in the attention.
//!
//! A batch is packed on the CPU and moved whole ([`Batch::to_device`]); nothing in it stays behind.

use crate::features::{FeatureSizes, NetworkSpec, Track};
use cross_config::Gfe;
use tch::{Device, Kind, Tensor};

/// One agent's consecutive observations in a batch.
#[derive(Debug, Clone, Copy)]
pub struct Sequence<'a> {
    /// The agent's network.
    pub network: &'a NetworkSpec,
    /// The agent's index in it.
    pub agent: usize,
    /// The features.
    pub track: &'a Track,
    /// First observation.
    pub start: usize,
}

/// Sequences whose agents have the same number of phases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    /// Phases P of each.
    pub phases: i64,
    /// Samples (sequences x steps).
    pub samples: i64,
    /// Index of the first sample.
    pub first_sample: i64,
    /// Index of the first row.
    pub first_row: i64,
    /// In the form `paper`, columns of the padded state that any of its agents uses; else 0.
    pub columns: i64,
}

/// Network inputs, by form.
#[derive(Debug)]
pub enum Inputs {
    /// Flattened movements in link order.
    Paper(PaperInputs),
    /// Sums per phase.
    Movement(MovementInputs),
}

/// Inputs of the `paper` form.
#[derive(Debug)]
pub struct PaperInputs {
    /// Padded states `[samples, movements * 5]`.
    pub states: Tensor,
    /// Green masks of every sequence's phases `[static phases, movements]`.
    pub phase_states: Tensor,
    /// Index into `phase_states` for every row `[rows]`.
    pub phase_of_row: Tensor,
    /// 1 where a state entry belongs to a real movement `[samples, movements * 5]`.
    pub real: Tensor,
}

/// Inputs of the `movement` form.
#[derive(Debug)]
pub struct MovementInputs {
    /// Phase features `[rows, phase]`.
    pub phases: Tensor,
    /// Mean and maximum over the phases `[samples, 2 * phase]`.
    pub context: Tensor,
    /// Lane tokens, one entry per group.
    pub lanes: Vec<Lanes>,
}

/// Lane tokens of a group.
#[derive(Debug)]
pub struct Lanes {
    /// `[samples, most lanes, lane]`, zero where padded.
    pub features: Tensor,
    /// `[samples, most lanes]`: 0 where real, minus infinity where padded.
    pub mask: Tensor,
    /// Whether any is padded.
    pub padded: bool,
}

/// A packed batch.
#[derive(Debug)]
pub struct Batch {
    /// Number of sequences S.
    pub sequences: i64,
    /// Steps of each, L.
    pub steps: i64,
    /// Groups, fewest phases first.
    pub groups: Vec<Group>,
    /// Rows in all.
    pub rows: i64,
    /// Position in the caller's list of each packed sequence.
    pub order: Vec<usize>,
    /// Topology vectors `[sequences, topology]`.
    pub topology: Tensor,
    /// By form.
    pub inputs: Inputs,
    /// Sample of each row `[rows]`.
    sample_of_row: Tensor,
}

impl Batch {
    /// Packs sequences of `steps` observations each. The list must not be empty and hold one form only.
    #[must_use]
    pub fn new(list: &[Sequence<'_>], steps: usize, sizes: &FeatureSizes) -> Self {
        let mut order: Vec<usize> = (0..list.len()).collect();
        order.sort_by_key(|&i| phases_of(&list[i]));
        let sorted: Vec<&Sequence<'_>> = order.iter().map(|&i| &list[i]).collect();
        let mut groups: Vec<Group> = Vec::new();
        let (mut first_sample, mut first_row) = (0, 0);
        for sequence in &sorted {
            let phases = phases_of(sequence) as i64;
            let columns = match sequence.network.gfe {
                Gfe::Paper => sequence.network.agents[sequence.agent].state_entries() as i64,
                Gfe::Movement => 0,
            };
            match groups.last_mut() {
                Some(group) if group.phases == phases => {
                    group.samples += steps as i64;
                    group.columns = group.columns.max(columns);
                }
                _ => groups.push(Group { phases, samples: steps as i64, first_sample, first_row, columns }),
            }
            first_sample += steps as i64;
            first_row += steps as i64 * phases;
        }
        let sample_of_row: Vec<i64> = groups
            .iter()
            .flat_map(|group| {
                (0..group.samples).flat_map(|sample| {
                    std::iter::repeat_n(group.first_sample + sample, group.phases as usize)
                })
            })
            .collect();
        let topology: Vec<f32> =
            sorted.iter().flat_map(|s| s.network.agents[s.agent].topology.iter().copied()).collect();
        let inputs = match sorted.first().map(|s| s.network.gfe) {
            Some(Gfe::Paper) => Inputs::Paper(paper_inputs(&sorted, steps, sizes)),
            _ => Inputs::Movement(movement_inputs(&sorted, steps, sizes, &groups)),
        };
        Self {
            sequences: list.len() as i64,
            steps: steps as i64,
            groups,
            rows: first_row,
            order,
            topology: Tensor::from_slice(&topology).view([list.len() as i64, sizes.topology]),
            inputs,
            sample_of_row: Tensor::from_slice(&sample_of_row),
        }
    }

    /// The same batch on a device; free of charge where it is already.
    #[must_use]
    pub fn to_device(self, device: Device) -> Self {
        let inputs = match self.inputs {
            Inputs::Paper(paper) => Inputs::Paper(PaperInputs {
                states: paper.states.to_device(device),
                phase_states: paper.phase_states.to_device(device),
                phase_of_row: paper.phase_of_row.to_device(device),
                real: paper.real.to_device(device),
            }),
            Inputs::Movement(movement) => Inputs::Movement(MovementInputs {
                phases: movement.phases.to_device(device),
                context: movement.context.to_device(device),
                lanes: movement
                    .lanes
                    .iter()
                    .map(|lanes| Lanes {
                        features: lanes.features.to_device(device),
                        mask: lanes.mask.to_device(device),
                        padded: lanes.padded,
                    })
                    .collect(),
            }),
        };
        Self {
            sequences: self.sequences,
            steps: self.steps,
            groups: self.groups,
            rows: self.rows,
            order: self.order,
            topology: self.topology.to_device(device),
            inputs,
            sample_of_row: self.sample_of_row.to_device(device),
        }
    }

    /// Number of samples.
    #[must_use]
    pub fn samples(&self) -> i64 {
        self.sequences * self.steps
    }

    /// Sample of each row `[rows]`.
    pub(crate) fn sample_of_row(&self) -> &Tensor {
        &self.sample_of_row
    }

    /// Samples of each group.
    pub(crate) fn group_samples(&self) -> Vec<i64> {
        self.groups.iter().map(|group| group.samples).collect()
    }

    /// Rows of each group.
    pub(crate) fn group_rows(&self) -> Vec<i64> {
        self.groups.iter().map(|group| group.samples * group.phases).collect()
    }

    /// Phases of each group's sequences, every phase once and not at every step.
    pub(crate) fn group_static_phases(&self) -> Vec<i64> {
        self.groups.iter().map(|group| group.samples / self.steps * group.phases).collect()
    }

    /// `[samples, w]` to `[rows, w]`.
    pub fn repeat_over_phases(&self, x: &Tensor) -> Tensor {
        x.index_select(0, &self.sample_of_row)
    }

    /// `[sequences, w]` to `[samples, w]`.
    pub fn repeat_over_steps(&self, x: &Tensor) -> Tensor {
        x.unsqueeze(1).expand([-1, self.steps, -1], false).reshape([self.samples(), -1])
    }

    /// Sums over each sample's rows: `[rows]` to `[samples]`.
    pub fn sum_over_phases(&self, x: &Tensor) -> Tensor {
        Tensor::zeros([self.samples()], (x.kind(), x.device())).index_add(0, &self.sample_of_row, x)
    }

    /// Applies `f` to each group's rows as `[samples, phases, w]` and joins the results over samples.
    pub fn map_groups(&self, rows: &Tensor, f: impl Fn(&Tensor) -> Tensor) -> Tensor {
        let parts: Vec<Tensor> = self
            .groups
            .iter()
            .map(|group| {
                let own = rows.narrow(0, group.first_row, group.samples * group.phases);
                f(&own.view([group.samples, group.phases, -1]))
            })
            .collect();
        Tensor::cat(&parts, 0)
    }

    /// Log-probabilities of every row's phase among its junction's `[rows]`.
    pub fn log_softmax(&self, scores: &Tensor) -> Tensor {
        self.map_groups(scores, |own| own.squeeze_dim(2).log_softmax(1, Kind::Float).reshape([-1]))
    }

    /// Row of each sample's action `[samples]`; `actions` in packed sample order.
    pub fn chosen_rows(&self, actions: &[u8]) -> Tensor {
        let mut rows = Vec::with_capacity(actions.len());
        for group in &self.groups {
            for sample in 0..group.samples {
                let action = i64::from(actions[(group.first_sample + sample) as usize]);
                rows.push(group.first_row + sample * group.phases + action);
            }
        }
        Tensor::from_slice(&rows)
    }

    /// Of numbers for every padded state entry `[samples, movements * 5]`, those that some movement of the group has: a
    /// view for each group. What is padded there costs nothing.
    pub(crate) fn real_columns(&self, padded: &Tensor) -> Vec<Tensor> {
        let groups = self.groups.iter().zip(padded.split_with_sizes(self.group_samples(), 0));
        groups.map(|(group, own)| own.narrow(1, 0, group.columns)).collect()
    }
}

/// A table of whole numbers, row by row.
pub(crate) fn whole_numbers(table: &Tensor) -> Vec<i64> {
    let flat = table.to_device(Device::Cpu).contiguous().view([-1]);
    let mut values = vec![0i64; flat.numel()];
    let count = values.len();
    flat.copy_data(&mut values, count);
    values
}

fn phases_of(sequence: &Sequence<'_>) -> usize {
    sequence.network.agents[sequence.agent].phases
}

fn slice<'a>(values: &'a [f32], sequence: &Sequence<'_>, steps: usize, width: usize) -> &'a [f32] {
    &values[sequence.start * width..(sequence.start + steps) * width]
}

fn paper_inputs(sorted: &[&Sequence<'_>], steps: usize, sizes: &FeatureSizes) -> PaperInputs {
    let (state, movements) = (sizes.state as usize, sizes.movements as usize);
    let (mut states, mut phase_states, mut phase_of_row, mut real) = (vec![], vec![], vec![], vec![]);
    for sequence in sorted {
        let spec = &sequence.network.agents[sequence.agent];
        states.extend_from_slice(slice(&sequence.track.states, sequence, steps, state));
        let first = (phase_states.len() / movements) as i64;
        phase_states.extend_from_slice(&spec.phase_state);
        for _ in 0..steps {
            phase_of_row.extend(first..first + spec.phases as i64);
            real.extend((0..state).map(|i| f32::from(u8::from(i < spec.state_entries()))));
        }
    }
    let samples = (sorted.len() * steps) as i64;
    PaperInputs {
        states: Tensor::from_slice(&states).view([samples, sizes.state]),
        phase_states: Tensor::from_slice(&phase_states).view([-1, sizes.movements]),
        phase_of_row: Tensor::from_slice(&phase_of_row),
        real: Tensor::from_slice(&real).view([samples, sizes.state]),
    }
}

fn movement_inputs(
    sorted: &[&Sequence<'_>],
    steps: usize,
    sizes: &FeatureSizes,
    groups: &[Group],
) -> MovementInputs {
    let (phase, lane) = (sizes.phase as usize, sizes.lane as usize);
    let (mut phases, mut context) = (vec![], vec![]);
    for sequence in sorted {
        let own = phases_of(sequence) * phase;
        phases.extend_from_slice(slice(&sequence.track.phases, sequence, steps, own));
        context.extend_from_slice(slice(&sequence.track.context, sequence, steps, 2 * phase));
    }
    let lanes = groups
        .iter()
        .map(|group| {
            let first = group.first_sample as usize / steps;
            let own = &sorted[first..first + group.samples as usize / steps];
            let most = own.iter().map(|s| s.network.agents[s.agent].lanes).max().unwrap_or(0);
            let (mut features, mut mask) = (vec![], vec![]);
            for sequence in own {
                let count = sequence.network.agents[sequence.agent].lanes;
                for row in slice(&sequence.track.lanes, sequence, steps, count * lane).chunks(count * lane) {
                    features.extend_from_slice(row);
                    features.resize(features.len() + (most - count) * lane, 0.0);
                    mask.extend(std::iter::repeat_n(0.0f32, count));
                    mask.extend(std::iter::repeat_n(f32::NEG_INFINITY, most - count));
                }
            }
            Lanes {
                padded: mask.iter().any(|&real| real != 0.0),
                features: Tensor::from_slice(&features).view([group.samples, most as i64, sizes.lane]),
                mask: Tensor::from_slice(&mask).view([group.samples, most as i64]),
            }
        })
        .collect();
    MovementInputs {
        phases: Tensor::from_slice(&phases).view([-1, sizes.phase]),
        context: Tensor::from_slice(&context).view([-1, 2 * sizes.phase]),
        lanes,
    }
}
