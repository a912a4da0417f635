//! From frames to masks, and from masks to instances.

pub mod graph;
mod label_images;
mod mask;
mod stage;
pub mod unify;

pub use graph::{GraphParams, GraphSegmenter};
pub use label_images::LabelImages;
pub use mask::{Mask, MaskParams, label_map};
pub use stage::{SegmentReport, Segmentation};
pub use unify::{Instances, UnifyParams};

use crate::{Result, scene::Frame};

/// Cuts one frame into masks, every frame by itself.
///
/// Masks may overlap; [`label_map`] decides then. A network looks at the colours; the graph-based
/// segmentation at colours and depth; [`LabelImages`] looks the masks up.
pub trait Segmenter: Sync {
    /// The masks of `frame`, in the frame's size, in an order that depends on the frame alone.
    ///
    /// # Errors
    /// When the masks cannot be had.
    fn segment(&self, frame: &Frame) -> Result<Vec<Mask>>;
}
