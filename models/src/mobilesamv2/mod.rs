//! MobileSAMv2 (Zhang et al. 2023): a photo to a mask for each thing in it.
//!
//! Facts are from ChaoningZhang/MobileSAM, folder MobileSAMv2, at 34bbbfd, and hujiecpp/PE3R; tensor
//! names are those of their checkpoints, after what a file puts before them.
//!
//! A [`detector`] finds boxes around whatever is a thing; an [`ImageEncoder`] looks at the photo once; a
//! [`decoder`] makes the mask of each box.
//!
//! A small detector whose weights are all 0, and so are the logits:
//!
//! ```
//! use candle_core::{DType, Device, Tensor};
//! use tid3r_models::{
//!     Unobserved, Weights,
//!     mobilesamv2::detector::{Config, Detector},
//! };
//!
//! let zeros = |_: &str, shape: &[usize]| vec![0.0; shape.iter().product()];
//! let config = Config::scaled((0.33, 0.25, 128), 1, 26, 0);
//! let detector = Detector::new(&config, &Weights::from_fn(zeros, &Device::Cpu))?;
//! let image = Tensor::zeros((1, 32, 64, 3), DType::F32, &Device::Cpu)?;
//! let prediction = detector.forward(&image, &mut Unobserved)?;
//! // An anchor for each 8 x 8, 16 x 16 and 32 x 32 pixels.
//! assert_eq!(prediction.scores.to_vec2::<f32>()?, vec![[0.5]; 32 + 8 + 2]);
//! let boxes = prediction.boxes.to_vec2::<f32>()?;
//! assert_eq!(boxes[1], [12.0, 4.0, 0.0, 0.0]);
//! # Ok::<(), candle_core::Error>(())
//! ```

pub mod decoder;
pub mod detector;
pub mod efficient_vit;
mod encoder;
mod neck;
pub mod tiny_vit;
pub mod vit;

pub use encoder::ImageEncoder;
pub use neck::Neck;
