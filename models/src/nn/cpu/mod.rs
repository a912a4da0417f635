//! Fast kernels for f32 on CPUs, which the layers beside this module call.
//!
//! Each kernel is written once, against the vectors of `simd`, and compiled for every instruction
//! set; [`Isa::current`] says at run time which one is used. The environment variable `TID3R_CPU`
//! (`avx512bf16`, `avx512`, `avx2` or `portable`) overrides it. If it is `candle`, no kernel is used: layers then compute
//! with candle's operations, as they do on GPUs.
//!
//! A result depends on the instruction set, but not on the number of threads.
//!
//! All unsafe code of this crate, apart from the mapping of weights and what launches kernels on GPUs, is in this module: vector
//! instructions, reads and writes through pointers in inner loops, and threads that write disjoint
//! parts of one array. What is callable from outside checks sizes first.
#![expect(
    unsafe_code,
    reason = "vector instructions, inner loops without bounds checks, and shared output arrays"
)]

mod allocation;
mod attention;
pub(in crate::nn) mod conv;
#[cfg(test)]
mod edges;
mod elementwise;
mod exchange;
mod gemm;
mod group_norm;
mod host;
mod isa;
mod layer_norm;
mod linear;
mod linear_attention;
mod math;
mod peak;
mod resample;
mod rope;
mod scratch;
mod shared;
mod simd;
mod upscaling;

pub use allocation::keep_freed_memory;
pub use gemm::{Epilogue, Factor, Matrix, MatrixMut, PackedFactor, gemm, gemm_serial};
pub use isa::Isa;
pub(crate) use isa::kernels_fit;
pub use peak::measured_peak_flops;
pub use simd::Pair;

pub(super) use attention::{attention, window_attention};
pub(super) use elementwise::activation;
pub(super) use exchange::{ExchangeInputs, exchange};
pub(super) use group_norm::GroupNorm;
pub(super) use host::HostTensor;
pub(super) use layer_norm::layer_norm;
pub(super) use linear::{gated_linear, linear};
pub(super) use linear_attention::linear_attention;
pub(super) use resample::{Taps, Windows, max_pool, resize};
pub(super) use rope::rotate;
pub(super) use upscaling::{UpscalingWeights, upscaled_products};
