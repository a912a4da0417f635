//! Attention: `kernels/attention.cu`.

use std::f32::consts::LOG2_E;

use candle_core::backend::BackendStorage;
use candle_core::cuda_backend::WrapErr;
use candle_core::cuda_backend::cudarc::driver::sys::CUdevice_attribute::CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT;
use candle_core::cuda_backend::cudarc::driver::{
    CudaStream, DevicePtr, DevicePtrMut, DeviceRepr, LaunchConfig, PushKernelArg, SyncOnDrop,
};
use candle_core::op::BackpropOp;
use candle_core::{
    CudaDevice, CudaStorage, DType, Device, Error, Layout, Result, Storage, Tensor, bail,
};
use half::{bf16, f16};

use super::{CHUNK, has_kernels};
use crate::nn::Memory;

const PTX: &str = include_str!(concat!(env!("OUT_DIR"), "/attention.ptx"));
const THREADS: u32 = 128;
/// Queries of a block of threads; twice as many are in a wide one.
const QUERIES: usize = 64;
/// Channels of a head that there are kernels for, which take fewer, too; and whether there are wide ones.
const DIMS: [(usize, bool); 4] = [(16, true), (32, true), (64, true), (80, false)];
/// Numbers that are read at a time.
const NUMBERS: usize = CHUNK / size_of::<u16>();
/// Memories that a kernel is told of.
const MEMORIES: usize = 48;
/// Memories that groups attend to, a memory counted for each of its groups.
const OF_GROUPS: usize = 1024;

/// Vectors of a tensor, as the kernel reads them; strides are in numbers.
#[repr(C)]
#[derive(Clone, Copy, Default)]
struct Rows {
    first: u64,
    batch_stride: u64,
    token_stride: u64,
}

/// Keys and values of some tokens.
#[repr(C)]
#[derive(Clone, Copy, Default)]
struct Part {
    k: Rows,
    v: Rows,
    tokens: u32,
}

/// What the kernel is told; there are comments in its source.
#[repr(C)]
struct Arguments {
    q: Rows,
    out: u64,
    queries: u32,
    heads: u32,
    dim: u32,
    batch: u32,
    causal: u32,
    scale: f32,
    memories: [Part; MEMORIES],
    starts: [u16; MEMORIES + 1],
    of_groups: [u8; OF_GROUPS],
}

// SAFETY: numbers, and arrays of them, laid out as in C++.
#[expect(unsafe_code, reason = "the kernel takes it as it is")]
unsafe impl DeviceRepr for Arguments {}

/// Attention with queries, keys and values rounded to `dtype`, where each of the `groups` in the batch of `q` attends to
/// memories of its own; of `causal` tokens, each attends to those up to itself.
///
/// `None` if there is no kernel for such tensors, or on this GPU.
///
/// # Errors
///
/// Those of CUDA.
pub(in crate::nn) fn attention(
    q: &Tensor,
    groups: &[impl AsRef<[Memory]>],
    heads: usize,
    causal: bool,
    dtype: DType,
) -> Result<Option<Tensor>> {
    let (Device::Cuda(device), &[all, queries, channels]) = (q.device(), q.dims()) else {
        return Ok(None);
    };
    if !matches!(dtype, DType::BF16 | DType::F16)
        || q.elem_count() == 0
        || heads == 0
        || !channels.is_multiple_of(heads * NUMBERS)
        || groups.is_empty()
        || !all.is_multiple_of(groups.len())
    {
        return Ok(None);
    }
    let (batch, dim) = (all / groups.len(), channels / heads);
    let fits = |memory: &&Memory| {
        let (k, v) = (&memory.k, &memory.v);
        let of_batch = matches!(*k.dims(), [of, tokens, of_channels]
            if [1, batch].contains(&of) && tokens > 0 && of_channels == channels);
        let is_here = |x: &Tensor| x.device().same_device(q.device());
        of_batch && v.dims() == k.dims() && is_here(k) && is_here(v)
    };
    let listed = Listed::of(groups).filter(|listed| listed.memories.iter().all(fits));
    let kernel = Kernel::of(device, queries, heads * all, dim)?;
    let (Some(listed), Some(kernel)) = (listed, kernel) else {
        return Ok(None);
    };

    let stream = device.cuda_stream();
    let q_read = readable(q, dtype)?;
    let mut read = Vec::new();
    for memory in &listed.memories {
        read.push([readable(&memory.k, dtype)?, readable(&memory.v, dtype)?]);
    }
    let tensors = std::iter::once(&q_read).chain(read.iter().flatten());
    let storages: Vec<_> = tensors.map(Tensor::storage_and_layout).collect();
    let rows = storages
        .iter()
        .map(|(storage, layout)| rows(storage, layout, &stream));
    // That tensors are read is noted when `reads` are dropped.
    let (rows, reads): (Vec<_>, Vec<_>) = rows.collect::<Result<Vec<_>>>()?.into_iter().unzip();
    let number = |count: usize| u32::try_from(count).map_err(Error::wrap);
    let mut memories = [Part::default(); MEMORIES];
    let of_memories = listed.memories.iter().zip(rows[1..].as_chunks().0);
    for (part, (memory, &[k, v])) in memories.iter_mut().zip(of_memories) {
        let tokens = number(memory.k.dim(1)?)?;
        *part = Part { k, v, tokens };
    }
    // SAFETY: the kernel writes all of it.
    #[expect(unsafe_code, reason = "memory is taken as it is")]
    let mut out = unsafe { device.alloc::<f32>(q.elem_count()) }?;
    let (to, written) = out.device_ptr_mut(&stream);
    let arguments = Arguments {
        q: rows[0],
        out: to,
        queries: number(queries)?,
        heads: number(heads)?,
        dim: number(dim)?,
        batch: number(batch)?,
        causal: causal.into(),
        scale: LOG2_E / (dim as f32).sqrt(),
        memories,
        starts: listed.starts,
        of_groups: listed.of_groups,
    };
    let name = format!(
        "attention_{}_{}_{}",
        dtype.as_str(),
        kernel.dim,
        kernel.tiles
    );
    let function = device.get_or_load_custom_func(&name, "tid3r_attention", PTX)?;
    let config = LaunchConfig {
        grid_dim: (number(kernel.blocks)?, 1, 1),
        block_dim: (THREADS, 1, 1),
        shared_mem_bytes: 0,
    };
    let mut launch = function.builder();
    launch.arg(&arguments);
    // SAFETY: these are the arguments of the kernel. It reads tensors within the sizes and strides that they have, of the
    // type that its name says, and writes `out`. All of it is freed on the stream, so after the kernel has run.
    #[expect(unsafe_code, reason = "a kernel is launched")]
    unsafe { launch.launch(config) }.w()?;
    drop((reads, written));
    let out = Storage::Cuda(CudaStorage::wrap_cuda_slice(out, device.clone()));
    let out = Tensor::from_storage(out, q.dims(), BackpropOp::none(), false);
    out.to_dtype(q.dtype()).map(Some)
}

/// Which kernel it is, and how many blocks of threads run it.
struct Kernel {
    dim: usize,
    tiles: usize,
    blocks: usize,
}

impl Kernel {
    /// For so many queries, in each of so many heads of all batches. `None` if there is none.
    fn of(device: &CudaDevice, queries: usize, heads: usize, dim: usize) -> Result<Option<Self>> {
        let Some(&(dim, has_wide)) = DIMS.iter().find(|(most, _)| dim <= *most) else {
            return Ok(None);
        };
        if !has_kernels(device)? {
            return Ok(None);
        }
        let stream = device.cuda_stream();
        let multiprocessors = stream
            .context()
            .attribute(CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT)
            .w()?;
        let of = |tiles| Self {
            dim,
            tiles,
            blocks: queries.div_ceil(tiles * QUERIES) * heads,
        };
        // Wide blocks read less for what they compute, but each multiprocessor needs two of them.
        let are_many = queries > QUERIES && of(2).blocks >= 2 * multiprocessors as usize;
        Ok(Some(of(if has_wide && are_many { 2 } else { 1 })))
    }
}

/// Each memory once, and which of them groups attend to.
struct Listed<'a> {
    memories: Vec<&'a Memory>,
    starts: [u16; MEMORIES + 1],
    of_groups: [u8; OF_GROUPS],
}

impl<'a> Listed<'a> {
    /// `None` if there are too many, or none for a group.
    fn of(groups: &'a [impl AsRef<[Memory]>]) -> Option<Self> {
        let mut listed = Self {
            memories: Vec::new(),
            starts: [0; MEMORIES + 1],
            of_groups: [0; OF_GROUPS],
        };
        let mut end = 0;
        for (i, group) in groups.iter().map(AsRef::as_ref).enumerate() {
            if group.is_empty() {
                return None;
            }
            for memory in group {
                let is_same =
                    |of: &&Memory| (of.k.id(), of.v.id()) == (memory.k.id(), memory.v.id());
                let index = listed.memories.iter().position(is_same).unwrap_or_else(|| {
                    listed.memories.push(memory);
                    listed.memories.len() - 1
                });
                *listed.of_groups.get_mut(end)? = u8::try_from(index).ok()?;
                end += 1;
            }
            *listed.starts.get_mut(i + 1)? = u16::try_from(end).ok()?;
        }
        (listed.memories.len() <= MEMORIES).then_some(listed)
    }
}

/// `x` rounded, and such that 16 bytes can be read at a time.
fn readable(x: &Tensor, dtype: DType) -> Result<Tensor> {
    let x = x.to_dtype(dtype)?;
    let steps = [x.layout().start_offset(), x.stride()[0], x.stride()[1]];
    match x.stride()[2] == 1 && steps.iter().all(|step| step.is_multiple_of(NUMBERS)) {
        true => Ok(x),
        false => x.force_contiguous(),
    }
}

/// Where the numbers of a tensor are; a batch of 1 is the same for all.
fn rows<'a>(
    storage: &'a Storage,
    layout: &Layout,
    stream: &'a CudaStream,
) -> Result<(Rows, SyncOnDrop<'a>)> {
    let Storage::Cuda(storage) = storage else {
        bail!("a tensor is not on the GPU");
    };
    let (start, read) = match storage.dtype() {
        DType::BF16 => storage.as_cuda_slice::<bf16>()?.device_ptr(stream),
        _ => storage.as_cuda_slice::<f16>()?.device_ptr(stream),
    };
    let batch_stride = match layout.dims()[0] {
        1 => 0,
        _ => layout.stride()[0],
    };
    let rows = Rows {
        first: start + (layout.start_offset() * size_of::<u16>()) as u64,
        batch_stride: batch_stride as u64,
        token_stride: layout.stride()[1] as u64,
    };
    Ok((rows, read))
}
