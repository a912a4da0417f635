//! The denoising network: a 2D UNet whose attention spans all frames of a group.
//!
//! Upstream: `mv_unet.py` (`MultiViewUNetModel`), which descends from MVDream (Shi et al. 2023) and, in
//! sizes and names, from Stable Diffusion 2.1.

mod attention;
mod block;
mod config;
mod context;
mod embedding;
mod feed_forward;
mod memory;
mod network;
mod piece;
mod plan;
mod resample;
mod residual;
mod transformer;
mod work;

pub use attention::Attention;
pub use config::{Config, Repeats};
pub use context::Context;
pub use embedding::{Embedding, timestep_embedding};
pub use feed_forward::FeedForward;
pub use memory::Memory;
pub use network::{Deep, Unet};
pub use resample::{Downsample, Upsample};
pub use residual::ResBlock;
pub use transformer::{SpatialTransformer, TransformerBlock};
pub use work::{LayerWork, Work};
