//! MV-DUSt3R and MV-DUSt3R+ (Tang et al. 2024): photos of a scene, without cameras, to the 3D
//! point of every pixel.
//!
//! Facts are from facebookresearch/mvdust3r at 18872ea; tensor names are those of its checkpoints.
//!
//! An encoder looks at each photo alone; a decoder lets the views exchange what they know; heads
//! turn each view's tokens into points, confidences and Gaussians.
//!
//! A small network whose weights are all 0, on two photos:
//!
//! ```
//! use candle_core::{DType, Device, Tensor};
//! use tid3r_models::{
//!     Unobserved, Weights,
//!     mvdust3r::{Config, MvDust3r, Options},
//! };
//!
//! let zeros = |_: &str, shape: &[usize]| vec![0.0; shape.iter().product()];
//! let config = Config {
//!     enc_embed_dim: 32, enc_depth: 1, enc_num_heads: 2,
//!     dec_embed_dim: 32, dec_depth: 1, dec_num_heads: 2,
//!     gs: false, skip_dim: 8,
//!     ..Config::mv_dust3r()
//! };
//! let network = MvDust3r::new(&config, &Weights::from_fn(zeros, &Device::Cpu))?;
//! let photos = Tensor::zeros((2, 1, 3, 32, 48), DType::F32, &Device::Cpu)?;
//! let paths = network.forward(&photos, &Options::default(), &mut Unobserved)?;
//! for view in &paths[0] {
//!     assert_eq!(view.points.dims(), [1, 32, 48, 3]);
//!     // 1 + exp(0)
//!     assert_eq!(view.confidence.flatten_all()?.to_vec1::<f32>()?, [2.0; 32 * 48]);
//! }
//! # Ok::<(), candle_core::Error>(())
//! ```

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
