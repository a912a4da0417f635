//! tid3r turns a few photos of a room into a 3D point cloud of separate, named objects, lets a person
//! edit it, and renders pictures of the edited room.
//!
//! It implements "Training-Free Instance-Aware 3D Scene Reconstruction and Diffusion-Based View
//! Synthesis from Sparse Images" (SIGGRAPH Asia 2025), called *the paper* in this documentation.

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
