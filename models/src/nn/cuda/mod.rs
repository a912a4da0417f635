//! Kernels for GPUs of NVIDIA: those in `kernels`.

mod attention;
mod unfold;

use candle_core::cuda_backend::WrapErr;
use candle_core::{CudaDevice, Result};

pub(super) use attention::attention;
pub(super) use unfold::{unfold, unfolds};

/// The first generation of GPUs that the kernels are for.
const CAPABILITY: (i32, i32) = (8, 0);
/// Bytes that are read at a time.
const CHUNK: usize = 16;

/// Whether the kernels run on this GPU.
fn has_kernels(device: &CudaDevice) -> Result<bool> {
    let stream = device.cuda_stream();
    Ok(stream.context().compute_capability().w()? >= CAPABILITY)
}
