//! MobileSAMv2: its networks and what is around them.

mod decoder;
mod detector;
mod efficient_vit;
mod picture;
mod tiny_vit;
mod vit;

use crate::Runner;

/// What computes the tensors of `model`.
pub(crate) fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "yolo_blocks" => detector::blocks,
        "object_aware_yolov8" => detector::network,
        "efficientvit_blocks" => efficient_vit::blocks,
        "efficientvit_sam" | "efficientvit_l2" => efficient_vit::network,
        "prompt_encoder" => decoder::prompts,
        "two_way_transformer" => decoder::transformer,
        "mask_decoder" => decoder::masks,
        "prompt_guided_mask_decoder" => decoder::file,
        "tiny_vit_blocks" => tiny_vit::blocks,
        "tiny_vit" => tiny_vit::network,
        "sam_vit" | "sam_vit_h" => vit::network,
        _ => return None,
    })
}
