//! MobileSAMv2 (Zhang et al. 2023): a photo to a mask for each thing in it.
//!
//! Facts are from ChaoningZhang/MobileSAM, folder MobileSAMv2, at 34bbbfd, and hujiecpp/PE3R; tensor
//! names are those of their checkpoints, after what a file puts before them.
//!
//! A [`detector`] finds boxes around whatever is a thing; an [`ImageEncoder`] looks at the photo once; a
//! [`decoder`] makes the mask of each box.

pub mod decoder;
pub mod detector;
pub mod efficient_vit;
mod encoder;
mod neck;
pub mod tiny_vit;
pub mod vit;

pub use encoder::ImageEncoder;
pub use neck::Neck;
