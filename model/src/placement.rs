//! Where an update is computed, and in which precision.
//!
//! Only the learner's networks are ever placed anywhere but on the CPU: an actor decides for a few intersections at a time,
//! which a transfer would cost more than the computation.

use crate::error::ModelError;
use cross_config::{ComputeDevice, LearnerConfig, Precision};
use tch::Device;

/// A device that is there, and a precision that it has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Placement {
    /// Where parameters, batches and optimiser state are.
    pub device: Device,
    /// Precision of the linear layers' products.
    pub precision: Precision,
}

/// What this machine and this libtorch can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Abilities {
    /// libtorch was built with CUDA and its CUDA part is loaded.
    pub cuda_built: bool,
    /// CUDA devices that it finds.
    pub cuda_devices: usize,
    /// The processor multiplies bfloat16.
    pub cpu_bf16: bool,
}

impl Abilities {
    /// Looks.
    #[must_use]
    pub fn detect() -> Self {
        let cuda_devices = usize::try_from(tch::Cuda::device_count()).unwrap_or_default();
        Self { cuda_built: tch::utils::has_cudart(), cuda_devices, cpu_bf16: cpu_has_bf16() }
    }
}

impl Placement {
    /// The CPU in single precision.
    pub const CPU: Self = Self { device: Device::Cpu, precision: Precision::F32 };

    /// What a configuration comes to on this machine.
    ///
    /// # Errors
    /// [`ModelError::NoCuda`] or [`ModelError::NoBf16`] if it asks for what is not there.
    pub fn resolve(config: &LearnerConfig) -> Result<Self, ModelError> {
        Self::choose(config, Abilities::detect())
    }

    fn choose(config: &LearnerConfig, machine: Abilities) -> Result<Self, ModelError> {
        let cuda = machine.cuda_devices > 0;
        let device = match config.device {
            // Sums over atomic additions differ from run to run on a GPU.
            ComputeDevice::Auto if cuda && !config.serial => Device::Cuda(0),
            ComputeDevice::Auto | ComputeDevice::Cpu => Device::Cpu,
            ComputeDevice::Cuda if cuda => Device::Cuda(0),
            ComputeDevice::Cuda if machine.cuda_built => {
                return Err(ModelError::NoCuda(
                    "libtorch finds no CUDA device (see nvidia-smi and CUDA_VISIBLE_DEVICES)",
                ));
            }
            ComputeDevice::Cuda => {
                return Err(ModelError::NoCuda(
                    "this libtorch is without CUDA (set it up with `CROSS_TORCH=cuda make build`)",
                ));
            }
        };
        if config.precision == Precision::Bf16 && device == Device::Cpu && !machine.cpu_bf16 {
            return Err(ModelError::NoBf16);
        }
        Ok(Self { device, precision: config.precision })
    }

    /// `cpu` or `cuda:0`.
    #[must_use]
    pub fn device_name(&self) -> String {
        match self.device {
            Device::Cuda(index) => format!("cuda:{index}"),
            _ => "cpu".to_owned(),
        }
    }

    /// `f32` or `bf16`.
    #[must_use]
    pub fn precision_name(&self) -> &'static str {
        match self.precision {
            Precision::F32 => "f32",
            Precision::Bf16 => "bf16",
        }
    }
}

/// Whether bfloat16 products run in hardware. Every processor with AMX's also has AVX-512's.
#[cfg(target_arch = "x86_64")]
fn cpu_has_bf16() -> bool {
    std::arch::is_x86_feature_detected!("avx512bf16")
}

#[cfg(target_arch = "aarch64")]
fn cpu_has_bf16() -> bool {
    std::arch::is_aarch64_feature_detected!("bf16")
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn cpu_has_bf16() -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    const BARE: Abilities = Abilities { cuda_built: false, cuda_devices: 0, cpu_bf16: false };
    const GPU: Abilities = Abilities { cuda_built: true, cuda_devices: 2, cpu_bf16: false };

    fn asked(device: ComputeDevice, precision: Precision, serial: bool) -> LearnerConfig {
        LearnerConfig { device, precision, serial, ..LearnerConfig::default() }
    }

    fn device(wanted: ComputeDevice, serial: bool, machine: Abilities) -> Result<Device, String> {
        let placement = Placement::choose(&asked(wanted, Precision::F32, serial), machine);
        placement.map(|p| p.device).map_err(|error| error.to_string())
    }

    #[test]
    fn auto_takes_cuda_where_it_is_and_never_fails() {
        assert_eq!(device(ComputeDevice::Auto, false, GPU), Ok(Device::Cuda(0)));
        assert_eq!(device(ComputeDevice::Auto, false, BARE), Ok(Device::Cpu));
        assert_eq!(device(ComputeDevice::Cpu, false, GPU), Ok(Device::Cpu));
    }

    #[test]
    fn serial_mode_stays_on_the_cpu_unless_told_otherwise() {
        assert_eq!(device(ComputeDevice::Auto, true, GPU), Ok(Device::Cpu));
        assert_eq!(device(ComputeDevice::Cuda, true, GPU), Ok(Device::Cuda(0)));
    }

    #[test]
    fn cuda_that_is_not_there_is_refused_with_the_reason() {
        let without_library = device(ComputeDevice::Cuda, false, BARE).unwrap_err();
        assert!(without_library.contains("CROSS_TORCH=cuda"), "{without_library}");
        let without_device = Abilities { cuda_built: true, ..BARE };
        let without_device = device(ComputeDevice::Cuda, false, without_device).unwrap_err();
        assert!(without_device.contains("nvidia-smi"), "{without_device}");
    }

    #[test]
    fn bf16_needs_a_processor_or_a_gpu_that_has_it() {
        let wanted = asked(ComputeDevice::Auto, Precision::Bf16, false);
        assert!(matches!(Placement::choose(&wanted, BARE), Err(ModelError::NoBf16)));
        assert!(Placement::choose(&wanted, GPU).is_ok());
        let placement = Placement::choose(&wanted, Abilities { cpu_bf16: true, ..BARE }).unwrap();
        assert_eq!((placement.device_name().as_str(), placement.precision_name()), ("cpu", "bf16"));
    }
}
