//! Turns exact geometry and masks into what imperfect networks would give: noisy depth with flying
//! pixels and floating clumps, poses a little off, masks ragged, split, merged and missing.
//!
//! Each function is pure: the same input and seed give the same output.

mod depth;
mod field;
mod masks;
mod pose;

pub use depth::{DepthErrors, DisturbedDepth, disturb_depth};
pub use masks::{MaskErrors, disturb_masks};
pub use pose::{PoseErrors, disturb_pose};
