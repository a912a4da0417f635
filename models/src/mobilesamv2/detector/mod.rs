//! The object-aware detector: a YOLOv8 that was trained to find all things, whatever they are.
//!
//! It is ultralytics 8.0.120's `yolov8-seg` with two changes: the distances of a box's sides have 26
//! bins rather than 16, and the segmentation branch has no prototypes, so that its mask coefficients
//! are of no use ([`MaskCoefficients`] has them for comparison with the original). `model.<i>` in names
//! is layer `i` of that network's description.
//!
//! A backbone makes maps of ever coarser features, a neck mixes them down to coarse and back up to
//! fine, and a head reads a box and scores off each pixel of three maps, an *anchor*.

mod backbone;
mod block;
mod boxes;
mod config;
mod head;
mod memory;
mod neck;
mod network;
mod watch;
mod work;

pub use block::{C2f, ConvBlock, Sppf};
pub use boxes::{Dfl, Prediction};
pub use config::Config;
pub use head::{Head, HeadMaps, MaskCoefficients};
pub use memory::Memory;
pub use network::Detector;
pub use work::{LayerWork, Work};

/// Pixels of the image for one pixel of each of the head's maps.
pub const STRIDES: [usize; 3] = [8, 16, 32];
