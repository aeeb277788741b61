//! The processor's vector instructions, and running code that is compiled for them.
//!
//! The release build is for any x86-64. The few loops that acting and training spend their time in are compiled three times,
//! and the widest form that the processor has is chosen. Results of two forms differ by rounding; on one
//! machine it is always the same form, so that a run repeats itself bit for bit.

/// A set of instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Isa {
    /// What every processor of the architecture has.
    Generic,
    /// 256-bit vectors with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2(Has<2>),
    /// 512-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx512(Has<512>),
}

/// Proof that the processor was found to have an instruction set; made by [`Isa::available`] alone.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Has<const SET: usize>(());

/// A loop to compile for each set of instructions. Everything that `run` calls must be inlined into it.
pub(crate) trait Work {
    /// Does the work. `WIDTH`: outputs of a linear layer that are computed together; `FUSED`: whether the processor
    /// multiplies and adds in one instruction.
    fn run<const WIDTH: usize, const FUSED: bool>(self);
}

impl Isa {
    /// The sets that this processor has, the fastest last.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn available() -> Vec<Self> {
        let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
        match (avx2, is_x86_feature_detected!("avx512f")) {
            (false, _) => vec![Self::Generic],
            (true, false) => vec![Self::Generic, Self::Avx2(Has(()))],
            (true, true) => vec![Self::Generic, Self::Avx2(Has(())), Self::Avx512(Has(()))],
        }
    }

    /// The sets that this processor has: on other architectures one alone.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn available() -> Vec<Self> {
        vec![Self::Generic]
    }

    /// The fastest set that this processor has.
    pub(crate) fn best() -> Self {
        Self::available().pop().unwrap_or(Self::Generic)
    }

    /// Outputs of a linear layer that are computed together.
    pub(crate) fn width(self) -> usize {
        match self {
            Self::Generic => GENERIC_WIDTH,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(_) => AVX2_WIDTH,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(_) => AVX512_WIDTH,
        }
    }

    /// Does the work with these instructions.
    pub(crate) fn run(self, work: impl Work) {
        match self {
            Self::Generic => work.run::<GENERIC_WIDTH, GENERIC_FUSED>(),
            #[cfg(target_arch = "x86_64")]
            #[expect(unsafe_code, reason = "a Has<2> exists only where AVX2 and FMA were detected")]
            Self::Avx2(Has(())) => unsafe { avx2(work) },
            #[cfg(target_arch = "x86_64")]
            #[expect(unsafe_code, reason = "a Has<512> exists only where AVX-512F was detected")]
            Self::Avx512(Has(())) => unsafe { avx512(work) },
        }
    }
}

// Four rows of these widths leave the accumulators in registers: 16 of 128 or 256 bits, 32 of 512 bits.
const GENERIC_WIDTH: usize = 8;
/// Without the instruction a fused multiply-add is a slow library call. Every 64-bit ARM has it.
const GENERIC_FUSED: bool = cfg!(target_arch = "aarch64");
#[cfg(target_arch = "x86_64")]
const AVX2_WIDTH: usize = 16;
#[cfg(target_arch = "x86_64")]
const AVX512_WIDTH: usize = 32;

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2(work: impl Work) {
    work.run::<AVX2_WIDTH, true>();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn avx512(work: impl Work) {
    work.run::<AVX512_WIDTH, true>();
}
