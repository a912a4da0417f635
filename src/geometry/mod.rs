//! Cameras and what can be computed from them: pure functions, no files.
//!
//! Frames are OpenCV's throughout: x right, y down, z forward; pixel centres at whole coordinates;
//! depth is z in the camera frame.
//!
//! ```
//! use tid3r::geometry::{Camera, Intrinsics, Point, Pose};
//!
//! let intrinsics =
//!     Intrinsics { width: 640, height: 480, fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5 };
//! // A metre to the right of the scene's origin.
//! let camera = Camera { intrinsics, cam_to_world: Pose::translation(1.0, 0.0, 0.0) };
//! let point = Point::new(1.5, 0.0, 2.0);
//! // 500 * 0.5 / 2 + 319.5
//! assert_eq!(camera.project(&point), Some(([444.5, 239.5], 2.0)));
//! assert_eq!(camera.unproject(444.5, 239.5, 2.0), point);
//! assert_eq!(camera.project(&Point::new(1.5, 0.0, -2.0)), None, "behind the camera");
//! ```

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
