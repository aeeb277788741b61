//! What can go wrong with a model.

/// A model, snapshot or batch that cannot be used, in one sentence.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// Bytes that are no safetensors file, or a damaged one.
    #[error("the {what} is damaged or cut short ({reason}); take an earlier checkpoint")]
    Damaged {
        /// Which file or message.
        what: &'static str,
        /// What the reader found.
        reason: String,
    },
    /// A safetensors file of something else.
    #[error("the {what} was not written by CROSS or by another format version ({reason})")]
    Foreign {
        /// Which file or message.
        what: &'static str,
        /// What is missing or different.
        reason: String,
    },
    /// A tensor of another name or shape than the configuration asks for.
    #[error("the {what} does not fit this configuration: {reason}")]
    Mismatch {
        /// Which file or message.
        what: &'static str,
        /// The tensor or key at fault.
        reason: String,
    },
    /// An observation or fragment whose sizes are not those of its network.
    #[error("{what} has {got} values where the network {scenario} needs {wanted}")]
    Shape {
        /// Field at fault.
        what: &'static str,
        /// Scenario or network.
        scenario: String,
        /// Values found.
        got: usize,
        /// Values needed.
        wanted: usize,
    },
    /// A fragment of a scenario that this trainer does not train.
    #[error("the scenario {0} is not part of this run")]
    UnknownScenario(String),
    /// An intersection beyond the model's limits.
    #[error(
        "the intersection {id} has {movements} movements and {phases} phases; this model takes at most {max_movements} and {max_phases} (env.max_movements, env.max_phases)"
    )]
    TooLarge {
        /// SUMO traffic light id.
        id: String,
        /// Its movements.
        movements: usize,
        /// Its green phases.
        phases: usize,
        /// Limit.
        max_movements: usize,
        /// Limit.
        max_phases: usize,
    },
    /// More roads than the `paper` form's topology vector holds.
    #[error(
        "the intersection {id} has {roads_in} incoming and {roads_out} outgoing roads; with model.gfe = \"paper\" it may have at most {max} of each, with model.gfe = \"movement\" any number"
    )]
    TooManyRoads {
        /// SUMO traffic light id.
        id: String,
        /// Its incoming roads.
        roads_in: usize,
        /// Its outgoing roads.
        roads_out: usize,
        /// Limit.
        max: usize,
    },
    /// A GPU was asked for and cannot be had.
    #[error(
        "the device cuda was asked for, but {0}; fix that, or set learner.device (--device) to cpu or auto"
    )]
    NoCuda(&'static str),
    /// bfloat16 was asked for on a processor without it.
    #[error(
        "learner.precision is bf16, but this processor has no bfloat16 instructions (avx512_bf16, amx_bf16), without which it is slower than f32; set it to f32"
    )]
    NoBf16,
    /// A loss or gradient that is not a number.
    #[error(
        "the {0} of this update is not finite; the weights before it are kept, lower the learning rates or look for odd rewards"
    )]
    NotFinite(&'static str),
    /// libtorch gave up in the middle of an update; on a GPU most likely for want of memory.
    #[error(
        "libtorch failed during an update ({0}); the weights before it are kept; if memory ran out, lower ppo.minibatch_decisions or ppo.sequence_steps"
    )]
    Update(String),
    /// A panic that was not libtorch's.
    #[error(
        "a defect of CROSS in an update: {message}, at {place}; the weights before it are kept; please report it"
    )]
    Defect {
        /// Of the panic.
        message: String,
        /// File, line and column.
        place: String,
    },
    /// An update without data.
    #[error("an update needs at least one fragment")]
    Empty,
    /// Something that libtorch refused.
    #[error("libtorch failed: {0}")]
    Torch(#[from] tch::TchError),
}
