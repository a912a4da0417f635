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
