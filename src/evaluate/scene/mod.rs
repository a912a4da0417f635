//! A scene against the truth about it, with the paper's ablations.

mod cameras;
mod depth;
mod instances;
mod run;
#[cfg(test)]
mod tests;
mod views;

pub use cameras::{CameraComparison, CameraErrors};
pub use depth::DepthComparison;
pub use instances::InstanceComparison;
pub use run::{Evaluation, Report};
pub use views::ViewsReport;
