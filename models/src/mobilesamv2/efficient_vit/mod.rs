//! EfficientViT-SAM (Cai et al. 2023; Zhang, Cai and Han 2024): an image encoder for SAM's decoder that is
//! mostly convolutions.
//!
//! Upstream: `efficientvit/models/efficientvit` (`EfficientViTLargeBackbone`, `SamNeck`,
//! `EfficientViTSamImageEncoder`) and `efficientvit/models/nn`, at MIT's `l2`. MobileSAMv2 puts a
//! reduction to 512 x 512 before it.
//!
//! Five stages halve the image each and widen it; in the last, pixels attend to each other with a
//! cost linear in their number. The neck brings the last three stages to one grid, adds them, and
//! spends half of all work on them.

mod attention;
mod backbone;
mod blocks;
mod config;
mod memory;
mod neck;
mod network;
mod work;

pub use attention::{EfficientVitBlock, LiteMla};
pub use blocks::{FusedMbConv, MbConv, ResBlock, Sizes};
pub use config::Config;
pub use memory::Memory;
pub use network::EfficientVit;
pub use work::Work;
