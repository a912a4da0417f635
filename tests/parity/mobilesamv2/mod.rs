//! MobileSAMv2: its networks and what is around them.

mod detector;
mod picture;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "yolo_blocks" => detector::blocks,
        "object_aware_yolov8" => detector::network,
        _ => return None,
    })
}
