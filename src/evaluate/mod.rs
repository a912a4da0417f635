//! How near a result is to a known truth: depth, cameras, instances, rendered views.
//!
//! Pure functions over maps, poses, point labels and pictures, but for [`lpips`], whose networks have
//! weights, and [`scene`], which puts together what is known of a scene folder. Every number is the same whatever
//! the number of threads.
//!
//! Depth whose scale nobody knows, and a picture that is one grey level off:
//!
//! ```
//! use image::{Rgb, RgbImage};
//! use tid3r::{
//!     Map,
//!     evaluate::{depth::{Alignment, DepthSequence}, image::psnr},
//! };
//!
//! let truth = Map::from_fn(8, 8, |x, y| (1 + x + y) as f32);
//! let mut depth = DepthSequence::new();
//! depth.push("photo", &truth.map(|z| z / 2.0), &truth, None)?;
//! let report = depth.report(Alignment::Scale)?;
//! assert_eq!((report.scale, report.all.rmse, report.all.delta1), (2.0, 0.0, 1.0));
//!
//! let grey = |value| RgbImage::from_pixel(8, 8, Rgb([value; 3]));
//! // 20 log10(255)
//! assert!((psnr(&grey(101), &grey(100), None)? - 48.1308).abs() < 1e-4);
//! # Ok::<(), tid3r::Error>(())
//! ```

pub mod depth;
pub mod image;
pub mod instances;
pub mod lpips;
mod nearest;
pub mod pointmaps;
pub mod poses;
mod refine_pose;
pub mod scene;

pub use refine_pose::{PoseGain, RefinedPose, refine_pose};

use crate::Error;

/// The complaint that `what` should have the size (width, height) of the truth and has not.
fn size_mismatch(what: &str, size: (u32, u32), truth: (u32, u32)) -> Error {
    Error::request(
        format!(
            "{what} is {}x{} pixels, its truth {}x{}",
            size.0, size.1, truth.0, truth.1
        ),
        "resize one to the other first",
    )
}

#[cfg(test)]
mod pattern {
    /// Numbers without a pattern from two whole numbers, the same in every language with 32-bit
    /// wrapping arithmetic. The reference values in the tests are of inputs made with it.
    pub(super) fn hash(a: u32, b: u32) -> u32 {
        let mixed = a
            .wrapping_mul(374_761_393)
            .wrapping_add(b.wrapping_mul(668_265_263));
        let mixed = (mixed ^ (mixed >> 13)).wrapping_mul(1_274_126_177);
        mixed ^ (mixed >> 16)
    }
}
