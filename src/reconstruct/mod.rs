//! From photos to cameras and depth, and the removal of points that cannot be right.

mod anomalies;
mod stage;
mod view_order;

pub use anomalies::{CleanParams, Verdict, judge_points};
pub use stage::{CleanReport, CleanedPhoto, NewScene, clean};
pub use view_order::{OrderChoice, spread_order, view_order};

use crate::{Result, photos::Photo, progress::Progress, scene::Frame};

/// Gives each photo depth, intrinsics and pose: the paper's {Z_i, K_i, T_i} = D({I_i}).
///
/// A network looks at the photos; a recording looks them up.
pub trait Reconstructor {
    /// One frame for each photo, in the photos' order, all in one scene frame and scale.
    ///
    /// # Errors
    /// When a photo cannot be read or its geometry cannot be had.
    fn reconstruct(&self, photos: &[Photo], progress: &dyn Progress) -> Result<Vec<Frame>>;
}
