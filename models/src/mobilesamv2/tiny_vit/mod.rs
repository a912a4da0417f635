//! TinyViT (Wu et al. 2022) as MobileSAM has it: a small image encoder of convolutions and attention
//! within windows.
//!
//! Upstream: `tinyvit/tiny_vit.py` (`TinyViT`); its released form is the one with 5 million parameters.
//!
//! Four layers, each of which halves the image before the next one, but for the last.

mod attention;
mod block;
mod config;
mod conv;
mod layer;
mod memory;
mod network;
mod work;

pub use attention::Attention;
pub use block::{Sizes, TinyVitBlock};
pub use config::Config;
pub use conv::{MbConv, PatchEmbed, PatchMerging, conv_bn};
pub use layer::Layer;
pub use memory::Memory;
pub use network::TinyVit;
pub use work::Work;
