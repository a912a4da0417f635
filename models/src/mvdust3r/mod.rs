//! MV-DUSt3R and MV-DUSt3R+ (Tang et al. 2024): photos of a scene, without cameras, to the 3D
//! point of every pixel.
//!
//! Facts are from facebookresearch/mvdust3r at 18872ea; tensor names are those of its checkpoints.
//!
//! An encoder looks at each photo alone; a decoder lets the views exchange what they know; heads
//! turn each view's tokens into points, confidences and Gaussians.

mod config;
mod decoder;
mod encoder;
mod gaussian_head;
mod memory;
mod network;
mod patch_embed;
mod points_head;
mod work;

pub use crate::observer::{Observer, Unobserved};
pub use config::{Config, ExpMode, PointsHeadConfig, PositionEncoding};
pub use decoder::Decoder;
pub use encoder::Encoder;
pub use gaussian_head::{GaussianHead, Gaussians};
pub use memory::Memory;
pub use network::{MvDust3r, Options, Paths, ViewOutput};
pub use patch_embed::{PatchEmbed, PatchGrid};
pub use points_head::{PointsHead, RawPoints, SkipOptions, Statistics, postprocess};
pub use work::Work;
