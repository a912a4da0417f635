//! What windows of a convolution see, row by row: `kernels/unfold.cu`.

use std::ops::Range;

use candle_core::cuda_backend::cudarc::driver::{
    DevicePtr, DevicePtrMut, DeviceRepr, LaunchConfig, PushKernelArg,
};
use candle_core::cuda_backend::{CudaDType, WrapErr};
use candle_core::op::BackpropOp;
use candle_core::{
    CudaDevice, CudaStorage, DType, Device, Error, Layout, Result, Storage, Tensor, bail,
};
use half::{bf16, f16};

use super::{CHUNK, has_kernels};
use crate::nn::cpu::conv::{Images, Steps};

const PTX: &str = include_str!(concat!(env!("OUT_DIR"), "/unfold.ptx"));
const THREADS: u32 = 256;

/// What the kernel is told; there are comments in its source.
#[repr(C)]
struct Arguments {
    images: u64,
    rows: u64,
    chunks_of_all: u32,
    first: u32,
    chunks: u32,
    height: u32,
    width: u32,
    strided_height: u32,
    strided_width: u32,
    kernel: u32,
    stride: u32,
    before: u32,
}

// SAFETY: numbers, laid out as in C++.
#[expect(unsafe_code, reason = "the kernel takes it as it is")]
unsafe impl DeviceRepr for Arguments {}

/// Whether there is a kernel that unfolds images of so many channels of this type on this device.
///
/// # Errors
///
/// Those of CUDA.
pub(in crate::nn) fn unfolds(device: &Device, dtype: DType, channels: usize) -> Result<bool> {
    let Device::Cuda(device) = device else {
        return Ok(false);
    };
    let fits = matches!(dtype, DType::F32 | DType::BF16 | DType::F16);
    Ok(fits && (channels * dtype.size_in_bytes()).is_multiple_of(CHUNK) && has_kernels(device)?)
}

/// For each of these `pixels` of the strided images, counted through all of them, a row of what its window of `x` (batch,
/// height, width, channels) sees, zeros beyond the edges: (pixels, kernel * kernel * channels).
///
/// # Errors
///
/// If [`unfolds`] is not so or there are too many, and those of CUDA.
pub(in crate::nn) fn unfold(x: &Tensor, steps: Steps, pixels: Range<usize>) -> Result<Tensor> {
    let Device::Cuda(device) = x.device() else {
        bail!("a tensor is not on the GPU");
    };
    let aligned = (x.layout().start_offset() * x.dtype().size_in_bytes()).is_multiple_of(CHUNK);
    let x = match aligned {
        true => x.contiguous()?,
        false => x.force_contiguous()?,
    };
    let (storage, layout) = x.storage_and_layout();
    let Storage::Cuda(storage) = &*storage else {
        bail!("a tensor is not on the GPU");
    };
    let shape = (pixels.len(), steps.kernel * steps.kernel * x.dim(3)?);
    let rows = match x.dtype() {
        DType::F32 => unfolded::<f32>(device, storage, layout, steps, pixels)?,
        DType::BF16 => unfolded::<bf16>(device, storage, layout, steps, pixels)?,
        DType::F16 => unfolded::<f16>(device, storage, layout, steps, pixels)?,
        other => bail!("numbers of type {other:?} are not unfolded"),
    };
    Ok(Tensor::from_storage(
        Storage::Cuda(rows),
        shape,
        BackpropOp::none(),
        false,
    ))
}

fn unfolded<T: CudaDType + DeviceRepr>(
    device: &CudaDevice,
    storage: &CudaStorage,
    layout: &Layout,
    steps: Steps,
    pixels: Range<usize>,
) -> Result<CudaStorage> {
    let (batch, height, width, channels) = layout.shape().dims4()?;
    let strided = steps.over(Images {
        batch,
        height,
        width,
    });
    if pixels.end > strided.pixels() {
        bail!("pixels {pixels:?} of {} are wanted", strided.pixels());
    }
    let number = |count: usize| u32::try_from(count).map_err(Error::wrap);
    number(strided.pixels())?;
    let in_chunks = |numbers: usize| number(numbers * size_of::<T>() / CHUNK);
    let count = pixels.len() * steps.kernel * steps.kernel * channels;
    let stream = device.cuda_stream();
    let (first, read) = storage.as_cuda_slice::<T>()?.device_ptr(&stream);
    // SAFETY: the kernel writes all of it.
    #[expect(unsafe_code, reason = "memory is taken as it is")]
    let mut rows = unsafe { device.alloc::<T>(count) }?;
    let (to, written) = rows.device_ptr_mut(&stream);
    let arguments = Arguments {
        images: first + (layout.start_offset() * size_of::<T>()) as u64,
        rows: to,
        chunks_of_all: in_chunks(count)?,
        first: number(pixels.start)?,
        chunks: in_chunks(channels)?,
        height: number(height)?,
        width: number(width)?,
        strided_height: number(strided.height)?,
        strided_width: number(strided.width)?,
        kernel: number(steps.kernel)?,
        stride: number(steps.stride)?,
        before: number(steps.before)?,
    };
    let function = device.get_or_load_custom_func("unfold", "tid3r_unfold", PTX)?;
    let config = LaunchConfig {
        grid_dim: (arguments.chunks_of_all.div_ceil(THREADS), 1, 1),
        block_dim: (THREADS, 1, 1),
        shared_mem_bytes: 0,
    };
    let mut launch = function.builder();
    launch.arg(&arguments);
    // SAFETY: these are the arguments of the kernel. It reads contiguous images of these sizes, and writes `rows`. Both are
    // freed on the stream, so after the kernel has run.
    #[expect(unsafe_code, reason = "a kernel is launched")]
    unsafe { launch.launch(config) }.w()?;
    drop((read, written));
    Ok(CudaStorage::wrap_cuda_slice(rows, device.clone()))
}
