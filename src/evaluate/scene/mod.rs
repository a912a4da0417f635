//! A scene against the truth about it, with the paper's ablations.

mod cameras;
mod depth;
mod instances;
mod run;
mod test_views;
#[cfg(test)]
mod tests;
mod views;

pub use cameras::{CameraComparison, CameraErrors};
pub use depth::DepthComparison;
pub use instances::InstanceComparison;
pub use run::{Evaluation, KeptViews, Report};
pub use test_views::{TestAlignment, TestRefinement};
pub use views::{ComparedView, ViewsReport};

use crate::{Error, scene::Scene};

/// The error about a truth that does not know one of the scene's photos.
fn lacks(truth: &Scene, name: &str) -> Error {
    Error::file(
        truth.folder(),
        format!("has no photo '{name}'"),
        "import the truth with the same photos",
    )
}
