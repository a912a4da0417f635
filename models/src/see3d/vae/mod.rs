//! The autoencoder between pictures and latents (Rombach et al. 2022): Stable Diffusion's.
//!
//! Upstream: `AutoencoderKL` of diffusers 0.27.2, and `models/vae.py` and `models/unets/unet_2d_blocks.py`
//! there. Rendering needs its halves at different times, so each is a network of its own, [`Encoder`] and
//! [`Decoder`], with its tensors under the names of the whole.
//!
//! Images are worked on one by one, and large ones tile by tile ([`Tiling`]).

mod attention;
mod blocks;
mod config;
mod decoder;
mod encoder;
mod memory;
mod moments;
mod network;
mod tiling;
mod work;

pub use config::{ActivationFunction, Config, DownBlockType, UpBlockType};
pub use decoder::Decoder;
pub use encoder::Encoder;
pub use memory::Memory;
pub use moments::Moments;
pub use network::Vae;
pub use tiling::Tiling;
pub use work::Work;

/// Epsilon of all group norms, a constant of the original.
const EPS: f64 = 1e-6;
