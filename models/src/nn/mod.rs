//! Layers that networks are built of.
//!
//! A network calls these, and candle itself only to move numbers about (reshape, narrow, add,
//! concatenate). What costs time is behind this module: [`Linear`], [`GatedLinear`], [`LayerNorm`],
//! [`GroupNorm`], [`attention()`], [`window_attention()`], [`Rotation::apply`], [`Conv2d`], [`exchange()`],
//! [`Upscaling`]. On CPUs these run on the kernels in [`cpu`], for f32; elsewhere, and as the oracle of tests, on candle's operations.
//!
//! Tokens are `(batch, tokens, channels)`; heads share the channels, head after head, so that
//! nothing is transposed. Images are `(batch, height, width, channels)`.
//!
//! A query that all keys fit alike gets the mean of their values:
//!
//! ```
//! use candle_core::{DType, Device, Tensor};
//! use tid3r_models::{
//!     ComputeType,
//!     nn::{Memory, attention},
//! };
//!
//! let zeros = |tokens: usize| Tensor::zeros((1, tokens, 4), DType::F32, &Device::Cpu);
//! let v = Tensor::new(&[[[1.0_f32, 2.0, 3.0, 4.0], [3.0, 6.0, 5.0, 8.0]]], &Device::Cpu)?;
//! let memory = Memory { k: zeros(2)?, v };
//! let result = attention(&zeros(1)?, &[memory], 2, ComputeType::F32)?;
//! let result = result.flatten_all()?.to_vec1::<f32>()?;
//! for (got, mean) in result.iter().zip([2.0, 4.0, 4.0, 6.0]) {
//!     assert!((got - mean).abs() < 1e-5, "{result:?}");
//! }
//! # Ok::<(), candle_core::Error>(())
//! ```

mod activation;
mod attention;
mod block;
mod by_head;
#[cfg(test)]
mod compact_tests;
pub mod compare;
mod conv;
pub mod cpu;
#[cfg(feature = "cuda")]
mod cuda;
mod exchange;
mod gated_linear;
mod group_norm;
mod grouped;
mod layer_norm;
mod linear;
mod linear_attention;
mod mlp;
mod pool;
pub mod profile;
mod resize;
mod rope;
mod upscaling;
mod window_attention;

pub use activation::Activation;
pub use attention::{
    CrossAttention, Memory, SelfAttention, attention, attention_by_group, causal_attention,
};
pub use block::{DecoderBlock, EncoderBlock, NORM_EPS};
pub use conv::{
    BatchNorm2d, Conv2d, ConvTranspose2d, DepthwiseConv2d, Precision, convolve_in_turn,
};
pub use exchange::{Told, exchange};
pub use gated_linear::GatedLinear;
pub use group_norm::GroupNorm;
pub use grouped::GroupedLinear;
pub use layer_norm::LayerNorm;
pub use linear::Linear;
pub use linear_attention::linear_attention;
pub use mlp::Mlp;
pub use pool::{max_pool, max_pool_within};
pub use resize::{resize_bicubic, resize_bilinear, upsample_nearest};
pub use rope::{Rope2d, Rotation};
pub use upscaling::Upscaling;
pub use window_attention::{ScoreBias, window_attention};
