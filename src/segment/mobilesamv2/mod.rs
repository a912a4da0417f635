//! Segmentation by MobileSAMv2 (Zhang et al. 2023): a detector finds objects, SAM masks them.

mod boxes;
mod letterbox;
mod mask_resize;
mod networks;
mod params;
mod sam_frame;

pub use boxes::{BoxSelection, Detection};
pub use letterbox::Letterbox;
pub use mask_resize::MaskResize;
pub use networks::{Encoder, Networks};
pub use params::{EncoderChoice, MobileSamParams};
pub use sam_frame::SamFrame;
