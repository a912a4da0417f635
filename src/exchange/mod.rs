//! What other programs write and read: recordings in, scenes out.
//!
//! Each format is a pair of reader and writer between a file and plain structs in tid3r's conventions;
//! formats know nothing of scenes.

pub mod cameras;
pub mod colmap;
pub mod glb;
mod half_pixels;
pub mod npz;
pub mod ply;
pub mod recording;
#[cfg(feature = "rerun")]
pub mod rrd;
pub mod transforms;
