//! tid3r turns a few photos of a room into a 3D point cloud of separate, named objects, lets a person
//! edit it, and renders pictures of the edited room.
//!
//! It implements "Training-Free Instance-Aware 3D Scene Reconstruction and Diffusion-Based View
//! Synthesis from Sparse Images" (SIGGRAPH Asia 2025), called *the paper* in this documentation.
//!
//! A room in a few lines: a photo with depth becomes labelled points, an instance is removed, and a camera
//! looks at what is left.
//!
//! ```
//! use tid3r::{
//!     Map,
//!     edit::{Edit, apply},
//!     geometry::{Camera, Intrinsics, Pose},
//!     photos::{Photo, PhotoTransform},
//!     render::{SplatParams, project},
//!     scene::{Cloud, Frame},
//! };
//!
//! let intrinsics = Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
//! let camera = Camera { intrinsics, cam_to_world: Pose::identity() };
//! // A white wall, 2 m away. Its left half is instance 1.
//! let wall = Frame {
//!     photo: Photo::new("wall", "wall.png"),
//!     transform: PhotoTransform::whole([64, 48], [64, 48]),
//!     camera,
//!     colour: image::RgbImage::from_pixel(64, 48, image::Rgb([255; 3])),
//!     depth: Map::filled(64, 48, 2.0),
//!     confidence: Map::filled(64, 48, 1.0),
//! };
//! let frames = [wall];
//! let instances = vec![Map::from_fn(64, 48, |x, _| u32::from(x < 32))];
//! let cloud = Cloud::from_frames(&frames, &[Map::filled(64, 48, true)], Some(&instances));
//!
//! let edits = [Edit::Remove { instances: vec![1] }];
//! let no_style = |_: &str| Ok(Vec::new());
//! let edited = apply(cloud, &frames, instances, &Pose::identity(), &edits, no_style)?;
//! let view = project(&edited.cloud, &camera, &SplatParams::default());
//! assert!(!view.mask[(16, 24)]);
//! assert_eq!(view.depth[(48, 24)], 2.0);
//! # Ok::<(), tid3r::Error>(())
//! ```

pub mod bench;
pub mod demo;
pub mod doctor;
pub mod draw;
pub mod edit;
pub mod error;
pub mod evaluate;
pub mod exchange;
pub mod export;
pub mod geometry;
pub mod machine;
pub mod map;
pub mod parameters;
pub mod photos;
pub mod progress;
pub mod reconstruct;
pub mod render;
pub mod scene;
pub mod segment;
pub mod suite;
pub mod viewer;
mod weights;

pub use error::{Error, Result};
pub use map::Map;
