//! From photos to cameras and depth, and the removal of points that cannot be right.
//!
//! The camera of a photo by the points that a network says its pixels show:
//!
//! ```
//! use tid3r::{
//!     Map,
//!     geometry::Intrinsics,
//!     progress::Silent,
//!     reconstruct::{Pointmap, RecoveryParams, recover_cameras},
//! };
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let lens = Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
//! // A wall that recedes to the right.
//! let points = Map::from_fn(64, 48, |x, y| {
//!     let depth = 2.0 + 0.02 * f64::from(x);
//!     lens.unproject(x.into(), y.into(), depth).coords.map(|c| c as f32).into()
//! });
//! let pointmap = Pointmap { confidence: points.map(|_| 1.0), points };
//! let recovery = recover_cameras(&[pointmap], &[None], &RecoveryParams::default(), 42, &Silent)?;
//! let recovered = recovery.views[0].outcome.clone()?;
//! assert!((recovered.camera.intrinsics.fx - 60.0).abs() < 0.01);
//! assert!(recovered.camera.centre().coords.norm() < 1e-3);
//! assert!(!recovered.is_doubtful());
//! # Ok(())
//! # }
//! ```

mod anomalies;
mod from_photos;
mod mvdust3r;
mod recovery;
mod stage;
mod view_order;

pub use anomalies::{CleanParams, Verdict, judge_points};
pub use from_photos::FromPhotos;
pub use mvdust3r::{FocalSource, MvDust3rParams, MvDust3rReconstructor, RunEstimate};
pub use recovery::{
    Pointmap, RecoveredCamera, RecoveredView, Recovery, RecoveryError, RecoveryParams,
    recover_cameras, recover_cameras_under_masks,
};
pub use stage::{CleanReport, CleanedPhoto, NewScene, clean};
pub use view_order::{OrderChoice, spread_order, view_order};

use crate::{
    Result,
    geometry::Intrinsics,
    photos::Photo,
    progress::Progress,
    scene::{Frame, Gaussians},
};
use serde::{Deserialize, Serialize};

/// Gives photos depth, intrinsics and pose: the paper's {Z_i, K_i, T_i} = D({I_i}).
///
/// A network looks at the photos; a recording looks them up.
pub trait Reconstructor {
    /// What is known of the photos then, all in one scene frame and scale.
    ///
    /// # Errors
    /// When a photo cannot be read, or the geometry of so many cannot be had that there is no scene.
    fn reconstruct(&self, photos: &[Photo], progress: &dyn Progress) -> Result<Reconstruction>;
}

/// What a [`Reconstructor`] made of photos.
#[derive(Clone, Debug, Default)]
pub struct Reconstruction {
    /// One frame for each photo that has a place in the scene, in the photos' order.
    pub frames: Vec<Frame>,
    /// The Gaussians of each frame; empty if there are none.
    pub gaussians: Vec<Gaussians>,
    /// What there is to tell of each photo; empty if there is nothing.
    pub photos: Vec<PlacedPhoto>,
}

impl From<Vec<Frame>> for Reconstruction {
    fn from(frames: Vec<Frame>) -> Self {
        Self {
            frames,
            ..Self::default()
        }
    }
}

/// What became of one photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlacedPhoto {
    /// The photo.
    pub name: String,
    /// Its place in the order in which the network saw the photos: 0 is the reference.
    pub view: usize,
    /// Where it has its place in the scene, or why it has none.
    #[serde(flatten)]
    pub outcome: Placement,
}

/// Whether a photo has a place in the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// It has.
    Placed {
        /// The lens, for the original photo.
        intrinsics: Intrinsics,
        /// Where the focal length comes from.
        focal: FocalOrigin,
        /// The share of its points that agree with the camera.
        inlier_share: f64,
        /// Root mean square of their distances from where the camera should see them, pixels of the
        /// frame.
        rms_px: f64,
        /// Whether so few points agree that the camera is probably wrong.
        doubtful: bool,
    },
    /// It has not; the scene is made without it.
    LeftOut {
        /// Why.
        reason: String,
    },
}

/// Where a focal length comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FocalOrigin {
    /// It was known beforehand.
    Known,
    /// It was recovered from what the network says.
    Recovered,
    /// That failed, and it is that of a usual lens.
    Assumed,
}
