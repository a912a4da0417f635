//! MV-DUSt3R and MV-DUSt3R+ (Tang et al. 2024): photos of a scene, without cameras, to the 3D
//! point of every pixel.
//!
//! Facts are from facebookresearch/mvdust3r at 18872ea; tensor names are those of its checkpoints.
//!
//! There is the encoder, common to both networks: a vision transformer that looks at each photo
//! alone.

mod config;
mod encoder;
mod patch_embed;

pub use config::{Config, PositionEncoding};
pub use encoder::Encoder;
pub use patch_embed::{PatchEmbed, PatchGrid};
