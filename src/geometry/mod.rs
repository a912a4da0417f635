//! Cameras and what can be computed from them: pure functions, no files.
//!
//! Frames are OpenCV's throughout: x right, y down, z forward; pixel centres at whole coordinates;
//! depth is z in the camera frame.

mod align;
mod camera;
mod distortion;
mod floor;
mod focal;
mod lens;
mod pnp;
mod similarity;
mod warp;

pub use align::{AlignmentError, AlignmentFit, CameraAlignment, align_cameras};
pub use camera::{Camera, Intrinsics, matrix4};
pub use distortion::{DistortedLens, Distortion};
pub use floor::{SurfacePoint, floor_frame};
pub use focal::{FocalError, estimate_focal, robust_focal};
pub use lens::Lens;
pub use pnp::{
    Correspondence, PnpError, PnpParams, PnpSolution, PoseFit, solve_pnp, solve_pnp_and_focal,
};
pub use similarity::{Similarity, SimilarityError};
pub use warp::Warp;

/// A point, in the frame and the units that the context says.
pub type Point = nalgebra::Point3<f64>;
/// A direction or a displacement.
pub type Vector = nalgebra::Vector3<f64>;
/// A rigid motion, for example from a camera's frame to the scene's.
pub type Pose = nalgebra::Isometry3<f64>;
