//! Where networks compute.
//!
//! ```
//! use tid3r_models::device::{Place, missing_for_cuda};
//!
//! let place = match missing_for_cuda() {
//!     None => Place::Cuda(0),
//!     Some(_) => Place::Cpu,
//! };
//! assert!(place.open().is_ok());
//! ```

use std::fmt;
use std::str::FromStr;
use std::time::Instant;

use candle_core::{Device, Result, Tensor, bail};

use crate::ComputeType;

/// A processor or GPU that networks compute on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Place {
    /// The CPU.
    #[default]
    Cpu,
    /// The GPU of NVIDIA with this number, from 0 on.
    Cuda(usize),
}

impl Place {
    /// It, ready for tensors. CUDA's libraries are loaded now, not before.
    ///
    /// # Errors
    ///
    /// If this build, or this machine, cannot compute there; says what is missing.
    pub fn open(self) -> Result<Device> {
        match self {
            Self::Cpu => Ok(Device::Cpu),
            Self::Cuda(index) => gpu(index),
        }
    }
}

/// What is missing for this build to compute on GPUs, if anything is.
#[cfg(not(feature = "cuda"))]
pub fn missing_for_cuda() -> Option<String> {
    Some("this build computes on the processor".to_owned())
}

/// What is missing for this build to compute on GPUs, if anything is.
#[cfg(feature = "cuda")]
pub fn missing_for_cuda() -> Option<String> {
    use candle_core::cuda_backend::cudarc::{cublas, curand, driver};
    // SAFETY: the libraries are NVIDIA's own, and loading them runs nothing but their initialisers.
    #[expect(unsafe_code, reason = "a library is loaded")]
    let found = unsafe {
        [
            ("libcuda (NVIDIA's driver)", driver::sys::is_culib_present()),
            ("libcublas", cublas::sys::is_culib_present()),
            ("libcurand", curand::sys::is_culib_present()),
        ]
    };
    let missing = found.iter().filter(|(_, is_here)| !is_here);
    let names: Vec<&str> = missing.map(|(name, _)| *name).collect();
    (!names.is_empty()).then(|| format!("not found: {}", names.join(", ")))
}

/// Bytes that can still be taken of a GPU's memory; `None` of what is no GPU.
#[cfg(feature = "cuda")]
pub fn free_memory(device: &Device) -> Option<u64> {
    use candle_core::cuda_backend::cudarc::driver::result::mem_get_info;
    let device = device.as_cuda_device().ok()?;
    device.cuda_stream().context().bind_to_thread().ok()?;
    let (free, _) = mem_get_info().ok()?;
    Some(free as u64)
}

/// Bytes that can still be taken of a GPU's memory; `None` of what is no GPU.
#[cfg(not(feature = "cuda"))]
pub fn free_memory(_: &Device) -> Option<u64> {
    None
}

/// Operations in a second, two for each multiply-add, of a large product of matrices on `device` in this type.
///
/// # Errors
///
/// Those of candle.
pub fn measured_product_flops(device: &Device, compute_type: ComputeType) -> Result<f64> {
    const SIDE: usize = 4096;
    const TIMES: u32 = 4;
    let matrix = Tensor::ones((SIDE, SIDE), compute_type.dtype(), device)?;
    // The first one loads what it needs.
    matrix.matmul(&matrix)?;
    device.synchronize()?;
    let start = Instant::now();
    for _ in 0..TIMES {
        matrix.matmul(&matrix)?;
    }
    device.synchronize()?;
    let operations = 2.0 * (SIDE as f64).powi(3) * f64::from(TIMES);
    Ok(operations / start.elapsed().as_secs_f64())
}

#[cfg(not(feature = "cuda"))]
fn gpu(_: usize) -> Result<Device> {
    bail!("this build computes on the processor only")
}

#[cfg(feature = "cuda")]
fn gpu(index: usize) -> Result<Device> {
    if let Some(missing) = missing_for_cuda() {
        bail!("{missing}");
    }
    Device::new_cuda(index)
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(0) => f.write_str("cuda"),
            Self::Cuda(index) => write!(f, "cuda:{index}"),
        }
    }
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let index = match text.split_once(':') {
            None if text == "cpu" => return Ok(Self::Cpu),
            None if text == "cuda" => Some(0),
            Some(("cuda", index)) => index.parse().ok(),
            _ => None,
        };
        let place = index.map(Self::Cuda);
        place.ok_or_else(|| format!("'{text}' is neither cpu, cuda nor, say, cuda:1"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_read_back() {
        for place in [Place::Cpu, Place::Cuda(0), Place::Cuda(3)] {
            assert_eq!(place.to_string().parse(), Ok(place));
        }
        for text in ["", "gpu", "cuda:", "cuda:-1", "cpu:0"] {
            assert!(text.parse::<Place>().is_err(), "{text}");
        }
    }

    #[test]
    fn what_is_missing_is_said() {
        assert!(Place::Cpu.open().unwrap().is_cpu());
        if let Some(missing) = missing_for_cuda() {
            assert!(Place::Cuda(0).open().is_err(), "{missing}");
        }
    }
}
