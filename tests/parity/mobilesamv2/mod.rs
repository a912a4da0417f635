//! MobileSAMv2: its networks and what is around them.

mod detector;
mod efficient_vit;
mod picture;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "yolo_blocks" => detector::blocks,
        "object_aware_yolov8" => detector::network,
        "efficientvit_blocks" => efficient_vit::blocks,
        "efficientvit_sam" | "efficientvit_l2" => efficient_vit::network,
        _ => return None,
    })
}
