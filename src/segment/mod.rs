//! From frames to masks, and from masks to instances.
//!
//! Masks may overlap; a label is one thing's. A cup on a table stays a cup:
//!
//! ```
//! use tid3r::segment::{Mask, MaskParams};
//!
//! // In a picture of 4 x 4 pixels, by their places.
//! let table = Mask::from_pixels(4..16, 0.9);
//! let cup = Mask::from_pixels([5, 6, 9, 10], 0.8);
//! assert_eq!(cup.share_in(&table), 1.0);
//! assert_eq!(cup.iou(&table), 4.0 / 12.0);
//!
//! let labels = MaskParams::default().labels(&[table, cup], 4, 4);
//! assert_eq!(labels.map.values()[..8], [0, 0, 0, 0, 1, 2, 2, 1]);
//! ```

mod coco_rle;
mod described;
pub mod graph;
mod label_images;
mod mask;
pub mod mobilesamv2;
mod overlay;
mod photo_masks;
mod stage;
mod steps;
pub mod unify;

pub use coco_rle::CocoRle;
pub use described::DescribedSegmenter;
pub use graph::{GraphParams, GraphSegmenter};
pub use label_images::LabelImages;
pub use mask::{Containment, Labels, Mask, MaskParams, by_area, painted, without_duplicates};
pub use overlay::overlay;
pub use photo_masks::{Object, PhotoMasks, PhotoReport};
pub use stage::{SegmentReport, Segmentation};
pub use unify::{Instances, UnifyParams};

use crate::{Result, progress::Progress, scene::Frame};

/// Cuts one frame into masks, every frame by itself.
///
/// Masks may overlap; [`MaskParams::labels`] decides then. A network looks at the colours; the graph-based
/// segmentation at colours and depth; [`LabelImages`] looks the masks up.
pub trait Segmenter: Sync {
    /// Called once before the first of so many frames is cut: says in which way, and notes what it will
    /// take if that is more than a moment.
    ///
    /// # Errors
    /// When it cannot be done.
    fn begin(&self, frames: usize, progress: &dyn Progress) -> Result<Pace> {
        let _ = (frames, progress);
        Ok(Pace::Together)
    }

    /// The masks of `frame`, in the frame's size, in an order that depends on the frame alone. `done` is
    /// told now and then which share of the frame's work is done.
    ///
    /// # Errors
    /// When the masks cannot be had.
    fn segment(&self, frame: &Frame, done: &mut dyn FnMut(f64)) -> Result<Vec<Mask>>;
}

/// In which way frames are cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// As many at a time as there are threads.
    Together,
    /// One after another: each takes all threads, and much memory.
    OneByOne,
}
