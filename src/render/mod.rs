//! From the (edited) cloud to pictures: projection, reference masks, completion.
//!
//! Cameras on a circle about something, for views of it from all sides:
//!
//! ```
//! use tid3r::{
//!     geometry::{Camera, Intrinsics, Point, Pose},
//!     render::orbit,
//! };
//!
//! let intrinsics =
//!     Intrinsics { width: 640, height: 480, fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5 };
//! let start = Camera { intrinsics, cam_to_world: Pose::translation(0.0, -2.0, 1.0) };
//! let chair = Point::new(0.0, 0.0, 1.0);
//! // z is up here.
//! let cameras = orbit(&start, &chair, &Pose::identity(), 4);
//! assert!((cameras[1].centre() - Point::new(2.0, 0.0, 1.0)).norm() < 1e-9);
//! for camera in &cameras {
//!     let ([u, v], depth) = camera.project(&chair).unwrap();
//!     assert!((u - 319.5).abs() < 1e-9 && (v - 239.5).abs() < 1e-9 && (depth - 2.0).abs() < 1e-9);
//! }
//! ```

mod completer;
mod contact_sheet;
pub mod fill;
mod path;
mod projection;
mod record;
mod references;
pub mod see3d;
mod stage;
mod top_down;

pub use completer::{
    Bare, Completed, Completer, Completion, Follower, Keeps, Kept, Step, View, Views,
};
pub use contact_sheet::contact_sheet;
pub use path::{between, orbit, path_cameras};
pub use projection::{Projection, SplatParams, project};
pub use record::{scene_recipe, unedited_recipe};
pub use references::{Reference, ReferenceParams, reference_masks};
pub use stage::{EditedScene, Rendering, Shown, Story, Target, ViewFiles, Written};
pub use top_down::top_down;
