//! SAM's image encoder (Kirillov et al. 2023), a vision transformer most of whose blocks attend within
//! windows (ViTDet; Li et al. 2022).
//!
//! Upstream: `mobilesamv2/modeling/image_encoder.py` (`ImageEncoderViT`); its released form is ViT-H.

mod block;
mod config;
mod memory;
mod network;
mod work;

pub use block::{Attention, Block};
pub use config::Config;
pub use memory::Memory;
pub use network::Vit;
pub use work::Work;
