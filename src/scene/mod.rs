//! What the stages exchange, in memory and as a folder on disk.
//!
//! A scene folder holds
//!
//! ```text
//! scene.json                      photos, cameras, scale, floor, which stages were run and how
//! frames/NAME/colour.png          a photo as a network saw it
//! frames/NAME/geometry.safetensors    depth and confidence
//! frames/NAME/gaussians.safetensors   a Gaussian for each pixel, if a network gave them
//! frames/NAME/validity.safetensors    which points passed the cleaning
//! frames/NAME/masks.safetensors       the frame's own masks
//! frames/NAME/instances.safetensors   the scene's instances
//! photos/NAME.png, NAME.jpg       photos that are no files elsewhere, or were undistorted
//! held_out/NAME/…                 photos kept apart to compare rendered views with
//! instances.json                  the instances: name, size, where seen
//! edits.json                      the list of edits
//! points.ply                      the cleaned cloud, before edits
//! edited.ply                      the edited cloud, if `tid3r run` made it
//! contact_sheet.png, top_down.png every instance with its id
//! views/                          rendered pictures
//! gallery/NUMBER/                 pictures rendered from the page of `tid3r view`
//! timings.json                    how long each stage took (nothing else in the folder depends on the clock)
//! ```
//!
//! Every stage owns its files. Each is written under a temporary name and renamed when whole;
//! `scene.json` names a stage as done only after its last file. So a process killed at any moment
//! leaves a scene that the next one can use.
//!
//! In memory, a scene is frames, and a cloud of the points that they show:
//!
//! ```
//! use tid3r::{
//!     Map,
//!     geometry::{Camera, Intrinsics, Pose},
//!     photos::{Photo, PhotoTransform},
//!     scene::{Cloud, Frame},
//! };
//!
//! let intrinsics = Intrinsics { width: 4, height: 2, fx: 4.0, fy: 4.0, cx: 1.5, cy: 0.5 };
//! let frame = Frame {
//!     photo: Photo::new("wall", "wall.png"),
//!     transform: PhotoTransform::whole([4, 2], [4, 2]),
//!     camera: Camera { intrinsics, cam_to_world: Pose::identity() },
//!     colour: image::RgbImage::new(4, 2),
//!     // In the first column, depth is not known.
//!     depth: Map::from_fn(4, 2, |x, _| if x == 0 { 0.0 } else { 2.0 }),
//!     confidence: Map::filled(4, 2, 1.0),
//! };
//! let valid = Map::filled(4, 2, true);
//! let instances = Map::from_fn(4, 2, |x, _| u32::from(x == 3));
//! let cloud = Cloud::from_frames(&[frame], &[valid], Some(&[instances]));
//! assert_eq!(cloud.len(), 6);
//! let (object, rest) = cloud.partition(|index, cloud| cloud.instances[index] == 1);
//! // (3 - 1.5) / 4 * 2, (0 - 0.5) / 4 * 2
//! assert_eq!(object.positions[0], [0.75, -0.25, 2.0]);
//! assert_eq!((object.len(), rest.len()), (2, 4));
//! ```

mod cloud;
pub mod files;
mod folder;
mod frame;
mod gaussians;
mod instances;
mod manifest;
#[cfg(test)]
pub(crate) mod test_frames;

pub use cloud::{Cloud, Source};
pub use folder::{Role, Scene, WriteLock};
pub use frame::{Frame, surface_points};
pub use gaussians::Gaussians;
pub use instances::InstanceRecord;
pub(crate) use manifest::VERSION;
pub use manifest::{FrameRecord, Hasher, Manifest, Scale, Stage, StageRecord};
